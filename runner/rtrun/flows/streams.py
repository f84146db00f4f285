"""The streams of an observation: what the accumulator has, with names that outlast a restart and columns to keep."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace

import numpy as np

from rtfiles.output import counted, printable
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.messages import End, MessagePair
from rtrun.flows.paths import PathLog
from rtrun.flows.programs import numbered
from rtrun.flows.threads import CallbackLog
from rtrun.flows.timers import ClockOffsets, TimerLog, known_period_ns, lateness, skipped_periods
from rtrun.flows.topics import PUBLISHER
from rtrun.flows.values import Stream, differences, int64s
from rtrun.plan.observation import StreamKind

# That a program has ended may be told a round late.
STALL_NS = 3 * 10**9
Identity = dict[str, str | int]


def streams(observed: FlowAccumulator) -> list[Stream]:
    """One value for each thing that was measured, in the order in which they were first seen."""
    made = [_printable(stream) for stream in _streams(observed)]
    seen: dict[tuple[object, ...], int] = {}
    for place, stream in enumerate(made):
        # Names that differ in bytes that cannot be printed only are alike when printed.
        key = (stream.kind, *stream.identity.items())
        seen[key] = seen.get(key, 0) + 1
        if seen[key] > 1:
            made[place] = replace(stream, identity={**stream.identity, "alike": seen[key]})
    return made


def _streams(observed: FlowAccumulator) -> Iterator[Stream]:
    for pair in observed.topics.pairs.values():
        told_apart_by = observed.topics.told_apart_by(pair.publisher.topic)
        yield replace(_messages(pair, told_apart_by), open_ns=_untaken_ns(pair, observed))
    for timer in observed.calls.timers.values():
        made = _timer(timer, observed.offsets)
        yield replace(made, open_ns=_overdue_ns(made.period_ns, timer, observed))
    called = dict(observed.open_calls())
    for callback in observed.calls.callbacks.values():
        yield replace(_callback(callback), open_ns=_unended_ns(callback, called, observed))
    for (role, _, _), end in observed.topics.ends.items():
        if end.times:
            open_ns = _silent_ns(end, observed) if role == PUBLISHER else 0
            yield replace(_intervals(role, end), open_ns=open_ns)
    for (number, publisher), log in observed.paths.logs.items():
        yield _path(observed.paths.paths[number], publisher, log)


def _printable(stream: Stream) -> Stream:
    identity = {key: printable(value) if isinstance(value, str) else value for key, value in stream.identity.items()}
    return replace(stream, identity=identity)


def message_identity(pair: MessagePair) -> Identity:
    return {"topic": pair.publisher.topic, "publisher": pair.publisher.label, "subscriber": pair.subscriber.label}


def timer_identity(log: TimerLog) -> Identity:
    identity: Identity = {"node": log.label, "timer": numbered(log.name, log.number)}
    return {**identity, "clock": log.clock} if log.clock else identity


def callback_identity(log: CallbackLog) -> Identity:
    return {"node": log.label, "callback": numbered(log.subject or "unknown", log.number), "thread": log.thread}


def interval_identity(role: str, end: End) -> Identity:
    return {"topic": end.topic, "end": role, "node": end.label}


def path_identity(path: tuple[str, ...], publisher: End) -> Identity:
    return {"path": ",".join(path), "publisher": publisher.label}


def _messages(pair: MessagePair, told_apart_by: str) -> Stream:
    counts = pair.counts()
    remarks: tuple[str, ...] = ()
    if counts.ambiguous:
        unknown = f"not known of {counted(counts.ambiguous, 'publication')} whether they came"
        remarks = (f"{unknown}: other messages have the same {told_apart_by}",)
    return Stream(
        kind=StreamKind.MESSAGES,
        identity=message_identity(pair),
        columns=pair.columns(),
        counts=asdict(counts),
        remarks=remarks,
        source=pair,
    )


def _timer(log: TimerLog, offsets: ClockOffsets) -> Stream:
    at, cuts = int64s(log.times), int64s(log.cuts)
    late = lateness(log, offsets)
    columns, counts = {"timestamp_ns": at}, {"calls": at.size}
    if late.rows.size and (period_ns := known_period_ns(log)) is not None:
        is_cut = np.isin(late.rows, cuts)
        is_cut[1:] |= np.diff(late.rows) != 1
        cuts = np.flatnonzero(is_cut)
        columns = {"timestamp_ns": at[late.rows], "expected_ns": late.expected_ns, "real_ns": late.real_ns}
        counts["skipped"] = skipped_periods(late.expected_ns, period_ns, cuts)
    return Stream(
        kind=StreamKind.TIMER,
        identity=timer_identity(log),
        columns=columns,
        counts=counts | {"measured": len(columns["timestamp_ns"])},
        period_ns=known_period_ns(log),
        cuts=cuts[cuts > 0],
        remarks=late.why_not,
        source=log,
    )


def _callback(log: CallbackLog) -> Stream:
    return _durations(StreamKind.CALLBACK, callback_identity(log), log, {})


def _path(path: tuple[str, ...], publisher: End, log: PathLog) -> Stream:
    outputs = len(log.ends) + log.unknown
    made = _durations(StreamKind.PATH, path_identity(path, publisher), log, {"unknown": log.unknown})
    if not log.unknown:
        return made
    share = f"path unknown: {100 * log.unknown / outputs:.3g} % of {counted(outputs, 'message')} at its end"
    return replace(made, remarks=(share,))


def _durations(kind: StreamKind, identity: Identity, log: CallbackLog | PathLog, counts: dict[str, int]) -> Stream:
    begin, end = int64s(log.begins), int64s(log.ends)
    return Stream(
        kind=kind,
        identity=identity,
        columns={"begin_ns": begin, "end_ns": end},
        counts={"measured": end.size, **counts},
        source=log,
    )


# What has not come at the end, though its program lives.


def _stalled_ns(since_ns: int, longest_ns: int, observed: FlowAccumulator) -> int:
    """For how long something has not come at the end, if that is longer than ever before; else 0."""
    passed_ns = observed.until_ns - since_ns
    return passed_ns if passed_ns > max(STALL_NS, longest_ns) else 0


def _is_seen(record: End | TimerLog, observed: FlowAccumulator) -> bool:
    """Whether it lives, and no hits are missing since its last one."""
    return record.latest is not None and record.latest[1].is_alive and record.latest[0] == observed.situation.epoch


def _silent_ns(record: End | TimerLog, observed: FlowAccumulator) -> int:
    """Since the last message or call."""
    if not _is_seen(record, observed):
        return 0
    longest_ns = int(differences(int64s(record.times), int64s(record.cuts)).max(initial=0))
    return _stalled_ns(record.times[-1], longest_ns, observed)


def _overdue_ns(period_ns: int | None, log: TimerLog, observed: FlowAccumulator) -> int:
    """Since a call was due."""
    return 0 if period_ns is None else max(0, _silent_ns(log, observed) - period_ns)


def _untaken_ns(pair: MessagePair, observed: FlowAccumulator) -> int:
    """Since the first message was published of those after the last one that the subscriber took of anybody."""
    publisher, subscriber = pair.publisher, pair.subscriber
    if not pair.links or not (_is_seen(publisher, observed) and _is_seen(subscriber, observed)):
        return 0
    link = pair.links[-1]
    # The publisher has not begun anew since then.
    is_same = publisher.cuts[-1] <= link.first and subscriber.times[-1] <= link.until_ns
    if not is_same or not max(pair.ambiguous, default=-1) <= link.last < len(publisher.times) - 1:
        return 0
    longest_ns = int((int64s(pair.receptions) - int64s(pair.publications)).max(initial=0))
    return _stalled_ns(publisher.times[link.last + 1], longest_ns, observed)


def _unended_ns(log: CallbackLog, called: Mapping[CallbackLog, int], observed: FlowAccumulator) -> int:
    """Since a callback began."""
    if log not in called:
        return 0
    longest_ns = int((int64s(log.ends) - int64s(log.begins)).max(initial=0))
    return _stalled_ns(called[log], longest_ns, observed)


def _intervals(role: str, end: End) -> Stream:
    """The times at one end of a topic, and what became of the messages there."""
    cuts = int64s(end.cuts)
    remarks: tuple[str, ...] = ()
    counts = {"messages": len(end.times)}
    if role == PUBLISHER:
        counts["never_taken"] = end.forgotten
    else:
        decided = {
            "received": end.received,
            "duplicate": end.duplicates,
            "ambiguous": end.ambiguous,
            "historic": end.historic,
            "unmatched": end.unmatched,
        }
        counts |= decided | {"waiting": len(end.times) - sum(decided.values())}
        if end.unmatched:
            # Of which publisher these are is not known, so they are no loss of a pair.
            remarks = (
                f"{counted(end.unmatched, 'message')} came whose publication was not seen, of whatever publisher:"
                " published before, in a gap, by a program that is not observed, too long ago, or by ROS 1 with a"
                " header whose stamp is no wall time",
            )
    return Stream(
        kind=StreamKind.INTERVALS,
        identity=interval_identity(role, end),
        columns={"timestamp_ns": int64s(end.times)},
        counts=counts,
        cuts=cuts[cuts > 0],
        remarks=remarks,
        source=end,
    )
