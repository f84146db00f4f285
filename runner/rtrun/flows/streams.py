"""The streams of an observation: what the accumulator has, with names that outlast a restart and columns to keep."""

from collections.abc import Iterator
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
        yield _messages(pair)
    for timer in observed.calls.timers.values():
        yield _timer(timer, observed.offsets)
    for callback in observed.calls.callbacks.values():
        yield _callback(callback)
    for (role, _, _), end in observed.topics.ends.items():
        if end.times:
            yield _intervals(role, end, _stalled_ns(role, end, observed))
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


def _messages(pair: MessagePair) -> Stream:
    counts = pair.counts()
    remarks: tuple[str, ...] = ()
    if counts.ambiguous:
        remarks = (f"not known of {counted(counts.ambiguous, 'publication')} whether they came: the same bytes again",)
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


def _stalled_ns(role: str, end: End, observed: FlowAccumulator) -> int:
    """For how long a publisher that lives has sent nothing at the end, if that is longer than ever before; else 0."""
    if role != PUBLISHER or end.latest is None:
        return 0
    epoch, endpoint = end.latest
    since_ns = observed.until_ns - end.times[-1]
    longest_ns = int(differences(int64s(end.times), int64s(end.cuts)).max(initial=STALL_NS))
    is_seen = endpoint.is_alive and epoch == observed.situation.epoch
    return since_ns if is_seen and since_ns > longest_ns else 0


def _intervals(role: str, end: End, stalled_ns: int) -> Stream:
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
        open_ns=stalled_ns,
        source=end,
    )
