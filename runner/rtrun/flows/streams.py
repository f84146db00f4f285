"""The streams of an observation: what the accumulator has, with names that outlast a restart and columns to keep."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace

import numpy as np

from rtfiles.output import counted, printable
from rtrun.analysis.histogram import Int64s
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.decided import DecidedMessages
from rtrun.flows.messages import End, MessagePair
from rtrun.flows.paths import PathLog
from rtrun.flows.programs import numbered
from rtrun.flows.rows import Rows, RowStore
from rtrun.flows.threads import CallbackLog
from rtrun.flows.timers import ClockOffsets, TimerLog, known_period_ns, lateness
from rtrun.flows.topics import PUBLISHER
from rtrun.flows.values import Stream, steps
from rtrun.plan.observation import StreamKind
from rtrun.results.columns import PIECE_ROWS, NoRoom, collected

# That a program has ended may be told a round late.
STALL_NS = 3 * 10**9
Identity = dict[str, str | int]


def streams(observed: FlowAccumulator) -> Iterator[Stream]:
    """One value for each thing that was measured, in the order in which they were first seen.

    All of them together may be more than the memory holds.
    """
    seen: dict[tuple[object, ...], int] = {}
    for each in _streams(observed):
        stream = _printable(each)
        # Names that differ in bytes that cannot be printed only are alike when printed.
        key = (stream.kind, *stream.identity.items())
        seen[key] = seen.get(key, 0) + 1
        yield stream if seen[key] == 1 else replace(stream, identity={**stream.identity, "alike": seen[key]})


def _streams(observed: FlowAccumulator) -> Iterator[Stream]:
    store = observed.state.store
    for pair in observed.topics.pairs.values():
        told_apart_by = observed.topics.told_apart_by(pair.publisher.topic)
        with _Reading(StreamKind.MESSAGES, message_identity(pair)) as reading:
            reading.stream = replace(_messages(pair, told_apart_by, store), open_ns=_untaken_ns(pair, observed))
        yield reading.stream
    for timer in observed.calls.timers.values():
        with _Reading(StreamKind.TIMER, timer_identity(timer)) as reading:
            made = _timer(timer, observed.offsets, store)
            reading.stream = replace(made, open_ns=_overdue_ns(made.period_ns, timer, observed))
        yield reading.stream
    called = dict(observed.open_calls())
    for callback in observed.calls.callbacks.values():
        with _Reading(StreamKind.CALLBACK, callback_identity(callback)) as reading:
            reading.stream = replace(_callback(callback), open_ns=_unended_ns(callback, called, observed))
        yield reading.stream
    for (role, _, _), end in observed.topics.ends.items():
        if end.times:
            with _Reading(StreamKind.INTERVALS, interval_identity(role, end)) as reading:
                open_ns = _silent_ns(end.times, end, observed) if role == PUBLISHER else 0
                reading.stream = replace(_intervals(role, end, store), open_ns=open_ns)
            yield reading.stream
    for (number, publisher), log in observed.paths.logs.items():
        path = observed.paths.paths[number]
        with _Reading(StreamKind.PATH, path_identity(path, publisher)) as reading:
            reading.stream = _path(path, publisher, log)
        yield reading.stream


class _Reading:
    """Holds a stream; one that there was no room to read has its trouble instead."""

    def __init__(self, kind: StreamKind, identity: Identity) -> None:
        self.stream = Stream(kind=kind, identity=identity, columns={}, counts={})

    def __enter__(self) -> "_Reading":
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> bool:
        if isinstance(error, NoRoom):
            self.stream = replace(self.stream, trouble=str(error))
            return True
        return False


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


def _messages(pair: MessagePair, told_apart_by: str, store: RowStore) -> Stream:
    decided = DecidedMessages(pair)
    counts = decided.counts()
    remarks: tuple[str, ...] = ()
    if counts.ambiguous:
        unknown = f"not known of {counted(counts.ambiguous, 'publication')} whether they came"
        remarks = (f"{unknown}: other messages have the same {told_apart_by}",)
    return Stream(
        kind=StreamKind.MESSAGES,
        identity=message_identity(pair),
        columns=decided.columns(store),
        counts=asdict(counts),
        remarks=remarks,
        source=pair,
    )


def _timer(log: TimerLog, offsets: ClockOffsets, store: RowStore) -> Stream:
    late = lateness(log, offsets, store)
    counts = {"calls": len(log.rows)}
    if late.at_ns.size:
        cuts = late.cuts
        columns = {"timestamp_ns": late.at_ns, "expected_ns": late.expected_ns, "real_ns": late.real_ns}
        counts["skipped"] = late.skipped
    else:
        cuts = _cuts(log.cuts, store)
        (at_ns,) = collected(store.folder, ((piece[:, 0],) for piece in log.rows.pieces()), 1)
        columns = {"timestamp_ns": at_ns}
    rows = columns["timestamp_ns"].size
    return Stream(
        kind=StreamKind.TIMER,
        identity=timer_identity(log),
        columns=columns | {"segment": _segments(cuts, rows, store)},
        counts=counts | {"measured": rows},
        period_ns=known_period_ns(log),
        cuts=cuts,
        remarks=late.why_not,
        source=log,
    )


def _cuts(cuts: Rows, store: RowStore) -> Int64s:
    """The rows before which hits are missing; before the first row it says nothing."""
    (made,) = collected(store.folder, ((piece[piece > 0],) for piece in cuts.pieces()), 1)
    return made


def _segments(cuts: Int64s, rows: int, store: RowStore) -> Int64s:
    """How many cuts there are up to each row."""
    starts = range(0, rows, PIECE_ROWS)
    numbers = (np.arange(start, min(start + PIECE_ROWS, rows)) for start in starts)
    (made,) = collected(store.folder, ((np.searchsorted(cuts, each, side="right"),) for each in numbers), 1)
    return made


def _callback(log: CallbackLog) -> Stream:
    return _durations(StreamKind.CALLBACK, callback_identity(log), log, {})


def _path(path: tuple[str, ...], publisher: End, log: PathLog) -> Stream:
    outputs = len(log.rows) + log.unknown
    made = _durations(StreamKind.PATH, path_identity(path, publisher), log, {"unknown": log.unknown})
    if not log.unknown:
        return made
    share = f"path unknown: {100 * log.unknown / outputs:.3g} % of {counted(outputs, 'message')} at its end"
    return replace(made, remarks=(share,))


def _durations(kind: StreamKind, identity: Identity, log: CallbackLog | PathLog, counts: dict[str, int]) -> Stream:
    begin, end = log.rows.columns()
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
    return record.latest is not None and record.latest[1].is_alive and record.latest[0] == observed.state.epoch


def _silent_ns(times: Rows, record: End | TimerLog, observed: FlowAccumulator) -> int:
    """Since the last message or call."""
    if not _is_seen(record, observed):
        return 0
    longest_ns = max((int(some.max(initial=0)) for some in steps(times, record.cuts)), default=0)
    return _stalled_ns(times[-1], longest_ns, observed)


def _overdue_ns(period_ns: int | None, log: TimerLog, observed: FlowAccumulator) -> int:
    """Since a call was due."""
    return 0 if period_ns is None else max(0, _silent_ns(log.rows, log, observed) - period_ns)


def _untaken_ns(pair: MessagePair, observed: FlowAccumulator) -> int:
    """Since the first message was published of those after the last one that the subscriber took of anybody."""
    publisher, subscriber = pair.publisher, pair.subscriber
    link = pair.link
    if link is None or not (_is_seen(publisher, observed) and _is_seen(subscriber, observed)):
        return 0
    # The publisher has not begun anew since then.
    is_same = publisher.cuts[-1] <= link.first and subscriber.times[-1] <= link.until_ns
    unclear = max((int(piece.max()) for piece in pair.ambiguous.pieces()), default=-1)
    if not is_same or not unclear <= link.last < len(publisher.times) - 1:
        return 0
    return _stalled_ns(publisher.times[link.last + 1], pair.longest_ns, observed)


def _unended_ns(log: CallbackLog, called: Mapping[CallbackLog, int], observed: FlowAccumulator) -> int:
    """Since a callback began."""
    if log not in called:
        return 0
    longest_ns = max((int(np.diff(piece).max()) for piece in log.rows.pieces()), default=0)
    return _stalled_ns(called[log], longest_ns, observed)


def _intervals(role: str, end: End, store: RowStore) -> Stream:
    """The times at one end of a topic, and what became of the messages there."""
    cuts = _cuts(end.cuts, store)
    (times,) = end.times.columns()
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
        columns={"timestamp_ns": times, "segment": _segments(cuts, times.size, store)},
        counts=counts,
        cuts=cuts,
        remarks=remarks,
        source=end,
    )
