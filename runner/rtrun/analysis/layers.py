"""What each layer adds: cyclictest below, the ROS timer above it, publish-subscribe on top."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtrun.analysis.blocks import Blocks
from rtrun.analysis.comparison import compare

_LEAST_PAIRS = 3


@dataclass(frozen=True, kw_only=True)
class Added:
    """What the upper layer adds to one figure of the lower, in ns, with its interval; ``method`` says how."""

    figure: str
    added_ns: float
    low_ns: float
    high_ns: float
    confidence: float
    method: str


def attribute(lower: Sequence[Blocks], upper: Sequence[Blocks], *, confidence: float = 0.95) -> tuple[Added, ...]:
    """What `upper` adds to `lower`, each a layer's runs in the order they were made.

    Interleaved runs (as many of each, three or more) are paired in order, and the interval is Student's over the
    pairs, so that what drifts over a campaign (temperature, load) cancels. Otherwise the block bootstrap of
    `compare`. Raises ValueError when a layer has no measurement.
    """
    pairs = min(len(lower), len(upper))
    if len(lower) == len(upper) and pairs >= _LEAST_PAIRS:
        from scipy.special import stdtrit

        added = []
        for figure, of in (("mean", _mean), ("p99", _p99)):
            gaps = np.array([of(up) - of(low) for low, up in zip(lower, upper, strict=True)])
            half = float(stdtrit(pairs - 1, (1 + confidence) / 2)) * float(gaps.std(ddof=1)) / math.sqrt(pairs)
            middle = float(gaps.mean())
            added.append(
                Added(
                    figure=figure,
                    added_ns=middle,
                    low_ns=middle - half,
                    high_ns=middle + half,
                    confidence=confidence,
                    method=f"{pairs} interleaved pairs of runs, Student's t",
                )
            )
        return tuple(added)
    found = compare(lower, upper, confidence=confidence)
    return tuple(
        Added(
            figure=shift.figure,
            added_ns=shift.shift_ns,
            low_ns=shift.low_ns,
            high_ns=shift.high_ns,
            confidence=confidence,
            method=f"runs not interleaved, bootstrap of {found.units}",
        )
        for shift in found.shifts
        if shift.figure in ("mean", "p99")
    )


def _mean(run: Blocks) -> float:
    if not run.n:
        raise ValueError("a run has no measurement")
    return float(run.sums_ns.sum()) / run.n


def _p99(run: Blocks) -> float:
    below = np.cumsum(run.counts.sum(axis=0))
    return float(run.values_ns[np.searchsorted(below, math.ceil(0.99 * below[-1]))])
