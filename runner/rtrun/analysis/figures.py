"""The figures of one series: n, min, mean, max, standard deviation, percentiles, ten highest and ten lowest values.

Two million samples take a few passes over memory: one counting pass finds the bin of every order statistic, and only
the values in those bins are read again. Nothing is sorted whole.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.histogram import Histogram, Int64s

PERCENTILES = (50.0, 90.0, 95.0, 99.0, 99.9, 99.99, 99.999)
PERCENTILE_METHOD = "inverted_cdf"
LISTED = 10
# Beyond this no difference of two values can overflow an int64; it is 146 years.
LIMIT_NS = 1 << 62
_BINS = 1 << 21
_PIECE = 1 << 13  # stays in the cache, and is too short for BLAS to start threads


@dataclass(frozen=True, kw_only=True, slots=True)
class IndexedValue:
    """A value and the index of its measurement; None where the order of the measurements was not kept."""

    value_ns: int
    index: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Figures:
    """Figures of one series. With ``n == 0`` every number is None and every list empty.

    ``percentiles_ns[p]`` is the smallest measured value that at least p percent of the values do not exceed (inverse
    of the empirical distribution function, definition 1 in Hyndman and Fan, "Sample Quantiles in Statistical Packages",
    The American Statistician 50 (1996) 361-365): never an interpolation, so the 99.9th percentile of fewer than 1000
    values is their maximum. ``std_ns`` is the sample standard deviation (divisor n - 1; 0 for one value). ``top``
    falls from the highest, ``lowest`` rises from the lowest value; equal values stand in the order of their
    measurement. Figures of a histogram are lower bin edges, as the 2014 programs print them; ``bin_ns`` is the width of
    a bin, 1 for samples. ``overflow`` values are known by number only: a figure that depends on them is None unless
    the program that measured printed it.
    """

    n: int
    min_ns: int | None = None
    mean_ns: float | None = None
    max_ns: int | None = None
    std_ns: float | None = None
    percentiles_ns: dict[float, int] = field(default_factory=dict)
    top: tuple[IndexedValue, ...] = ()
    lowest: tuple[IndexedValue, ...] = ()
    bin_ns: int = 1
    overflow: int = 0


def rank(n: int, percent: float) -> int:
    """The 1-based rank of a percentile among n values, in whole numbers so that no rounding moves it."""
    return max(1, -(-n * round(percent * 1000) // 100_000))


def figures_of_samples(values_ns: Int64s, indices: NDArray[np.int64] | None = None) -> Figures:
    """Figures of int64 samples, shape (n,).

    Values that were never measured (not fired, missing) must be left out; `indices`, shape (n,), then gives each
    value's loop index, else it is its position. Raises ValueError for another type, or a value beyond 146 years.
    """
    if values_ns.dtype != np.int64 or values_ns.ndim != 1:
        raise ValueError(f"expected int64 of shape (n,), got {values_ns.dtype} of shape {values_ns.shape}")
    n = values_ns.size
    if n == 0:
        return Figures(n=0)
    low, high = int(values_ns.min()), int(values_ns.max())
    if low < -LIMIT_NS or high > LIMIT_NS:
        raise ValueError(f"a value of {low if low < -LIMIT_NS else high} ns is no measured time")

    offsets = values_ns - low
    total = int(offsets.sum()) if high - low < LIMIT_NS // n else sum(map(int, offsets))
    variance = _squares(offsets, total / n) / (n - 1) if n > 1 else 0.0
    order = _OrderStatistics(offsets, high - low)
    listed = min(LISTED, n)

    def extreme(positions: NDArray[np.intp]) -> tuple[IndexedValue, ...]:
        loop = positions if indices is None else indices[positions]
        return tuple(
            IndexedValue(value_ns=int(v), index=int(i)) for v, i in zip(values_ns[positions], loop, strict=True)
        )

    return Figures(
        n=n,
        min_ns=low,
        mean_ns=(low * n + total) / n,  # in whole numbers: nothing cancels
        max_ns=high,
        std_ns=math.sqrt(variance),
        percentiles_ns={p: low + order.at(rank(n, p)) for p in PERCENTILES},
        top=extreme(_first(offsets, offsets >= order.at(n - listed + 1), listed, -1)),
        lowest=extreme(_first(offsets, offsets <= order.at(listed), listed, 1)),
    )


def _squares(offsets: Int64s, mean: float) -> float:
    """Sum of squared distances from the mean, in pieces that stay in the cache."""
    piece = np.empty(min(_PIECE, offsets.size))
    total = 0.0
    for start in range(0, offsets.size, _PIECE):
        part = offsets[start : start + _PIECE]
        spread = np.subtract(part, mean, out=piece[: part.size])
        total += float(np.dot(spread, spread))
    return total


def _first(offsets: Int64s, within: NDArray[np.bool_], count: int, sign: int) -> NDArray[np.intp]:
    """Positions of the `count` lowest (sign 1) or highest (-1) offsets among those `within`, equal ones by position."""
    candidates = np.flatnonzero(within)
    return candidates[np.argsort(sign * offsets[candidates], kind="stable")][:count]


class _OrderStatistics:
    """Order statistics of non-negative offsets, from the counts of ``(offsets - start) >> shift``.

    The bins cover where a thin sample of the values lies; the first and last also hold everything beyond, so that one
    value of an hour does not make the bins of the others coarse.
    """

    def __init__(self, offsets: Int64s, span: int) -> None:
        self._offsets = offsets
        self._start, stop = 0, span
        if span >= _BINS:
            thin = offsets[:: max(1, offsets.size // 4096)]
            first, last = int(thin.min()), int(thin.max())
            self._start, stop = first, last
        self._shift = max(0, (stop - self._start).bit_length() - (_BINS.bit_length() - 1))
        bins = offsets - self._start if self._start else offsets
        if self._shift:
            bins = bins >> self._shift
        self._last = (stop - self._start) >> self._shift
        if self._start or stop < span:
            bins = np.clip(bins, 0, self._last)
        self._exact = bins is offsets
        self._below = np.cumsum(np.bincount(bins))
        self._sorted_bins: dict[int, Int64s] = {}

    def at(self, rank: int) -> int:
        """The rank-th smallest offset, rank from 1."""
        index = int(np.searchsorted(self._below, rank))
        if not self._shift and (self._exact or 0 < index < self._last):
            return self._start + index
        if index not in self._sorted_bins:
            edge = self._start + (index << self._shift)
            inside = self._offsets < edge + (1 << self._shift) if index < self._last else self._offsets >= edge
            if 0 < index < self._last:
                inside &= self._offsets >= edge
            self._sorted_bins[index] = np.sort(self._offsets[inside])
        before = int(self._below[index - 1]) if index else 0
        return int(self._sorted_bins[index][rank - 1 - before])


def figures_of_histogram(
    histogram: Histogram, *, top: tuple[IndexedValue, ...] = (), lowest: tuple[IndexedValue, ...] = ()
) -> Figures:
    """Figures of counts, shape of both arrays (bins,).

    `top` and `lowest` are lists of the same values, best first, that a log prints with their indices; a value beyond
    the end of a list has no index.
    """
    if histogram.n == 0:
        return Figures(n=0, bin_ns=histogram.bin_ns)
    values, counts = histogram.values_ns, histogram.counts
    n = histogram.n
    common = Figures(
        n=n, mean_ns=histogram.mean_ns, max_ns=histogram.max_ns, bin_ns=histogram.bin_ns, overflow=histogram.overflow
    )
    if values.size == 0:
        return common
    below = np.cumsum(counts)
    seen = int(below[-1])
    common = replace(
        common,
        min_ns=int(values[0]),
        percentiles_ns={p: int(values[np.searchsorted(below, rank(n, p))]) for p in PERCENTILES if rank(n, p) <= seen},
        lowest=_with_indices(_repeat(values, counts), lowest),
    )
    if histogram.overflow:
        return common
    total = sum(int(v) * int(c) for v, c in zip(values, counts, strict=True))
    mean = total / n
    spread = values - mean
    variance = float(np.dot(spread * spread, counts)) / (n - 1) if n > 1 else 0.0
    return replace(
        common,
        mean_ns=mean,
        max_ns=int(values[-1]),
        std_ns=math.sqrt(variance),
        top=_with_indices(_repeat(values[::-1], counts[::-1]), top),
    )


def _repeat(values: Int64s, counts: Int64s) -> Int64s:
    """The first ten values, each as often as it was counted."""
    return np.repeat(values[:LISTED], np.minimum(counts[:LISTED], LISTED))[:LISTED]


def _with_indices(values: Int64s, printed: tuple[IndexedValue, ...]) -> tuple[IndexedValue, ...]:
    indices = [entry.index for entry in printed] + [None] * LISTED
    return tuple(IndexedValue(value_ns=int(v), index=i) for v, i in zip(values, indices, strict=False))
