"""What is kept of one series of one run: small, and enough for every verdict, figure and plot of the report."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.blocks import Blocks, cut, split_randomly
from rtrun.analysis.deadline import Trials, count_misses, count_misses_in_histogram
from rtrun.analysis.describe import Description, describe, describe_histogram
from rtrun.analysis.extreme import Tail, tail_of
from rtrun.analysis.histogram import Histogram, Int64s, from_samples
from rtrun.plan.suites import Value
from rtrun.report.load import Measured

_COLUMNS = 240
# Half of the 1 ms by which the thesis found the negative cluster set off (section 4.2.2).
CLUSTER_BELOW_NS = -500_000


@dataclass(frozen=True, kw_only=True, slots=True)
class Cluster:
    """Values below -500 us of a jitter series: their share of all, and where they lie."""

    n: int
    share: float
    median_ns: int | None
    low_ns: int | None
    high_ns: int | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Course:
    """A series over its loops, thinned: ``low_ns`` and ``high_ns`` (c,) of consecutive columns of ``width`` loops."""

    low_ns: Int64s
    high_ns: Int64s
    width: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Digest:
    """One series of one run. Main series have all fields; the others only figures, cluster and ``mean_abs_ns``."""

    run: str
    target: str
    suite: str
    output: str
    series: str
    parameters: dict[str, Value]
    emulated: bool
    main: bool
    figures: Description
    mean_abs_ns: float | None
    max_abs_ns: int | None
    startup: tuple[tuple[int, int], ...]
    cluster: Cluster | None
    missing: int
    out_of_order: int
    duplicate: int
    not_fired: int
    period_ns: float | None
    clock_step_ns: int | None
    in_effect: dict[str, Any]
    histogram: Histogram
    trials: Trials | None
    undecidable: str | None
    tail: Tail | None
    blocks: Blocks | None
    course: Course | None
    remarks: tuple[str, ...]

    @property
    def n(self) -> int:
        """Measurements, the start-up left out."""
        return self.figures.n


def digest(one: Measured, deadline_ns: int) -> Digest:
    """Reduce a series; its deadline verdict is prepared for `deadline_ns`."""
    trials: Trials | None = None
    tail: Tail | None = None
    blocks: Blocks | None = None
    course: Course | None = None
    undecidable = None
    values = one.values_ns
    if values is not None:
        figures = describe(values, one.index)
        histogram = from_samples(values)
        if one.main:
            trials = count_misses(values, deadline_ns, one.never)
        if one.main and values.size:
            tail, blocks, course = tail_of(values), cut(values), _course(values)
    else:
        assert one.histogram is not None
        histogram = one.histogram
        figures = describe_histogram(histogram)
        if one.main:
            try:
                trials = count_misses_in_histogram(histogram, deadline_ns, one.never_count)
            except ValueError as error:
                undecidable = str(error)
            blocks = split_randomly(histogram) if histogram.values_ns.size else None
    magnitude = np.abs(histogram.values_ns) if one.series == "difference" and histogram.n else None
    return Digest(
        run=one.run,
        target=one.target,
        suite=one.suite,
        output=one.output,
        series=one.series,
        parameters=one.parameters,
        emulated=one.emulated,
        main=one.main,
        figures=figures,
        mean_abs_ns=None if magnitude is None else float(np.average(magnitude, weights=histogram.counts)),
        max_abs_ns=None if magnitude is None else int(magnitude.max()),
        startup=one.startup,
        cluster=_cluster(histogram) if one.series in ("jitter", "grid") else None,
        missing=one.missing,
        out_of_order=one.out_of_order,
        duplicate=one.duplicate,
        not_fired=one.not_fired,
        period_ns=one.period_ns,
        clock_step_ns=one.clock_step_ns,
        in_effect=one.in_effect,
        histogram=histogram,
        trials=trials,
        undecidable=undecidable,
        tail=tail,
        blocks=blocks,
        course=course,
        remarks=one.remarks,
    )


def _cluster(histogram: Histogram) -> Cluster:
    inside = histogram.values_ns < CLUSTER_BELOW_NS
    values, counts = histogram.values_ns[inside], histogram.counts[inside]
    n = int(counts.sum())
    share = n / histogram.n if histogram.n else 0.0
    if not n:
        return Cluster(n=0, share=share, median_ns=None, low_ns=None, high_ns=None)
    middle = int(values[np.searchsorted(np.cumsum(counts), (n + 1) // 2)])
    return Cluster(n=n, share=share, median_ns=middle, low_ns=int(values[0]), high_ns=int(values[-1]))


def _course(values: NDArray[np.int64]) -> Course:
    width = -(-values.size // _COLUMNS)
    starts = np.arange(0, values.size, width)
    return Course(low_ns=np.minimum.reduceat(values, starts), high_ns=np.maximum.reduceat(values, starts), width=width)
