"""Worst case by extreme value theory: block maxima, what every opinion needs, and why an opinion is refused."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtfiles.quantities import time
from rtrun.analysis.chance.distributions import chi_squared_above
from rtrun.analysis.chance.ranks import rank_correlation
from rtrun.analysis.dependence.design_effect import burst_starts, extremal_index
from rtrun.analysis.tails import fits as tails
from rtrun.kinds.values import Int64s

_KEPT = 20_000
_BLOCKS = 1024
LEAST_PEAKS = 50
_MOST_PEAKS = 5_000
_SIGNIFICANT = 0.01
FIT_BELOW = 0.10
_DISTINCT = 10
_EXTRAPOLATION = 100


@dataclass(frozen=True, kw_only=True)
class Tail:
    """What one run shows about its worst case: its highest values with their places, and maxima of equal blocks.

    ``values_ns`` (k,) with ascending ``positions`` (k,) are all values at or above ``floor_ns``, about the highest
    1 % and at most 20 000; ``maxima_ns`` (b,) of consecutive blocks of ``block`` loops.
    """

    n: int
    floor_ns: int
    values_ns: Int64s
    positions: Int64s
    maxima_ns: Int64s
    block: int


@dataclass(frozen=True, kw_only=True)
class Assumption:
    """One tested assumption: its p-value (None if the check is a plain limit) and what was seen."""

    name: str
    passed: bool
    p_value: float | None
    seen: str


@dataclass(frozen=True, kw_only=True)
class Bound:
    """One fit. ``level_ns`` is exceeded on average once in ``1 / probability`` measurements (a burst counts once),
    ``low_ns`` to ``high_ns`` its interval at ``confidence``; all three are None when ``refused`` says why not.
    """

    method: str
    refused: str | None
    probability: float
    confidence: float
    points: int
    threshold_ns: int | None
    block: int | None
    shape: float | None
    scale_ns: float | None
    location_ns: float | None
    rate: float | None
    level_ns: float | None
    low_ns: float | None
    high_ns: float | None
    checks: tuple[Assumption, ...]


def tail_of(values_ns: Int64s) -> Tail:
    """The tail of int64 samples, shape (n,), in loop order."""
    n = values_ns.size
    kept = min(n, _KEPT, max(2000, n // 50))
    floor = int(np.partition(values_ns, n - kept)[n - kept]) if n else 0
    positions = np.flatnonzero(values_ns >= floor)
    if positions.size > 2 * kept:
        # Many equal values at the floor tell nothing: only those above it are kept.
        floor += 1
        positions = np.flatnonzero(values_ns >= floor)
    block = max(1, n // _BLOCKS)
    # The last block also takes the rest: no value is left out.
    maxima = np.maximum.reduceat(values_ns, np.arange(n // block) * block) if n else values_ns
    return Tail(
        n=n,
        floor_ns=floor,
        values_ns=values_ns[positions],
        positions=positions.astype(np.int64),
        maxima_ns=maxima,
        block=block,
    )


def high_values(runs: Sequence[Tail]) -> tuple[int, Int64s, Int64s]:
    """Measurements in all runs, and the values from the highest floor of a run on, with their positions over all
    runs."""
    n = sum(run.n for run in runs)
    floor = max((run.floor_ns for run in runs if run.n), default=0)
    offsets = np.cumsum([0, *(run.n for run in runs)])[:-1]
    values = np.concatenate([run.values_ns for run in runs]) if runs else np.empty(0, np.int64)
    positions = np.concatenate([run.positions + o for run, o in zip(runs, offsets, strict=True)]) if runs else values
    keep = values >= floor
    return n, values[keep], positions[keep]


def decluster(values: Int64s, positions: Int64s, threshold: int) -> tuple[Int64s, Int64s, float]:
    """The highest value of each burst above a threshold, where the burst begins, and the extremal index."""
    above = values > threshold
    high, where = values[above], positions[above]
    theta = extremal_index(where)
    starts = burst_starts(where, theta)
    return np.maximum.reduceat(high, starts), where[starts], theta


def block_maxima(runs: Sequence[Tail], probability: float, confidence: float, quantum_ns: int) -> Bound:
    """Fit a generalised extreme value distribution to maxima of equal blocks (Coles 2001, chapter 3)."""

    def refused(why: str, checks: Sequence[Assumption] = (), points: int = 0, block: int | None = None) -> Bound:
        return refuse("GEV", why, probability, confidence, points, checks, block=block)

    n = sum(run.n for run in runs)
    if (far := too_far(n, probability)) is not None:
        return refused(far)
    fine = max((run.block for run in runs), default=1)
    last = refused(f"{n} measurements are too few for {LEAST_PEAKS} blocks of 20")
    for per_run in (256, 128, 64, 32, 16, 8, 4, 2):
        block = max(fine, max((run.n for run in runs), default=0) // per_run)
        maxima = np.concatenate([_coarser(run, block) for run in runs]) if runs else np.empty(0, np.int64)
        if block < 20:
            continue
        if maxima.size < LEAST_PEAKS:
            break
        if maxima.size > _MOST_PEAKS:
            continue
        chance = -math.expm1(block * math.log1p(-probability))
        if chance >= 0.5:
            return refused("the probability asked for lies within the data: the percentiles answer it")
        at = np.arange(maxima.size, dtype=np.int64)
        checks = list(stays_the_same(maxima, at, maxima.size, quantum_ns))
        sample = tails.sample_of(maxima, quantum_ns)
        best = tails.fit(tails.GEV, sample)
        checks.append(_fit_check(tails.GEV, sample, best[0]))
        failed = next((check for check in checks if not check.passed), None)
        if failed:
            last = refused(f"{failed.name}: {failed.seen}", checks, maxima.size, block)
            if failed.name == "fit":
                continue
            return last
        checks.append(back_test(tails.GEV, maxima, at, maxima.size, quantum_ns))
        if not checks[-1].passed:
            return refused(f"back-test: {checks[-1].seen}", checks, maxima.size, block)
        low, high = tails.profile_interval(tails.GEV, sample, best, chance, confidence)
        if not math.isfinite(high):
            return refused("the data do not bound the tail from above", checks, maxima.size, block)
        if maxima.max() > high:
            return refused(above_bound(int(maxima.max()), high), checks, maxima.size, block)
        return Bound(
            method="GEV",
            refused=None,
            probability=probability,
            confidence=confidence,
            points=int(maxima.size),
            threshold_ns=None,
            block=block,
            shape=best[0][0],
            scale_ns=best[0][1],
            location_ns=best[0][2],
            rate=None,
            level_ns=tails.GEV.level(chance, best[0]),
            low_ns=low,
            high_ns=high,
            checks=tuple(checks),
        )
    return last


def refuse(
    method: str,
    why: str,
    probability: float,
    confidence: float,
    points: int = 0,
    checks: Sequence[Assumption] = (),
    threshold_ns: int | None = None,
    block: int | None = None,
) -> Bound:
    """A refused bound, and why."""
    return Bound(
        method=method,
        refused=why,
        probability=probability,
        confidence=confidence,
        points=points,
        threshold_ns=threshold_ns,
        block=block,
        shape=None,
        scale_ns=None,
        location_ns=None,
        rate=None,
        level_ns=None,
        low_ns=None,
        high_ns=None,
        checks=tuple(checks),
    )


def too_far(n: int, probability: float) -> str | None:
    """Why a probability lies too far beyond `n` measurements; None if it does not."""
    if n * probability * _EXTRAPOLATION >= 1:
        return None
    return (
        f"a probability of {probability:g} is more than {_EXTRAPOLATION} times beyond {n} measurements, "
        f"at least {math.ceil(1 / (probability * _EXTRAPOLATION))} are needed"
    )


def above_bound(seen_ns: int, bound_ns: float) -> str:
    """Why a bound does not hold: a higher value was measured; None if none was."""
    return f"a value of {time(seen_ns)} was seen above the fitted bound of {time(bound_ns)}"


def candidate_thresholds(values: Int64s) -> list[int]:
    """Candidates from many exceedances to few."""
    ordered = np.sort(values)
    chosen = []
    count = min(values.size - 1, _MOST_PEAKS)
    while count >= LEAST_PEAKS:
        chosen.append(int(ordered[-count - 1]))
        count = int(count * 0.6)
    return list(dict.fromkeys(chosen))


def _coarser(run: Tail, block: int) -> Int64s:
    factor = max(1, block // run.block)
    whole = run.maxima_ns.size // factor
    return np.maximum.reduceat(run.maxima_ns, np.arange(whole) * factor) if whole else run.maxima_ns[:0]


def resolution(peaks: Int64s, quantum_ns: int) -> Assumption:
    """The check that there are enough different values for a fit."""
    distinct = int(np.unique(peaks // quantum_ns).size)
    return Assumption(
        name="quantisation",
        passed=distinct >= _DISTINCT,
        p_value=None,
        seen=f"{distinct} different values in steps of {time(quantum_ns)}, at least {_DISTINCT} are needed",
    )


def stays_the_same(peaks: Int64s, at: Int64s, n: int, quantum_ns: int) -> list[Assumption]:
    """The checks of resolution, stationarity and dependence that every opinion needs."""
    checks = [resolution(peaks, quantum_ns)]
    if np.unique(peaks).size < 3:
        return checks
    trend, trend_p = rank_correlation(np.arange(peaks.size), peaks)
    checks.append(
        Assumption(
            name="stationarity",
            passed=trend_p >= _SIGNIFICANT,
            p_value=trend_p,
            seen=f"rank correlation of height and time {trend:+.2f} (p = {trend_p:.2g})",
        )
    )
    if n > peaks.size:
        parts = np.bincount(at * 8 // n, minlength=8)
        statistic = float(((parts - peaks.size / 8) ** 2).sum() / (peaks.size / 8))
        p = chi_squared_above(statistic, 7)
        checks.append(
            Assumption(
                name="stationarity",
                passed=p >= _SIGNIFICANT,
                p_value=p,
                seen=f"high values in eighths of the time: {', '.join(map(str, parts))} (p = {p:.2g})",
            )
        )
    follow, follow_p = rank_correlation(peaks[:-1], peaks[1:])
    # Peaks that are all alike have no rank correlation (NaN), and do not depend on one another.
    p = follow_p if math.isfinite(follow_p) else 1.0
    checks.append(
        Assumption(
            name="dependence",
            passed=p >= _SIGNIFICANT,
            p_value=p,
            seen=f"rank correlation of one peak and the next {follow:+.2f} (p = {p:.2g})",
        )
    )
    return checks


def _fit_check(family: tails.Family, sample: tails.Sample, parameters: tails.Parameters) -> Assumption:
    p = tails.goodness(family, sample, parameters)
    if p is None:
        return Assumption(name="fit", passed=False, p_value=None, seen="too few different values to test the fit")
    return Assumption(
        name="fit", passed=p >= FIT_BELOW, p_value=p, seen=f"chi-squared test of the {family.name} fit: p = {p:.2g}"
    )


def back_test(family: tails.Family, values: Int64s, at: Int64s, n: int, quantum_ns: int) -> Assumption:
    """Fit the first half in time; its 99 % bound for the maximum of the second half must hold there."""
    early = at < n // 2
    first, rest = values[early], values[~early]
    if first.size < LEAST_PEAKS // 2 or rest.size == 0:
        return Assumption(
            name="back-test", passed=False, p_value=None, seen="too few high values in one half of the time"
        )
    sample = tails.sample_of(first, quantum_ns)
    best = tails.fit(family, sample)
    chance = 0.01 / rest.size
    bound = tails.profile_end(family, sample, best, chance, 0.95, direction=1)
    worst = int(rest.max())
    broken = int((rest > bound).sum())
    unit = "above the threshold " if family.name == "GPD" else ""
    return Assumption(
        name="back-test",
        passed=broken == 0,
        p_value=None,
        seen=f"the first half's bound for the second is {time(bound)} {unit}and was exceeded {broken} times "
        f"(worst {time(worst)})",
    )
