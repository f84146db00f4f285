"""What the accumulator hands out: one `Stream` for each measured thing."""

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

    `identity` names the thing, in printable texts and whole numbers. `columns` are int64 of shape (n,), with times in
    nanoseconds of CLOCK_MONOTONIC unless stated otherwise:

    - messages: `publication_ns`, `reception_ns`, `seq`, in the order of reception; also `callback_end_ns`, if one was
      seen (NOT_SEEN_NS in rows without). `seq` counts the messages of the publisher whose fate is known: numbers that
      are missing between two rows were lost.
    - timer: `timestamp_ns`; if lateness is known, also `expected_ns` and `real_ns`, both of the timer's own clock. In
      an observation also `segment`, as for intervals.
    - callback and path: `begin_ns`, `end_ns`.
    - service: the same, `taken_ns` and `answered_ns` (NOT_SEEN_NS in rows without).
    - intervals: `timestamp_ns`, and `segment`: how many cuts there are up to a row.

    Long columns are in files: `pieces` reads them some rows at a time. `cuts`, int64, are rows before which hits are
    missing, or the program began again: such a row must not be joined with the one before. `period_ns` is the period of
    a timer, if known. `remarks` are sentences on what is not known, and why. `open_ns` is the least length of a value
    that had not come at the end although its program lives; otherwise 0. `more_open_ns` are those of further ones.
    `source` is the record that the stream was read from, which identifies the stream while it grows. `trouble` is why
    the columns could not be read; there are none then.
    """

    kind: StreamKind
    identity: Mapping[str, str | int]
    columns: Mapping[str, Int64s]
    counts: Mapping[str, int]
    cuts: Int64s = field(default_factory=no_values)
    period_ns: int | None = None
    remarks: tuple[str, ...] = ()
    open_ns: int = 0
    more_open_ns: tuple[int, ...] = ()
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
    """The median of the differences; for long columns, the median of the pieces' medians. None without differences."""
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
