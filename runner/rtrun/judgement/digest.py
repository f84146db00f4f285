"""The digest of one series of one run: small, and enough for every verdict, figure and plot of the report."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.dependence.blocks import Blocks, cut, split_randomly
from rtrun.analysis.figures import PERCENTILES, Figures, rank
from rtrun.analysis.histogram import Histogram, from_samples, merge
from rtrun.analysis.order.startup import Head, head_of, split
from rtrun.analysis.scale import Floats, Scale, scale_of
from rtrun.analysis.tails.extreme_values import Tail, tail_of
from rtrun.analysis.trials import Trials, count_misses, count_misses_in_histogram
from rtrun.kinds.known import CLUSTERED, MAIN_2014
from rtrun.kinds.values import Int64s
from rtrun.plan.question import NONE_TOLERATED, Question, Tolerance
from rtrun.results.series import Header, HistogramSeries, SampleSeries, Series

_COLUMNS = 240
_WIDE_COLUMNS, _ROWS = 60, 40  # of counts over time
# Half of the 1 ms that separates the negative cluster in the thesis (section 4.2.2).
CLUSTER_BELOW_NS = -500_000


NO_DEADLINE = "no deadline was given for it: --deadline"


@dataclass(frozen=True, kw_only=True, slots=True)
class Cluster:
    """Values below -500 us of a jitter series: their fraction of all values, and where they lie."""

    n: int
    fraction: float
    median_ns: int | None
    low_ns: int | None
    high_ns: int | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThinnedSeries:
    """A series over its loops, thinned: ``low_ns`` and ``high_ns`` (c,) of each column of ``width`` loops that has
    values.

    ``loops`` (c,) are the first loops of these columns; a column without any value is left out. `end` follows the last
    loop. ``counts`` (r, w) are the numbers of values in wider columns of ``columns_of`` loops, between ``edges_ns`` (r
    + 1,) at equal distances on ``scale``.
    """

    loops: Int64s
    end: int
    low_ns: Int64s
    high_ns: Int64s
    width: int
    scale: Scale
    edges_ns: Floats
    counts: NDArray[np.uint32]
    columns_of: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Digest:
    """One series of one run."""

    header: Header
    figures: Figures
    histogram: Histogram

    @property
    def run(self) -> str:
        """Name of its run."""
        return self.header.run

    @property
    def n(self) -> int:
        """Measurements, without the start-up."""
        return self.figures.n

    @property
    def loops(self) -> int:
        """Requested measurements, as far as known, including the start-up and those without a value."""
        return self.n + len(self.header.startup) + self.header.missing + self.header.not_fired + self.header.skipped

    @property
    def cluster(self) -> Cluster | None:
        """Its negative cluster; None for a series that can have none."""
        return _cluster(self.histogram) if self.header.series in CLUSTERED else None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class JudgedDigest(Digest):
    """A series that gets a verdict: the main one, or that of 2014 beside it, which tolerates no miss.

    `question` is the question that it has to answer; None: it has no deadline. `undecidable` says why there are no
    `trials`. Only a main series whose values have an order has `tail` and `course`. `head` shows whether there is a
    start-up; `startup` are its trials, which are left out of `trials` but not of the figures. Both are None where no
    order was kept.
    """

    question: Question | None
    trials: Trials | None
    undecidable: str | None
    blocks: Blocks | None
    tail: Tail | None = None
    course: ThinnedSeries | None = None
    head: Head | None = None
    startup: Trials | None = None


def digest(series: Series, question: Question | None, startup_loops: int = 0) -> Digest:
    """Reduce a series, with what a verdict needs for the deadline and the tolerance of the question, if there is one.

    The first `startup_loops` are left out of its trials.
    """
    header, figures = series.header, series.figures()
    histogram = series.histogram if isinstance(series, HistogramSeries) else from_samples(series.values_ns)
    if not header.main and header.series not in MAIN_2014:
        return Digest(header=header, figures=figures, histogram=histogram)
    tolerance = question.tolerance if question and header.main else NONE_TOLERATED
    undecidable = header.undecidable or (None if question else NO_DEADLINE)
    if isinstance(series, HistogramSeries):
        counted = _count_without_order(series, question.limit_ns, tolerance) if question else NO_DEADLINE
        return JudgedDigest(
            header=header,
            figures=figures,
            histogram=histogram,
            question=question,
            trials=counted if isinstance(counted, Trials) else None,
            undecidable=undecidable if isinstance(counted, Trials) else counted,
            blocks=split_randomly(histogram) if histogram.values_ns.size else None,
        )
    values_ns = series.values_ns
    has_order = header.main and values_ns.size > 0
    head, startup, trials = None, None, None
    if question:
        head = head_of(values_ns, series.absent, question.limit_ns)
        steady_ns, absent = values_ns, series.absent
        if startup_loops:
            startup, steady_ns, absent = split(values_ns, absent, question.limit_ns, startup_loops)
        step_ns = header.clock_step_ns or 1
        trials = count_misses(steady_ns, question.limit_ns, absent, tolerance, header.period_ns, step_ns)
    return JudgedDigest(
        header=header,
        figures=figures,
        histogram=histogram,
        question=question,
        trials=trials,
        undecidable=undecidable,
        blocks=cut(values_ns) if values_ns.size else None,
        tail=tail_of(values_ns) if has_order else None,
        course=_course(series, histogram) if has_order else None,
        head=head,
        startup=startup,
    )


def _count_without_order(series: HistogramSeries, deadline_ns: int, tolerance: Tolerance) -> Trials | str:
    """The misses among counts, or why the counts cannot show them."""
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


def _course(series: SampleSeries, histogram: Histogram) -> ThinnedSeries:
    values, first = series.values_ns, len(series.header.startup)
    loop = series.index - first
    # Skipped periods have no loops of their own.
    last = [loop[-1], *(series.absent[-1:] if not series.header.skipped else ())]
    size = int(max(last)) + 1
    width = -(-size // _COLUMNS)
    starts = np.flatnonzero(np.diff(loop // width, prepend=-1))
    scale = scale_of(histogram)
    edges = scale.edges(_ROWS, max(histogram.bin_ns, 1000))
    columns_of = -(-size // _WIDE_COLUMNS)
    columns = -(-size // columns_of)
    row = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
    at = row * columns + loop // columns_of
    counts = np.bincount(at, minlength=(edges.size - 1) * columns).reshape(-1, columns)
    return ThinnedSeries(
        loops=first + loop[starts] // width * width,
        end=first + size,
        low_ns=np.minimum.reduceat(values, starts),
        high_ns=np.maximum.reduceat(values, starts),
        width=width,
        scale=scale,
        edges_ns=edges,
        counts=counts.astype(np.uint32),
        columns_of=columns_of,
    )


def pool_figures(digests: Sequence[Digest]) -> Figures:
    """The figures of several outputs as if they were one; percentiles are lower edges of the histogram's bins.

    The standard deviation is that of the pooled values: the sums of squares within the outputs and between their means
    are added. The outputs have bins of one width.
    """
    if len(digests) == 1:
        return digests[0].figures
    parts = [output.figures for output in digests if output.n]
    lows = [part.min_ns for part in parts if part.min_ns is not None]
    highs = [part.max_ns for part in parts if part.max_ns is not None]
    mean_ns, std_ns = _pooled_moments(parts)
    merged = merge(output.histogram for output in digests)
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
