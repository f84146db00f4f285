"""Three opinions on the worst case: peaks over threshold, block maxima, and the residual coefficient of variation."""

import math
from collections.abc import Sequence

from rtrun.analysis.chance.distributions import chi_squared_exceeded
from rtrun.analysis.tails.extreme_values import (
    Assumption,
    Bound,
    Tail,
    block_maxima,
    candidate_thresholds,
    decluster,
    high_values,
    refuse,
    stays_the_same,
    too_far,
)
from rtrun.analysis.tails.peaks import peaks_over_threshold

# Fewer excesses would not show that they vary more: a heavy tail would pass for an exponential one.
_LEAST_PEAKS = 500
_NORMAL_95 = 1.645  # normal quantile of a one-sided test at 5 %


def worst_case(
    runs: Sequence[Tail], *, probability: float, confidence: float = 0.95, quantum_ns: int = 1
) -> tuple[Bound, ...]:
    """Bounds from GPD, GEV and the exponential tail of runs of one set of parameters, in order."""
    return (
        peaks_over_threshold(runs, probability, confidence, quantum_ns),
        block_maxima(runs, probability, confidence, quantum_ns),
        exponential_tail(runs, probability, confidence, quantum_ns),
    )


def exponential_tail(runs: Sequence[Tail], probability: float, confidence: float, quantum_ns: int) -> Bound:
    """An exponential tail, if excesses vary no more than exponential ones do: an upper bound for lighter tails.

    The residual coefficient of variation (standard deviation over mean of the excesses) is 1 for an exponential tail
    and smaller for a lighter one (del Castillo & Daoudi 2009; MBPTA-CV, Abella et al. 2017). The lowest threshold is
    taken at which it is not above 1 + 1.64 / sqrt(k) (5 %; its standard error is 1 / sqrt(k)). The interval of the mean
    excess comes from the gamma distribution; the interval of the level follows from it.
    """
    n, values, positions = high_values(runs)
    if values.size < _LEAST_PEAKS:
        return refuse("CV", f"{n} measurements leave {values.size} high values", probability, confidence)
    if (far := too_far(n, probability)) is not None:
        return refuse("CV", far, probability, confidence)
    reason = f"bursts leave fewer than {_LEAST_PEAKS} independent high values"
    for threshold in candidate_thresholds(values):
        peaks, at, _ = decluster(values, positions, threshold)
        if peaks.size < _LEAST_PEAKS:
            break
        if probability >= peaks.size / n:
            reason = "the probability asked for lies within the data: the percentiles answer it"
            break
        changed = next((check for check in stays_the_same(peaks, at, n, quantum_ns) if not check.passed), None)
        if changed is not None:
            return refuse("CV", f"{changed.name}: {changed.seen}", probability, confidence, points=peaks.size)
        base = (threshold // quantum_ns + 1) * quantum_ns
        # A value stands for the middle of its step of the clock.
        excess = peaks - base + quantum_ns / 2
        k, mean = peaks.size, float(excess.mean())
        variation = float(excess.std(ddof=1)) / mean
        limit = 1 + _NORMAL_95 / math.sqrt(k)
        if variation > limit:
            reason = f"the excesses vary more than those of an exponential tail (residual CV {variation:.2f})"
            continue
        factor = math.log(peaks.size / n / probability)
        tail = (1 - confidence) / 2
        low, high = (2 * k * mean / chi_squared_exceeded(p, 2 * k) for p in (tail, 1 - tail))
        seen = f"residual CV {variation:.2f}, limit {limit:.2f}"
        if peaks.max() > base + factor * high:
            return refuse("CV", "a value was seen above the bound", probability, confidence, points=k)
        return Bound(
            method="CV",
            refused=None,
            probability=probability,
            confidence=confidence,
            points=int(k),
            threshold_ns=int(threshold),
            block=None,
            shape=0.0,
            scale_ns=mean,
            location_ns=None,
            rate=k / n,
            level_ns=base + factor * mean,
            low_ns=base + factor * low,
            high_ns=base + factor * high,
            checks=(Assumption(name="variation", passed=True, p_value=None, seen=seen),),
        )
    return refuse("CV", reason, probability, confidence)


def disagreement(bounds: Sequence[Bound]) -> str | None:
    """Say that GPD and GEV disagree: their intervals have no value in common. None where they agree or one is refused.

    The exponential tail is left out: for a lighter tail it lies above the two others, as it should.
    """
    intervals = [(bound.low_ns, bound.high_ns) for bound in bounds if bound.method in ("GPD", "GEV")]
    if len(intervals) < 2:
        return None
    (low, high), (other_low, other_high) = intervals
    if low is None or high is None or other_low is None or other_high is None:
        return None
    if high < other_low or other_high < low:
        return "GPD and GEV disagree: rely on neither, or on the higher one"
    return None
