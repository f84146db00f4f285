"""What is kept of one series of one run: small, and enough for every verdict, figure and plot of the report."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.blocks import Blocks, cut, split_randomly
from rtrun.analysis.extreme_values import Tail, tail_of
from rtrun.analysis.figures import PERCENTILES, Figures, rank
from rtrun.analysis.histogram import Histogram, Int64s, from_samples, merge
from rtrun.analysis.trials import Trials, count_misses, count_misses_in_histogram
from rtrun.kinds.known import MAIN_2014
from rtrun.plan.question import NONE_TOLERATED, Question, Tolerance
from rtrun.results.series import Header, HistogramSeries, SampleSeries, Series

_COLUMNS = 240
# Half of the 1 ms by which the thesis found the negative cluster set off (section 4.2.2).
CLUSTER_BELOW_NS = -500_000


@dataclass(frozen=True, kw_only=True, slots=True)
class Cluster:
    """Values below -500 us of a jitter series: the fraction of all values that they are, and where they lie."""

    n: int
    fraction: float
    median_ns: int | None
    low_ns: int | None
    high_ns: int | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThinnedSeries:
    """A series over its loops, thinned: ``low_ns`` and ``high_ns`` (c,) of consecutive columns of ``width`` loops."""

    low_ns: Int64s
    high_ns: Int64s
    width: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Digest:
    """One series of one run.

    Main series have all fields; those of 2014 beside a main series have no tail and no course, and tolerate no miss;
    the others have only figures, cluster and ``mean_abs_ns``.
    """

    header: Header
    figures: Figures
    mean_abs_ns: float | None
    max_abs_ns: int | None
    cluster: Cluster | None
    histogram: Histogram
    trials: Trials | None
    undecidable: str | None
    tail: Tail | None
    blocks: Blocks | None
    course: ThinnedSeries | None

    @property
    def run(self) -> str:
        """Name of its run."""
        return self.header.run

    @property
    def n(self) -> int:
        """Measurements, the start-up left out."""
        return self.figures.n

    @property
    def loops(self) -> int:
        """Measurements asked for, as far as they are known: with the start-up, and those that have no value."""
        return self.n + len(self.header.startup) + self.header.missing + self.header.not_fired + self.header.skipped


NO_DEADLINE = "no deadline was given for it: --deadline"


def digest(series: Series, question: Question | None) -> Digest:
    """Reduce a series; its verdict is prepared for the deadline and the tolerance of the question, if it has one."""
    header = series.header
    tolerance = question.tolerance if question and header.main else NONE_TOLERATED
    trials: Trials | None = None
    tail: Tail | None = None
    blocks: Blocks | None = None
    course: ThinnedSeries | None = None
    undecidable = header.undecidable or (None if question else NO_DEADLINE)
    histogram = from_samples(series.values_ns) if isinstance(series, SampleSeries) else series.histogram
    if header.main or header.series in MAIN_2014:
        if isinstance(series, SampleSeries):
            if question:
                trials = count_misses(series.values_ns, question.deadline_ns, series.absent, tolerance)
            blocks = cut(series.values_ns) if series.values_ns.size else None
        elif question:
            counted = _count_without_order(series, question.deadline_ns, tolerance)
            trials, undecidable = (counted, undecidable) if isinstance(counted, Trials) else (None, counted)
            blocks = split_randomly(histogram) if histogram.values_ns.size else None
    if header.main and isinstance(series, SampleSeries) and series.values_ns.size:
        tail, course = tail_of(series.values_ns), _course(series.values_ns)
    magnitude = np.abs(histogram.values_ns) if header.series.startswith("difference") and histogram.n else None
    return Digest(
        header=header,
        figures=series.figures(),
        mean_abs_ns=None if magnitude is None else float(np.average(magnitude, weights=histogram.counts)),
        max_abs_ns=None if magnitude is None else int(magnitude.max()),
        cluster=_cluster(histogram) if header.series in ("jitter", "grid") else None,
        histogram=histogram,
        trials=trials,
        undecidable=undecidable,
        tail=tail,
        blocks=blocks,
        course=course,
    )


def _count_without_order(series: HistogramSeries, deadline_ns: int, tolerance: Tolerance) -> Trials | str:
    """The misses among counts, or why they do not tell them."""
    if tolerance != NONE_TOLERATED:
        return "counts without order do not tell which misses follow one another"
    try:
        return count_misses_in_histogram(series.histogram, deadline_ns, series.absent_count)
    except ValueError as error:
        return str(error)


def _cluster(histogram: Histogram) -> Cluster:
    inside = histogram.values_ns < CLUSTER_BELOW_NS
    values, counts = histogram.values_ns[inside], histogram.counts[inside]
    n = int(counts.sum())
    fraction = n / histogram.n if histogram.n else 0.0
    if not n:
        return Cluster(n=0, fraction=fraction, median_ns=None, low_ns=None, high_ns=None)
    middle = int(values[np.searchsorted(np.cumsum(counts), (n + 1) // 2)])
    return Cluster(n=n, fraction=fraction, median_ns=middle, low_ns=int(values[0]), high_ns=int(values[-1]))


def _course(values: NDArray[np.int64]) -> ThinnedSeries:
    width = -(-values.size // _COLUMNS)
    starts = np.arange(0, values.size, width)
    return ThinnedSeries(
        low_ns=np.minimum.reduceat(values, starts), high_ns=np.maximum.reduceat(values, starts), width=width
    )


def pool_figures(digests: Sequence[Digest]) -> Figures:
    """The figures of several outputs as if they were one; percentiles are lower edges of the histogram's bins.

    The standard deviation is that of the pooled values: the sums of squares within the outputs and between their means
    are added. The outputs have bins of one width.
    """
    if len(digests) == 1:
        return digests[0].figures
    parts = [one.figures for one in digests if one.n]
    lows = [part.min_ns for part in parts if part.min_ns is not None]
    highs = [part.max_ns for part in parts if part.max_ns is not None]
    mean_ns, std_ns = _pooled_moments(parts)
    merged = merge(one.histogram for one in digests)
    return Figures(
        n=sum(part.n for part in parts),
        min_ns=min(lows, default=None),
        mean_ns=mean_ns,
        max_ns=max(highs) if highs and len(highs) == len(parts) else None,
        std_ns=std_ns,
        percentiles_ns=_percentiles(merged),
        bin_ns=merged.bin_ns,
        overflow=sum(part.overflow for part in parts),
    )


def _pooled_moments(parts: Sequence[Figures]) -> tuple[float | None, float | None]:
    """Mean and standard deviation of all values; None where one of the parts has no mean."""
    known = [(part.n, part.mean_ns, part.std_ns or 0.0) for part in parts if part.mean_ns is not None]
    n = sum(count for count, *_ in known)
    if not n or len(known) < len(parts):
        return None, None
    mean = sum(count * value for count, value, _ in known) / n
    squares = sum((count - 1) * spread**2 + count * (value - mean) ** 2 for count, value, spread in known)
    return mean, math.sqrt(squares / (n - 1)) if n > 1 else 0.0


def _percentiles(histogram: Histogram) -> dict[float, int]:
    """By nearest rank; those beyond the counted values are left out."""
    if not histogram.values_ns.size:
        return {}
    below = np.cumsum(histogram.counts)
    ranks = {p: rank(histogram.n, p) for p in PERCENTILES}
    return {p: int(histogram.values_ns[np.searchsorted(below, r)]) for p, r in ranks.items() if r <= below[-1]}
