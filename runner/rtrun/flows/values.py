"""What the accumulator hands out: one value for each measured stream."""

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rtrun.analysis.histogram import Int64s
from rtrun.kinds.output import no_values
from rtrun.plan.observation import StreamKind


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stream:
    """All that was measured of one thing. No two streams of an observation have the same kind and identity.

    `identity` says of what, in printable texts and whole numbers. `columns` are int64 of shape (n,), times in
    nanoseconds of CLOCK_MONOTONIC unless said otherwise:

    - messages: `publication_ns`, `reception_ns`, `seq`, in the order of reception; with `callback_end_ns`
      (NOT_SEEN_NS where no probe saw it) where one was seen. `seq` counts the messages of the publisher whose fate is
      known, so what is missing between two of them was lost.
    - timer: `timestamp_ns`; where lateness is known also `expected_ns` and `real_ns`, both of the timer's own clock.
    - callback and path: `begin_ns`, `end_ns`.
    - intervals: `timestamp_ns`.

    `cuts`, int64, are rows before which hits are missing, or the program began again: that row may not be joined with
    the one before. `period_ns` is that of a timer, where it is known. `remarks` are sentences on what is not known, and
    why. `open_ns` is how long a value is at least that had not come at the end, though its program lives; 0 where there
    is none. `source` is the record that it was read from, by which the same stream is known while it grows.
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


def int64s(values: "array[int]", begin: int = 0) -> Int64s:
    """A copy of growing values from an index on; int64 of shape (n,)."""
    return np.frombuffer(values[begin:], np.int64) if len(values) > begin else no_values()


def differences(times_ns: Int64s, cuts: Int64s) -> Int64s:
    """From each time to the next one, int64, but not across a cut."""
    steps = np.diff(times_ns)
    inner = cuts[(cuts > 0) & (cuts < times_ns.size)]
    return np.delete(steps, inner - 1) if inner.size else steps
