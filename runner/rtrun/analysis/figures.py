"""The figures of one series: n, min, mean, max, standard deviation, percentiles, ten highest and ten lowest values.

Two million samples take a few passes over memory: one counts values in coarse bins, and only the values in the bins of
the order statistics are read again. Nothing is sorted whole.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.histogram import LIMIT_NS, Histogram, check_range
from rtrun.kinds.values import PIECE, Int64s, pieces

PERCENTILES = (50.0, 90.0, 95.0, 99.0, 99.9, 99.99, 99.999)
PERCENTILE_METHOD = "inverted_cdf"
LISTED = 10
_BINS = 1 << 13
_THIN = 4096


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
    a bin, 1 for samples. Only the number of ``overflow`` values is known: a figure that depends on them is None unless
    the measuring program printed it.
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
    start, stop = _thin_range(values_ns)
    binned = _bins(values_ns, start, stop)
    low, high = binned.low, binned.high
    check_range(low, high)
    listed = min(LISTED, n)
    ordered, positions = _order_statistics(values_ns, binned, listed)
    lowest, highest, percentiles = ordered[:listed], ordered[listed : 2 * listed], ordered[2 * listed :]
    total = binned.total if max(-low, high) < LIMIT_NS // PIECE else sum(values_ns.tolist())
    from_start = total - start * n
    variance = max(0.0, binned.squares - from_start**2 / n) / (n - 1) if n > 1 else 0.0

    def indexed(limit: int, sign: int) -> tuple[IndexedValue, ...]:
        """The highest (sign 1) or lowest (-1) values, equal ones by position."""
        beyond = positions[sign * values_ns[positions] >= sign * limit]
        beyond = beyond[np.argsort(-sign * values_ns[beyond], kind="stable")][:listed]
        loop = beyond if indices is None else indices[beyond]
        return tuple(IndexedValue(value_ns=int(v), index=int(i)) for v, i in zip(values_ns[beyond], loop, strict=True))

    return Figures(
        n=n,
        min_ns=low,
        mean_ns=total / n,  # from a whole number: nothing cancels
        max_ns=high,
        std_ns=math.sqrt(variance),
        percentiles_ns=dict(zip(PERCENTILES, percentiles, strict=True)),
        top=indexed(highest[0], 1),
        lowest=indexed(lowest[-1], -1),
    )


def _thin_range(values: Int64s) -> tuple[int, int]:
    """The range in which nearly all values lie, from a thin sample: one value of an hour does not widen it."""
    thin = np.sort(values[:: max(1, values.size // _THIN)])
    beyond = thin.size // 1000
    return int(thin[beyond]), int(thin[-1 - beyond])


@dataclass(frozen=True, kw_only=True, slots=True)
class _Binned:
    """Values sorted into bins, and what else the same pass over them gives.

    Bins are equally wide; the first and the last also hold all beyond. Rounding may move an edge, but a higher value is
    never in a lower bin, which is all that order statistics need.
    """

    places: NDArray[np.uint16]
    """The bin of each value."""
    counts: Int64s
    """The values in each bin."""
    low: int
    high: int
    total: int
    """The sum, if that of PIECE values fits into an int64."""
    squares: float
    """The sum of the squared distances from where the bins start."""


def _bins(values: Int64s, start: int, stop: int) -> _Binned:
    """Sort values into bins from `start` to `stop`."""
    places, counts = np.empty(values.size, np.uint16), np.zeros(_BINS, np.int64)
    size = min(PIECE, values.size)
    integers, floats = np.empty(size, np.int64), np.empty(size)
    lows, highs, total, squares = [], [], 0, 0.0
    for piece in pieces(values.size):
        part, place = values[piece], places[piece]
        lows.append(int(part.min()))
        highs.append(int(part.max()))
        total += int(part.sum())
        # Whole numbers are subtracted: a float64 holds no time of half a year to the ns.
        whole, distances = np.subtract(part, start, out=integers[: part.size]), floats[: part.size]
        np.copyto(distances, whole)
        squares += float(np.einsum("i,i", distances, distances))  # BLAS would start threads
        np.multiply(distances, _BINS / (stop - start + 1), out=distances)
        np.clip(distances, 0, _BINS - 1, out=distances)
        np.copyto(place, distances, casting="unsafe")
        np.copyto(whole, place)  # bincount takes int64 without a copy of its own
        counts += np.bincount(whole, minlength=_BINS)
    return _Binned(places=places, counts=counts, low=min(lows), high=max(highs), total=total, squares=squares)


def _order_statistics(values: Int64s, binned: _Binned, listed: int) -> tuple[list[int], NDArray[np.intp]]:
    """The `listed` lowest values and the `listed` highest, both rising, then the percentiles.

    Also the positions of all values in the bins of these.
    """
    n = values.size
    ranks = [*range(1, listed + 1), *range(n - listed + 1, n + 1), *(rank(n, p) for p in PERCENTILES)]
    of_ranks = np.searchsorted(np.cumsum(binned.counts), ranks)
    # All bins up to the last of the lowest and from the first of the highest on are wanted, and few between.
    below, above = int(of_ranks[listed - 1]), int(of_ranks[listed])
    # Small sets: np.unique would load numpy.ma, which takes as long as all of this.
    between = [place for place in set(of_ranks[2 * listed :].tolist()) if below < place < above]
    wanted = np.zeros(_BINS, np.bool_)
    wanted[: below + 1] = wanted[above:] = wanted[between] = True
    positions = np.concatenate([_places_among(binned.places, piece, below, above, between) for piece in pieces(n)])
    # Among these values, a rank is lower by the number of values in unwanted lower bins.
    left_out = np.cumsum(np.where(wanted, 0, binned.counts))
    among = np.array(ranks) - 1 - left_out[of_ranks]
    ordered = np.partition(values[positions], list(set(among.tolist())))
    return ordered[among].tolist(), positions


def _places_among(
    places: NDArray[np.uint16], piece: slice, below: int, above: int, between: list[int]
) -> NDArray[np.intp]:
    """Which elements of a piece have a place that is at most `below`, at least `above`, or one of `between`.

    Comparing whole pieces a few times takes a third of the time of looking up each place in a table.
    """
    part = places[piece]
    chosen = part <= below
    chosen |= part >= above
    for place in between:
        chosen |= part == place
    chosen_at: NDArray[np.intp] = np.flatnonzero(chosen) + piece.start
    return chosen_at


def figures_of_histogram(
    histogram: Histogram, *, top: tuple[IndexedValue, ...] = (), lowest: tuple[IndexedValue, ...] = ()
) -> Figures:
    """Figures of counts, shape of both arrays (bins,).

    `top` and `lowest` are the values that a log lists with their indices, the most extreme first. Values that it does
    not list have no index.
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
