"""The interface of a kind of stream to the accumulator: each measured thing, as a whole, and its new rows."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.messages import Copies, End
from rtrun.flows.rows import Rows, RowStore
from rtrun.flows.timers import TimerLog
from rtrun.flows.values import Stream, steps
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.values import Int64s, no_values
from rtrun.results.columns import PIECE_ROWS, collected

# The end of a program may be reported a round late.
STALL_NS = 3 * 10**9
Identity = dict[str, str | int]


@dataclass(frozen=True, slots=True)
class Growth:
    """A stream as it is now: how many rows it has, its new values, int64 (n,), and when each was there.

    The values of the first `settled` rows will not change. `lost` may still fall when a message comes late. `skipped`
    are periods without a value.
    """

    rows: int
    values_ns: Int64s
    times_ns: Int64s
    settled: int
    lost: int | None = None
    skipped: int = 0
    tid: int | None = None
    """The thread of the values; None: the hits at their times tell it."""


class StreamSource(Protocol):
    """One measured thing. `name` and `detail` are shown while it grows."""

    @property
    def record(self) -> object:
        """The accumulator's record, which identifies it while it grows."""

    @property
    def identity(self) -> Identity:
        """What identifies it among others of its kind, also after a restart."""

    @property
    def name(self) -> str: ...

    @property
    def detail(self) -> str: ...

    def stream(self) -> Stream:
        """The whole stream, with values that had not come at the end."""

    def since(self, row: int) -> Growth:
        """What is new from a row on."""


class ObservedKind(Protocol):
    """A module of this folder: a kind of stream, and its sources in the order in which they were first seen."""

    STREAM: StreamKind

    def sources(self, observed: FlowAccumulator) -> Iterator[StreamSource]: ...


def stalled_ns(since_ns: int, longest_ns: int, observed: FlowAccumulator, until_ns: int | None = None) -> int:
    """How long nothing had come at the end, or until a time, if that is longer than ever before; otherwise 0."""
    passed_ns = (observed.until_ns if until_ns is None else until_ns) - since_ns
    return passed_ns if passed_ns > max(STALL_NS, longest_ns) else 0


def is_seen(record: End | TimerLog, observed: FlowAccumulator) -> bool:
    """Whether the thing lives, and no hits have been missing since its last hit."""
    return record.latest is not None and record.latest[1].is_alive and record.latest[0] == observed.state.epoch


def silent_ns(times: Rows, record: End | TimerLog, observed: FlowAccumulator, until_ns: int | None = None) -> int:
    """The time since the last message or call, at the end or at a time, if longer than ever before; otherwise 0."""
    if not is_seen(record, observed):
        return 0
    longest_ns = max((int(some.max(initial=0)) for some in steps(times, record.cuts)), default=0)
    return stalled_ns(times[-1], longest_ns, observed, until_ns)


def cuts_of(cuts: Rows, store: RowStore) -> Int64s:
    """The rows before which hits are missing; a cut before the first row is left out."""
    (rows,) = collected(store.folder, ((piece[piece > 0],) for piece in cuts.pieces()), 1)
    return rows


def segments(cuts: Int64s, rows: int, store: RowStore) -> Int64s:
    """How many cuts there are up to each row."""
    starts = range(0, rows, PIECE_ROWS)
    numbers = (np.arange(start, min(start + PIECE_ROWS, rows)) for start in starts)
    (counts,) = collected(store.folder, ((np.searchsorted(cuts, piece, side="right"),) for piece in numbers), 1)
    return counts


def without_values(kind: StreamKind, source: StreamSource, copies: Copies) -> Stream:
    """The stream of messages that a process passes by pointer, and of which it took copies: it has no values."""
    return Stream(
        kind=kind,
        identity=source.identity,
        columns=dict.fromkeys(kind.columns, no_values()),
        counts={"copies": len(copies)},
        remarks=(str(copies),),
        source=source.record,
    )


def spans_since(rows: Rows, row: int) -> Growth:
    """The new part of rows whose first two numbers are a begin and an end."""
    begins, ends, *_ = rows.read(row).T
    return Growth(len(rows), ends - begins, ends, len(rows))
