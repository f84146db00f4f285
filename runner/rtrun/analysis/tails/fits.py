"""The two families of extreme value theory, fitted to counts of quantised values by maximum likelihood.

A value v measured in steps of q says that the true one lies in [v, v + q): the likelihood is that of intervals, so
1 us logs and 1 ns samples are fitted by the same formula and quantisation biases neither.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import chi_squared_above, chi_squared_exceeded
from rtrun.analysis.chance.search import crossing, lowest_point
from rtrun.kinds.values import Int64s

Float64s = NDArray[np.float64]
Parameters = tuple[float, ...]
# Beyond these shapes the likelihood has no proper maximum (below -1) or the mean is infinite (above 1).
_SHAPES = (-1.0, 1.0)
_NEAR_LIMIT = 0.1
_GROUPS = 400
# The cost of impossible parameters. It is finite, because the simplex search subtracts costs.
_EXCLUDED = 1e200


@dataclass(frozen=True, kw_only=True)
class Family:
    """A distribution of excesses or maxima; parameters are (shape, scale) for GPD, (shape, scale, location) for GEV.

    ``log_interval(ends, parameters)`` is log P(ends[0] <= X < ends[1]), both of shape (m,), ``cdf(x, parameters)`` is
    P(X <= x), ``level(chance, parameters)`` is exceeded with `chance`. ``with_level(level, chance, free)`` completes
    the parameters so that this level is exceeded with `chance`: `free` is (shape,) for GPD, (shape, log scale) for GEV.
    ``start(x, counts)`` gives parameters to begin the search with, from moments.
    """

    name: str
    log_interval: Callable[[Float64s, Parameters], Float64s]
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

    @functools.cached_property
    def ends(self) -> Float64s:
        """Lower and upper ends of the intervals, shape (2, m)."""
        return np.stack((self.edges, self.edges + self.step))

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
    shape, scale, *location = family.start(sample.edges + sample.step / 2, sample.counts)

    def parameters(free: Sequence[float]) -> Parameters:
        # The location moves in units of the first scale, so that one tolerance fits all parameters.
        moved = [first + scale * by for first, by in zip(location, free[2:], strict=True)]
        return (free[0], math.exp(min(free[1], 60.0)), *moved)

    def cost(free: Sequence[float]) -> float:
        return negative_log_likelihood(family, sample, parameters(free))

    with np.errstate(all="ignore"):
        begins = [[first, math.log(scale), *(0.0 for _ in location)] for first in (shape, 0.2, -0.2)]
        best, least = begins[0], math.inf
        for begin in sorted(begins, key=cost):
            found, lowest = lowest_point(cost, begin, step=0.1, tolerance=1e-6)
            if lowest < least - 1e-9:
                best, least = found, lowest
            # At the limit of the shapes a search may stop too early. Elsewhere every start leads to the same minimum,
            # as simulations showed.
            if _SHAPES[0] + _NEAR_LIMIT < best[0] < _SHAPES[1] - _NEAR_LIMIT:
                break
    return parameters(best), least


def negative_log_likelihood(family: Family, sample: Sample, parameters: Parameters) -> float:
    """Minus the log likelihood; `_EXCLUDED` where the parameters exclude a measured value.

    The caller makes numpy ignore invalid values: searches call this thousands of times.
    """
    if not _SHAPES[0] <= parameters[0] <= _SHAPES[1] or parameters[1] <= 0:
        return _EXCLUDED
    total = -float(np.dot(sample.counts, family.log_interval(sample.ends, parameters)))
    return total if math.isfinite(total) else _EXCLUDED


def profile_interval(
    family: Family, sample: Sample, best: tuple[Parameters, float], chance: float, confidence: float
) -> tuple[float, float]:
    """Interval for the level exceeded with `chance`, from the profile likelihood (Coles 2001, section 2.6.6).

    Ends are infinite where the likelihood does not bound the level.
    """
    low, high = (profile_end(family, sample, best, chance, confidence, direction=direction) for direction in (-1, 1))
    return low, high


@np.errstate(all="ignore")
def profile_end(
    family: Family,
    sample: Sample,
    best: tuple[Parameters, float],
    chance: float,
    confidence: float,
    *,
    direction: int,
) -> float:
    """One end of that interval: the lower one with `direction` -1, the upper one with 1."""
    parameters, least = best
    limit = math.sqrt(chi_squared_exceeded(1 - confidence, 1) / 2)
    point, base = family.level(chance, parameters), float(sample.edges[0])

    def begins(level: float, near: Parameters) -> Iterator[list[float]]:
        """Where a search may begin: shapes around that of a level nearby, and its location."""
        location = near[2] if len(near) == 3 else 0.0
        for by in (0.0, 0.02, -0.02, 0.05, -0.05, 0.1, -0.1, 0.2, -0.2, 0.4, -0.4):
            shape = near[0] + by
            scale = (level - location) / max(family.level(chance, (shape, 1.0, 0.0)), 1e-300)
            if scale > 0:
                yield [shape, math.log(scale)][: len(near) - 1]

    seen = {point: -limit}
    near = parameters

    def beyond(level: float) -> float:
        """How far a level is beyond the interval: a root of the likelihood's drop, which is nearly straight."""
        nonlocal near
        if level not in seen:

            def cost(free: Sequence[float]) -> float:
                return negative_log_likelihood(family, sample, family.with_level(level, chance, free))

            begin = min(begins(level, near), key=cost)
            found, lowest = lowest_point(cost, begin, step=0.02, tolerance=1e-5)
            drop = lowest - least
            # Far beyond the end only the sign is useful: measured values may be impossible there.
            seen[level] = min(math.sqrt(max(drop, 0.0)), 3 * limit) - limit
            if seen[level] <= 0:
                near = family.with_level(level, chance, found)
        return seen[level]

    inner, width = point, 0.1 * max(point - base, sample.step)
    for _ in range(24):
        outer = inner + direction * width
        if direction < 0:
            if inner - base < 1e-3 * (point - base):
                return base
            outer = max(outer, (inner + base) / 2)
        value = beyond(outer)
        if value > 0:
            return crossing(beyond, inner, outer, tolerance=abs(outer - inner) / 1024)
        # The next step goes a little beyond the end that a straight line predicts.
        distance = abs(outer - point)
        width = distance * min(4.0, max(0.1, 1.1 * limit / max(value + limit, 1e-9) - 1))
        inner = outer
    return math.inf * direction


def goodness(family: Family, sample: Sample, parameters: Parameters) -> float | None:
    """P-value of the chi-squared test of grouped data (classes of about ten values); None when it cannot be made."""
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
    return chi_squared_above(statistic, ends.size - len(parameters)) if math.isfinite(statistic) else 0.0


def _gpd_log_sf(x: Float64s, p: Parameters) -> Float64s:
    shape, scale = p[0], p[1]
    if abs(shape) < 1e-8:
        return -x / scale
    # With a negative shape the distribution has an end, beyond which log 0 over the shape gives minus infinity.
    out: Float64s = np.log(np.maximum(1 + x * (shape / scale), 0.0)) * (-1 / shape)
    return out


def _gpd_interval(ends: Float64s, p: Parameters) -> Float64s:
    above, next_above = _gpd_log_sf(ends, p)
    out: Float64s = above + np.log(-np.expm1(next_above - above))
    return out


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
    # Beyond the end of a distribution log 0 over the shape gives a probability of 1 or 0, as it must be.
    out: Float64s = -np.exp(np.log(np.maximum(1 + shape * z, 0.0)) * (-1 / shape))
    return out


def _gev_interval(ends: Float64s, p: Parameters) -> Float64s:
    left, right = _gev_log_cdf(ends, p)
    out: Float64s = right + np.log(-np.expm1(left - right))
    return out


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
