"""What each layer adds: cyclictest below, the ROS timer above it, publish-subscribe on top."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtrun.analysis.blocks import Blocks
from rtrun.analysis.interleaving import is_interleaved
from rtrun.analysis.welch import standard_error

_LEAST_RUNS = 3


@dataclass(frozen=True, kw_only=True)
class Added:
    """What the upper layer adds to one figure of the lower, in ns, with its interval; ``method`` says how."""

    figure: str
    added_ns: float
    low_ns: float
    high_ns: float
    confidence: float
    method: str


@dataclass(frozen=True, kw_only=True)
class Attribution:
    """What a layer adds, a figure each; none where ``refused`` says why."""

    added: tuple[Added, ...]
    refused: str | None = None


def attribute(lower: Sequence[Blocks], upper: Sequence[Blocks], *, confidence: float = 0.95) -> Attribution:
    """What `upper` adds to `lower`, from runs of each layer that were measured in turn.

    As many of each are paired in the order they began, and the interval is Student's over the pairs, so that what
    drifts over a campaign (temperature, load) cancels. Else runs are the units of Welch's interval (Welch 1947). Runs
    that were not measured in turn are refused: what drifted meanwhile would be added to the layer. Raises ValueError
    when a run has no measurement.
    """
    if min(len(lower), len(upper)) < _LEAST_RUNS:
        return Attribution(
            added=(), refused=f"{len(lower)} and {len(upper)} runs, at least {_LEAST_RUNS} of each are needed"
        )
    if not is_interleaved([run.start_time for run in lower], [run.start_time for run in upper]):
        return Attribution(added=(), refused="the runs were not measured in turn: a drift would be added to the layer")
    lower, upper = (sorted(runs, key=lambda run: run.start_time) for runs in (lower, upper))
    added = []
    for figure in ("mean", "p99"):
        below, above = (np.array([figure_of(run, figure) for run in runs]) for runs in (lower, upper))
        added.append(_added(figure, below, above, confidence))
    return Attribution(added=tuple(added))


def _added(figure: str, lower: np.ndarray, upper: np.ndarray, confidence: float) -> Added:
    from scipy.special import stdtrit

    if lower.size == upper.size:
        gaps = upper - lower
        error, degrees = float(gaps.std(ddof=1)) / math.sqrt(gaps.size), gaps.size - 1.0
        method = f"{gaps.size} pairs of runs measured in turn, Student's t"
    else:
        error, degrees = standard_error(lower, upper)
        method = f"{lower.size} and {upper.size} runs measured in turn, Welch's t"
    half = float(stdtrit(degrees, (1 + confidence) / 2)) * error
    middle = float(upper.mean() - lower.mean())
    return Added(
        figure=figure,
        added_ns=middle,
        low_ns=middle - half,
        high_ns=middle + half,
        confidence=confidence,
        method=method,
    )


def figure_of(run: Blocks, figure: str) -> float:
    """The mean or the 99th percentile ("mean", "p99") of a run, ns. Raises ValueError when it has no measurement."""
    if not run.n:
        raise ValueError("a run has no measurement")
    if figure == "mean":
        return float(run.sums_ns.sum()) / run.n
    below = np.cumsum(run.counts.sum(axis=0))
    return float(run.values_ns[np.searchsorted(below, math.ceil(0.99 * below[-1]))])
