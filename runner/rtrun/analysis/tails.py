"""The two families of extreme value theory, fitted to counts of quantised values by maximum likelihood.

A value v measured in steps of q says that the true one lies in [v, v + q): the likelihood is that of intervals, so
1 us logs and 1 ns samples are fitted by the same formula and quantisation biases neither.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.histogram import Int64s

Float64s = NDArray[np.float64]
Parameters = tuple[float, ...]
# Beyond these shapes the likelihood has no proper maximum (below -1) or the mean is infinite (above 1).
_SHAPES = (-1.0, 1.0)
_GROUPS = 400
# Finite, so that a simplex search can still subtract.
_EXCLUDED = 1e200


@dataclass(frozen=True, kw_only=True)
class Family:
    """A distribution of excesses or maxima; parameters are (shape, scale) for GPD, (shape, scale, location) for GEV.

    ``log_interval(x, step, parameters)`` is log P(x <= X < x + step), ``cdf(x, parameters)`` is P(X <= x),
    ``level(chance, parameters)`` is exceeded with `chance`. ``with_level(level, chance, free)`` completes the
    parameters so that this level is exceeded with `chance`: `free` is (shape,) for GPD, (shape, log scale) for GEV.
    ``start(x, counts)`` gives parameters to begin the search with, from moments.
    """

    name: str
    log_interval: Callable[[Float64s, float, Parameters], Float64s]
    cdf: Callable[[Float64s, Parameters], Float64s]
    level: Callable[[float, Parameters], float]
    with_level: Callable[[float, float, Sequence[float]], Parameters]
    start: Callable[[Float64s, Float64s], Parameters]


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Quantised values: ``edges`` (m,) are lower ends of intervals of width ``step``, with ``counts`` (m,)."""

    edges: Float64s
    counts: Float64s
    step: float

    @property
    def n(self) -> int:
        """Values in all intervals."""
        return int(self.counts.sum())


def sample_of(values_ns: Int64s, quantum_ns: int) -> Sample:
    """Group values into at most a few hundred intervals that are whole multiples of the quantum."""
    low = int(values_ns.min())
    spread = int(np.percentile(values_ns, 90)) - low
    step = quantum_ns * max(1, spread // (_GROUPS * quantum_ns // 2))
    groups, counts = np.unique((values_ns - low) // step, return_counts=True)
    return Sample(edges=(low + groups * step).astype(np.float64), counts=counts.astype(np.float64), step=float(step))


def fit(family: Family, sample: Sample) -> tuple[Parameters, float]:
    """Maximum likelihood (shape, scale[, location]) and its negative log likelihood."""
    from scipy.optimize import minimize

    first = family.start(sample.edges + sample.step / 2, sample.counts)

    def cost(free: Float64s) -> float:
        return negative_log_likelihood(family, sample, (free[0], math.exp(min(free[1], 60.0)), *free[2:]))

    best = None
    for shape in (first[0], 0.2, -0.2):
        begin = np.array([shape, math.log(first[1]), *first[2:]])
        optimum = minimize(cost, begin, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-6, "maxiter": 1500})
        if best is None or optimum.fun < best.fun - 1e-9:
            best = optimum
    assert best is not None
    return (float(best.x[0]), math.exp(best.x[1]), *map(float, best.x[2:])), float(best.fun)


def negative_log_likelihood(family: Family, sample: Sample, parameters: Parameters) -> float:
    """Minus the log likelihood; `_EXCLUDED` where the parameters exclude a measured value."""
    if not _SHAPES[0] <= parameters[0] <= _SHAPES[1] or parameters[1] <= 0:
        return _EXCLUDED
    with np.errstate(all="ignore"):
        logs = family.log_interval(sample.edges, sample.step, parameters)
        total = -float(np.dot(sample.counts, logs))
    return total if math.isfinite(total) else _EXCLUDED


def profile_interval(
    family: Family, sample: Sample, best: tuple[Parameters, float], chance: float, confidence: float
) -> tuple[float, float]:
    """Interval for the level exceeded with `chance`, from the profile likelihood (Coles 2001, section 2.6.6).

    Ends are infinite where the likelihood does not bound the level.
    """
    from scipy.optimize import minimize
    from scipy.special import chdtri

    parameters, least = best
    drop = float(chdtri(1, 1 - confidence)) / 2
    point = family.level(chance, parameters)
    nuisance = [parameters[0]] if len(parameters) == 2 else [parameters[0], math.log(parameters[1])]

    def excess(level: float, guess: list[float]) -> tuple[float, list[float]]:
        def cost(free: Float64s) -> float:
            return negative_log_likelihood(family, sample, family.with_level(level, chance, free.tolist()))

        spread = np.vstack([guess, *(np.array(guess) + step for step in np.eye(len(guess)) * 0.05)])
        optimum = minimize(
            cost, guess, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-4, "initial_simplex": spread}
        )
        return float(optimum.fun) - least - drop, optimum.x.tolist()

    base = float(sample.edges[0])

    def end(direction: int) -> float:
        inner, width, guess = point, 0.02 * max(point - base, sample.step), nuisance
        for _ in range(60):
            outer = inner + direction * width
            if outer <= base:
                return base
            value, after = excess(outer, guess)
            if value > 0:
                break
            inner, width, guess = outer, width * 1.5, after
        else:
            return math.inf * direction
        for _ in range(12):
            middle = (inner + outer) / 2
            value, after = excess(middle, guess)
            if value > 0:
                outer = middle
            else:
                inner, guess = middle, after
        return outer

    return end(-1), end(+1)


def goodness(family: Family, sample: Sample, parameters: Parameters) -> float | None:
    """P-value of the chi-squared test of grouped data (classes of about ten values); None when it cannot be made."""
    from scipy.special import chdtrc

    n = sample.n
    classes = min(20, n // 10)
    if classes < len(parameters) + 2:
        return None
    upper = np.cumsum(sample.counts)
    ends = np.unique(np.searchsorted(upper, n * np.arange(1, classes) / classes))
    ends = ends[ends < sample.edges.size - 1]
    if ends.size + 1 < len(parameters) + 2:
        return None
    observed = np.diff(np.concatenate(([0.0], upper[ends], [n])))
    with np.errstate(all="ignore"):
        below = family.cdf(sample.edges[ends] + sample.step, parameters)
        expected = n * np.diff(np.concatenate(([0.0], below, [1.0])))
        statistic = float(np.sum((observed - expected) ** 2 / expected))
    return float(chdtrc(ends.size - len(parameters), statistic)) if math.isfinite(statistic) else 0.0


def _gpd_log_sf(x: Float64s, p: Parameters) -> Float64s:
    shape, scale = p[0], p[1]
    if abs(shape) < 1e-8:
        return -x / scale
    inside = 1 + shape * x / scale
    return np.where(inside > 0, -np.log(np.maximum(inside, 1e-300)) / shape, -np.inf)


def _gpd_interval(x: Float64s, step: float, p: Parameters) -> Float64s:
    log_above = _gpd_log_sf(x, p)
    return log_above + np.log(-np.expm1(_gpd_log_sf(x + step, p) - log_above))


def _power(log_x: float, shape: float) -> float:
    """(x ** shape - 1) / shape, its limit log x at shape 0."""
    return log_x if abs(shape) < 1e-8 else math.expm1(min(shape * log_x, 600.0)) / shape


def _moments(x: Float64s, counts: Float64s) -> tuple[float, float]:
    mean = float(np.average(x, weights=counts))
    return mean, max(float(np.average((x - mean) ** 2, weights=counts)), 1e-12)


def _gpd_start(x: Float64s, counts: Float64s) -> Parameters:
    mean, variance = _moments(x, counts)
    ratio = mean * mean / variance
    return min(0.5, max(-0.5, (1 - ratio) / 2)), max(mean * (ratio + 1) / 2, 1e-9)


def _gev_log_cdf(x: Float64s, p: Parameters) -> Float64s:
    shape, scale, location = p
    z = (x - location) / scale
    if abs(shape) < 1e-8:
        return -np.exp(-z)
    inside = 1 + shape * z
    out = np.where(inside > 0, -np.exp(-np.log(np.maximum(inside, 1e-300)) / shape), 0.0 if shape < 0 else -np.inf)
    return np.asarray(out, dtype=np.float64)


def _gev_interval(x: Float64s, step: float, p: Parameters) -> Float64s:
    right = _gev_log_cdf(x + step, p)
    return right + np.log(-np.expm1(_gev_log_cdf(x, p) - right))


def _gev_start(x: Float64s, counts: Float64s) -> Parameters:
    mean, variance = _moments(x, counts)
    scale = math.sqrt(6 * variance) / math.pi
    return 0.05, scale, mean - 0.5772 * scale


def _log_return(chance: float) -> float:
    """Minus log of minus log(1 - chance): the reduced variate of a maximum exceeded with `chance`."""
    return -math.log(-math.log1p(-chance))


GPD = Family(
    name="GPD",
    log_interval=_gpd_interval,
    cdf=lambda x, p: np.asarray(-np.expm1(_gpd_log_sf(x, p))),
    level=lambda chance, p: p[1] * _power(-math.log(chance), p[0]),
    with_level=lambda level, chance, free: (free[0], level / max(_power(-math.log(chance), free[0]), 1e-300)),
    start=_gpd_start,
)
GEV = Family(
    name="GEV",
    log_interval=_gev_interval,
    cdf=lambda x, p: np.asarray(np.exp(_gev_log_cdf(x, p))),
    level=lambda chance, p: p[2] + p[1] * _power(_log_return(chance), p[0]),
    with_level=lambda level, chance, free: (
        free[0],
        math.exp(min(free[1], 60.0)),
        level - math.exp(min(free[1], 60.0)) * _power(_log_return(chance), free[0]),
    ),
    start=_gev_start,
)
