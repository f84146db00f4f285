"""Does a generalised Pareto distribution fit, and from which of several thresholds on?

Both after Bader, Yan & Zhang, "Automated threshold selection for extreme value analysis via ordered goodness-of-fit
tests with adjustment for false discovery rate", Annals of Applied Statistics 12 (2018) 310-329.
"""

import functools
import math
from collections.abc import Sequence

import numpy as np

from rtrun.analysis.chance.distributions import chi_squared_above
from rtrun.analysis.tails.fits import GPD, Float64s, Parameters
from rtrun.kinds.values import Int64s

_SEED = 20140715
_POINTS = 128
# Below the first shape the information of the scale is infinite; above the second, the mean of the excesses is.
_SHAPES = (-0.45, 1.0)


def p_value(excesses_ns: Int64s, quantum_ns: int, parameters: Parameters) -> float:
    """P-value of the Anderson-Darling test of a GPD whose (shape, scale) were fitted to these excesses, shape (k,).

    A value measured in steps tells only its step. It is put at random between the values of the distribution function
    at both ends of the step (fixed seed), so that the statistic has the distribution of continuous values.
    """
    ends = excesses_ns.astype(np.float64) + np.array([[0], [quantum_ns]])
    with np.errstate(divide="ignore"):  # beyond the end of the distribution
        lower, upper = GPD.cdf(ends, parameters)
    places = np.random.default_rng(_SEED).random(excesses_ns.size)
    return _exceeding(_statistic(lower + places * (upper - lower)), round(parameters[0], 2))


def forward_stop(p_values: Sequence[float], level: float) -> int:
    """How many hypotheses, in their order, are rejected so that the false discovery rate is at most `level`.

    ForwardStop: the largest k at which the mean of -log(1 - p) of the first k is at most the level (G'Sell, Wager,
    Chouldechova & Tibshirani 2016).
    """
    surprises = -np.log1p(-np.minimum(p_values, 1 - 1e-12))
    within = np.flatnonzero(np.cumsum(surprises) <= level * np.arange(1, surprises.size + 1))
    return int(within[-1]) + 1 if within.size else 0


def _statistic(uniform: Float64s) -> float:
    """Anderson & Darling (1954) for values that are uniform on (0, 1) where the distribution holds."""
    ordered = np.clip(np.sort(uniform), 1e-15, 1 - 1e-15)
    k = ordered.size
    weights = 2 * np.arange(1, k + 1) - 1
    return float(-k - np.dot(weights, np.log(ordered) + np.log1p(-ordered[::-1])) / k)


def _exceeding(statistic: float, shape: float) -> float:
    """P(the statistic or more) after both parameters were fitted by maximum likelihood.

    The limit is a sum of squared normal variates (Choulakian & Stephens 2001). Its upper tail is
    that of the chi-squared distribution with the same first three moments (Buckley & Eagleson 1988).
    """
    mean, variance, third = _moments(min(max(shape, _SHAPES[0]), _SHAPES[1]))
    degrees = 8 * variance**3 / third**2
    standardised = (statistic - mean) / math.sqrt(variance)
    return chi_squared_above(max(0.0, degrees + standardised * math.sqrt(2 * degrees)), degrees)


@functools.lru_cache(maxsize=256)
def _moments(shape: float) -> tuple[float, float, float]:
    """Mean, variance and third central moment of that limit.

    The weights are the eigenvalues of the covariance of the weighted empirical process, which fitted parameters make
    smaller; their sums of powers are traces of its powers.
    With S the chance of a larger value and scale 1, log S = -log(1 + shape x) / shape; the covariance of the estimates
    is that of Smith (1987).
    """
    places, lengths = np.polynomial.legendre.leggauss(_POINTS)
    below = (places + 1) / 2
    above = 1 - below
    if abs(shape) < 1e-6:
        by_scale = -np.log(above)
        by_shape = by_scale**2 / 2
    else:
        by_scale = -np.expm1(shape * np.log(above)) / shape
        by_shape = -(np.log(above) + by_scale) / shape
    gradient = above * np.array([by_shape, by_scale])
    estimates = (1 + shape) * np.array([[1 + shape, -1], [-1, 2]])
    covariance = np.minimum.outer(below, below) - np.outer(below, below) - gradient.T @ estimates @ gradient
    spread = np.sqrt(lengths / 2 / (below * above))
    weighted = covariance * np.outer(spread, spread)
    squared = weighted @ weighted
    return float(np.trace(weighted)), 2 * float(np.trace(squared)), 8 * float(np.sum(weighted * squared))
