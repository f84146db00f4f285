"""Counts of values: all that is left of a measurement when only its log remains."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rtrun.kinds.lateness import are_late, is_late
from rtrun.kinds.values import Int64s, pieces

# The difference of two values from -LIMIT_NS to LIMIT_NS - 1 fits into an int64; it is 146 years.
LIMIT_NS = 1 << 62


@dataclass(frozen=True, kw_only=True)
class Histogram:
    """Bins of equal width: ``values_ns[i]`` is the lower edge of a bin that holds ``counts[i]`` measurements.

    ``values_ns`` is strictly ascending, ``counts`` are positive; both int64. ``overflow`` values lie at or above
    ``overflow_from_ns``, and only their number is known (cyclictest -h counts them so). ``max_ns`` and ``mean_ns`` are
    the largest and the mean of all values, including the overflow, where the measuring program printed them.
    """

    values_ns: Int64s
    counts: Int64s
    bin_ns: int = 1000
    overflow: int = 0
    overflow_from_ns: int | None = None
    max_ns: int | None = None
    mean_ns: float | None = None

    @property
    def n(self) -> int:
        """Measurements, including the overflow."""
        return int(self.counts.sum()) + self.overflow

    def above(self, limit_ns: int) -> int:
        """Measurements above a limit. The bin that holds the limit counts as above, unless the limit ends the bin.

        A printed largest value is the lower edge of a bin, too.
        Raises ValueError when the limit lies in the overflow, where nothing is known.
        """
        if self.overflow and self.max_ns is not None and not is_late(self.max_ns + self.bin_ns - 1, limit_ns):
            return 0
        if self.overflow and (self.overflow_from_ns is None or limit_ns > self.overflow_from_ns):
            raise ValueError("the deadline lies beyond the histogram's last bin, where values are only counted")
        return int(self.counts[are_late(self.values_ns, limit_ns, self.bin_ns)].sum()) + self.overflow

    def unclear(self, limit_ns: int) -> int:
        """How many of the measurements that `above` counts may lie at or below the limit, in the same bin."""
        holds_limit = are_late(self.values_ns, limit_ns, self.bin_ns) & ~are_late(self.values_ns, limit_ns)
        return int(self.counts[holds_limit].sum())


def from_samples(values_ns: Int64s, bin_ns: int = 1000) -> Histogram:
    """The histogram of int64 samples of any shape; bins start at whole multiples of `bin_ns` (floor).

    Raises ValueError for a value beyond 146 years.
    """
    if values_ns.size == 0:
        return Histogram(values_ns=np.empty(0, np.int64), counts=np.empty(0, np.int64), bin_ns=bin_ns)
    values = values_ns.ravel()
    lowest, highest = int(values.min()), int(values.max())
    check_range(lowest, highest)
    low, high = lowest // bin_ns, highest // bin_ns
    if high - low >= max(1 << 20, 4 * values.size):
        edges, counts = np.unique(np.floor_divide(values, bin_ns), return_counts=True)
        return Histogram(values_ns=edges * bin_ns, counts=counts.astype(np.int64), bin_ns=bin_ns)
    counts = np.zeros(high - low + 1, np.int64)
    # A piece has at least as many values as there are bins, so adding up the bins costs no more than filling them.
    for piece in pieces(values.size, counts.size):
        bins = np.floor_divide(values[piece], bin_ns)
        counts += np.bincount(np.subtract(bins, low, out=bins), minlength=counts.size)
    filled = np.flatnonzero(counts)
    return Histogram(values_ns=(filled + low) * bin_ns, counts=counts[filled], bin_ns=bin_ns)


def check_range(low: int, high: int) -> None:
    """Raise ValueError if the lowest or the highest value is beyond 146 years."""
    if low < -LIMIT_NS or high >= LIMIT_NS:
        raise ValueError(f"a value of {low if low < -LIMIT_NS else high} ns is no measured time")


def merge(parts: Iterable[Histogram]) -> Histogram:
    """The sum of histograms of one bin width, without a printed mean.

    If they overflow at different values, all values from the lowest of these on are counted as overflow. Raises
    ValueError when widths differ.
    """
    all_parts = list(parts)
    if not all_parts:
        return from_samples(np.empty(0, np.int64))
    if len({part.bin_ns for part in all_parts}) > 1:
        raise ValueError("histograms of different bin widths cannot be added")
    limit_ns = min((part.overflow_from_ns or 0 for part in all_parts if part.overflow), default=None)
    values = np.concatenate([part.values_ns for part in all_parts])
    counts = np.concatenate([part.counts for part in all_parts])
    order = np.argsort(values, kind="stable")
    values, counts = values[order], counts[order]
    starts = np.flatnonzero(np.diff(values, prepend=values[:1] - 1)) if values.size else np.empty(0, np.int64)
    values, counts = values[starts], np.add.reduceat(counts, starts) if values.size else counts
    known = len(values) if limit_ns is None else int(np.searchsorted(values, limit_ns))
    return Histogram(
        values_ns=values[:known],
        counts=counts[:known],
        bin_ns=all_parts[0].bin_ns,
        overflow=sum(part.overflow for part in all_parts) + int(counts[known:].sum()),
        overflow_from_ns=limit_ns,
        max_ns=_largest(all_parts),
    )


def _largest(parts: list[Histogram]) -> int | None:
    """The largest value of all; None where a part does not know its own."""
    largest = []
    for part in parts:
        if part.max_ns is None and part.overflow:
            return None
        if part.max_ns is not None:
            largest.append(part.max_ns)
        elif part.values_ns.size:
            largest.append(int(part.values_ns[-1]))
    return max(largest, default=None)
