"""What a kind of stream has in the accumulator: each thing that was measured, whole, and what is new of it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.messages import End
from rtrun.flows.rows import Rows, RowStore
from rtrun.flows.timers import TimerLog
from rtrun.flows.values import Stream, steps
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.values import Int64s
from rtrun.results.columns import PIECE_ROWS, collected

# That a program has ended may be told a round late.
STALL_NS = 3 * 10**9
Identity = dict[str, str | int]


@dataclass(frozen=True, slots=True)
class Growth:
    """A stream as it is now: how many rows it has, its new values, int64 (n,), and when each was there.

    Of the rows, `settled` many have values that will not change; `lost` may still fall, as a message comes late.
    """

    rows: int
    values_ns: Int64s
    times_ns: Int64s
    settled: int
    lost: int | None = None


class StreamSource(Protocol):
    """One thing that is measured. `name` and `of` are how it is shown while it grows."""

    @property
    def record(self) -> object:
        """What the accumulator has of it, by which it is known while it grows."""

    @property
    def identity(self) -> Identity:
        """What tells it from the others of its kind; it outlasts a restart."""

    @property
    def name(self) -> str: ...

    @property
    def of(self) -> str: ...

    def stream(self) -> Stream:
        """All of it, with what had not come at the end."""

    def since(self, row: int) -> Growth:
        """What is new from a row on."""


class ObservedKind(Protocol):
    """A module of this room: a kind of stream, and its sources in the order in which they were first seen."""

    STREAM: StreamKind

    def sources(self, observed: FlowAccumulator) -> Iterator[StreamSource]: ...


def stalled_ns(since_ns: int, longest_ns: int, observed: FlowAccumulator) -> int:
    """For how long something has not come at the end, if that is longer than ever before; else 0."""
    passed_ns = observed.until_ns - since_ns
    return passed_ns if passed_ns > max(STALL_NS, longest_ns) else 0


def is_seen(record: End | TimerLog, observed: FlowAccumulator) -> bool:
    """Whether it lives, and no hits are missing since its last one."""
    return record.latest is not None and record.latest[1].is_alive and record.latest[0] == observed.state.epoch


def silent_ns(times: Rows, record: End | TimerLog, observed: FlowAccumulator) -> int:
    """Since the last message or call."""
    if not is_seen(record, observed):
        return 0
    longest_ns = max((int(some.max(initial=0)) for some in steps(times, record.cuts)), default=0)
    return stalled_ns(times[-1], longest_ns, observed)


def cuts_of(cuts: Rows, store: RowStore) -> Int64s:
    """The rows before which hits are missing; before the first row it says nothing."""
    (made,) = collected(store.folder, ((piece[piece > 0],) for piece in cuts.pieces()), 1)
    return made


def segments(cuts: Int64s, rows: int, store: RowStore) -> Int64s:
    """How many cuts there are up to each row."""
    starts = range(0, rows, PIECE_ROWS)
    numbers = (np.arange(start, min(start + PIECE_ROWS, rows)) for start in starts)
    (made,) = collected(store.folder, ((np.searchsorted(cuts, each, side="right"),) for each in numbers), 1)
    return made


def spans_since(rows: Rows, row: int) -> Growth:
    """What is new of rows with a begin and an end."""
    begins, ends = rows.read(row).T
    return Growth(len(rows), ends - begins, ends, len(rows))
