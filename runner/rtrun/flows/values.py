"""What the accumulator hands out: one value for each measured stream."""

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from rtrun.flows.rows import Rows
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.values import Int64s, no_values
from rtrun.results.columns import PIECE_ROWS, pieces


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stream:
    """All that was measured of one thing. No two streams of an observation have the same kind and identity.

    `identity` says of what, in printable texts and whole numbers. `columns` are int64 of shape (n,), times in
    nanoseconds of CLOCK_MONOTONIC unless said otherwise:

    - messages: `publication_ns`, `reception_ns`, `seq`, in the order of reception; with `callback_end_ns`
      (NOT_SEEN_NS where no probe saw it) where one was seen. `seq` counts the messages of the publisher whose fate is
      known, so what is missing between two of them was lost.
    - timer: `timestamp_ns`; where lateness is known also `expected_ns` and `real_ns`, both of the timer's own clock.
      Of an observation also `segment`, as of intervals.
    - callback and path: `begin_ns`, `end_ns`.
    - intervals: `timestamp_ns`, and `segment`: how many cuts there are up to a row.

    Long columns are in files: `pieces` reads them some rows at a time. `cuts`, int64, are rows before which hits are
    missing, or the program began again: that row may not be joined with the one before. `period_ns` is that of a timer,
    where it is known. `remarks` are sentences on what is not known, and why. `open_ns` is how long a value is at least
    that had not come at the end, though its program lives; 0 where there is none. `source` is the record that it was
    read from, by which the same stream is known while it grows. `trouble` says why its columns could not be read; there
    are none then.
    """

    kind: StreamKind
    identity: Mapping[str, str | int]
    columns: Mapping[str, Int64s]
    counts: Mapping[str, int]
    cuts: Int64s = field(default_factory=no_values)
    period_ns: int | None = None
    remarks: tuple[str, ...] = ()
    open_ns: int = 0
    source: object = None
    trouble: str = ""


def int64s(values: "array[int]") -> Int64s:
    """A copy of growing values; int64 of shape (n,)."""
    return np.frombuffer(values[:], np.int64) if values else no_values()


def differences(times_ns: Int64s, cuts: Int64s) -> Int64s:
    """From each time to the next one, int64, but not across a cut."""
    steps = np.diff(times_ns)
    inner = cuts[(cuts > 0) & (cuts < times_ns.size)]
    return np.delete(steps, inner - 1) if inner.size else steps


def typical_step(times_ns: Int64s, cuts: Int64s) -> int | None:
    """The median of the differences, of long columns that of the medians of their pieces; None without any."""
    medians, begin = [], 0
    for (piece,) in pieces(times_ns):
        first, last = np.searchsorted(cuts, [begin, begin + piece.size])
        if (steps := differences(piece, cuts[first:last] - begin)).size:
            medians.append(float(np.median(steps)))
        begin += piece.size
    return int(np.median(medians)) if medians else None


def steps(times: Rows, cuts: Rows) -> Iterator[Int64s]:
    """From each time to the next one, int64, but not across a cut; some at a time."""
    for begin in range(0, len(times), PIECE_ROWS):
        from_row, end = max(begin - 1, 0), begin + PIECE_ROWS
        yield differences(times.read(from_row, end)[:, 0], cuts.between(from_row, end) - from_row)
