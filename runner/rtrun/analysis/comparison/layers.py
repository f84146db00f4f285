"""What a layer adds to the one below it, from runs of both that were measured in turn."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import student_quantile
from rtrun.analysis.dependence.blocks import Blocks
from rtrun.analysis.dependence.interleaving import is_interleaved, seconds

Floats = NDArray[np.float64]

_LEAST_RUNS = 3
QUANTILES = {"median": 0.5, "p99": 0.99, "p99.99": 0.9999}
INFLUENCE_QUANTILES = {"median": 0.5, "p99.9": 0.999}
LATE = "P(late)"
"""The figure that is no time: the share of values above the deadline."""
_BY_NAME = QUANTILES | INFLUENCE_QUANTILES


@dataclass(frozen=True, kw_only=True)
class Added:
    """What the upper layer adds to one figure of the lower, with its interval; ``method`` says how.

    Times are in ns; LATE is a share.
    """

    figure: str
    added: float
    low: float
    high: float
    confidence: float
    method: str


@dataclass(frozen=True, kw_only=True)
class Attribution:
    """What a layer adds to each figure; nothing where ``refused`` says why."""

    added: tuple[Added, ...]
    refused: str | None = None


def attribute(
    lower: Sequence[Blocks],
    upper: Sequence[Blocks],
    *,
    late_above_ns: int | None = None,
    confidence: float = 0.95,
    quantiles: Mapping[str, float] = QUANTILES,
) -> Attribution:
    """What `upper` adds to `lower`, from runs of each layer that were measured in turn.

    A quantile is reported if each run has enough values to reach it, LATE if there is a deadline.

    The start time of a run is a covariate. Both layers are assumed to drift by the same slope. It is fitted and
    removed, so a steady drift (temperature, load) is not attributed to the layer, whatever the order of the runs. Runs
    that were not measured in turn are refused: any other drift would be attributed to the layer. Raises ValueError when
    a run has no measurement.
    """
    if min(len(lower), len(upper)) < _LEAST_RUNS:
        return Attribution(
            added=(), refused=f"{len(lower)} and {len(upper)} runs, at least {_LEAST_RUNS} of each are needed"
        )
    starts = [[run.start_time for run in runs] for runs in (lower, upper)]
    times_s = [seconds(of_layer) for of_layer in starts]
    if times_s[0] is None or times_s[1] is None or not is_interleaved(*starts):
        return Attribution(added=(), refused="the runs were not measured in turn: a drift would be added to the layer")
    least = min(run.n for run in (*lower, *upper))
    figures = ["mean", *(name for name, quantile in quantiles.items() if least * (1 - quantile) >= 1)]
    figures += [] if late_above_ns is None else [LATE]
    added = []
    for figure in figures:
        below, above = (
            np.array([figure_of(run, figure, late_above_ns=late_above_ns or 0) for run in runs])
            for runs in (lower, upper)
        )
        added.append(_added(figure, (below, above), (times_s[0], times_s[1]), confidence))
    return Attribution(added=tuple(added))


def _added(figure: str, values: tuple[Floats, Floats], times_s: tuple[Floats, Floats], confidence: float) -> Added:
    middle, error, degrees = shift_without_drift(values, times_s)
    half = student_quantile((1 + confidence) / 2, degrees) * error
    return Added(
        figure=figure,
        added=middle,
        low=middle - half,
        high=middle + half,
        confidence=confidence,
        method=f"{values[0].size} and {values[1].size} runs measured in turn, a steady drift removed, Welch's t",
    )


def shift_without_drift(values: tuple[Floats, Floats], times_s: tuple[Floats, Floats]) -> tuple[float, float, float]:
    """The shift from the first to the second set of values, shapes (u,) and (v,), its standard error, and degrees of
    freedom. The values have known times and drift by a common slope.

    Analysis of covariance (Cochran 1957) with a variance for each set: the shift is a weighted sum of the values, so
    its variance is the sum of the squared weights times the variances, and the degrees of freedom are those of Welch
    and Satterthwaite. The degree of freedom that the slope takes is divided between the sets in proportion to their
    sums of squares of time.
    """
    from_mean_s = [times - times.mean() for times in times_s]
    squares = [float(times @ times) for times in from_mean_s]
    # Runs that all began at the same time have not drifted.
    whole = sum(squares) or 1.0
    slope = sum(float(times @ own) for times, own in zip(from_mean_s, values, strict=True)) / whole
    between = float(times_s[1].mean() - times_s[0].mean())
    shift = float(values[1].mean() - values[0].mean()) - slope * between
    parts, degrees = [], []
    for sign, own, times, square in zip((-1, 1), values, from_mean_s, squares, strict=True):
        rest = own - own.mean() - slope * times
        free = own.size - 1 - square / whole
        weights = sign / own.size - between / whole * times
        parts.append(float(rest @ rest) / free * float(weights @ weights))
        degrees.append(free)
    error = math.sqrt(sum(parts))
    if not error:
        return shift, 0.0, 1.0
    return shift, error, sum(parts) ** 2 / sum(part**2 / free for part, free in zip(parts, degrees, strict=True))


def figure_of(run: Blocks, figure: str, *, late_above_ns: int = 0) -> float:
    """A figure of a run: the mean or a quantile (by name) in ns, or the share above a limit (LATE).

    Raises ValueError when it has no measurement.
    """
    if not run.n:
        raise ValueError("a run has no measurement")
    if figure == "mean":
        return float(run.sums_ns.sum()) / run.n
    counts = run.counts.sum(axis=0)
    if figure == LATE:
        return float(counts[run.values_ns > late_above_ns].sum()) / run.n
    below = np.cumsum(counts)
    return float(run.values_ns[np.searchsorted(below, math.ceil(_BY_NAME[figure] * below[-1]))])
