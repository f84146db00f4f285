"""Chances and quantiles of the distributions that the analysis rests on.

scipy.special has all of these, but is as large as everything else needed to measure and judge, and takes longer to load
than a small report. Here each chance is one integral, and all are computed in the same way to at least eleven digits.
`tests/rtrun/analysis/test_distributions.py` compares them with scipy.
"""

import functools
import math
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.search import where_one

Floats = NDArray[np.float64]

_NORMAL = NormalDist()
# Quadrature of functions that fall off as exp(-s): the trapezoidal rule in u, where s = exp(u - exp(-u)) (Takahasi &
# Mori 1974).
_STEP = 0.15
_AT = np.arange(-4.2, 8.4, _STEP)
_PLACES = np.exp(_AT - np.exp(-_AT))
_WEIGHTS = _STEP * _PLACES * (1 + np.exp(-_AT))
# From here on Stirling's series has all digits.
_LARGE = 16
_TINY = 1e-300


def normal_quantile(chance: float) -> float:
    """The value below which a standard normal variate lies with this chance, in (0, 1)."""
    return _NORMAL.inv_cdf(chance)


def normal_quantiles(chances: Floats) -> Floats:
    """`normal_quantile` of each."""
    return np.array([_NORMAL.inv_cdf(chance) for chance in chances.ravel().tolist()]).reshape(chances.shape)


def gamma_below(value: float, shape: float) -> float:
    """The chance that a gamma variate of scale 1 and of this shape is below a value."""
    return _gamma(value, shape)[0]


def gamma_above(value: float, shape: float) -> float:
    """The chance that a gamma variate of scale 1 and of this shape is above a value."""
    return _gamma(value, shape)[1]


def chi_squared_above(value: float, degrees: float) -> float:
    """The chance that a chi-squared variate with so many degrees of freedom (at least 1) is above a value."""
    return gamma_above(value / 2, degrees / 2)


def chi_squared_exceeded(chance: float, degrees: float) -> float:
    """The value that a chi-squared variate exceeds with this chance."""
    # Where the search begins: Wilson & Hilferty 1931.
    spread = 2 / (9 * degrees)
    start = degrees * max(1 - spread - _NORMAL.inv_cdf(chance) * math.sqrt(spread), 0.05) ** 3

    def at(log: float) -> float:
        return _ratio(_gamma(math.exp(log) / 2, degrees / 2), (1 - chance, chance))

    return math.exp(where_one(at, math.log(start)))


def poisson_quantile(chance: float, mean: float) -> int:
    """The smallest number that a Poisson variate exceeds with a chance of at most 1 - `chance`."""
    # Where the search begins: Cornish & Fisher 1938.
    z = _NORMAL.inv_cdf(chance)
    k = max(0, math.ceil(mean + z * math.sqrt(mean) + (z * z - 1) / 6 - 0.5))
    while k and gamma_above(mean, k) >= chance:
        k -= 1
    while gamma_above(mean, k + 1) < chance:
        k += 1
    return k


def beta_below(value: float, a: float, b: float) -> float:
    """The chance that a beta variate is below a value; one of a and b is at least 1/2, the other at least 1/50."""
    return _beta(value, 1 - value, a, b)[0]


def beta_above(value: float, a: float, b: float) -> float:
    """The chance that a beta variate is above a value; a and b as in `beta_below`."""
    return _beta(value, 1 - value, a, b)[1]


@functools.lru_cache(maxsize=4096)
def beta_quantile(chance: float, a: float, b: float) -> float:
    """The value below which a beta variate lies with this chance."""
    return _beta_quantile((chance, 1 - chance), a, b)


@functools.lru_cache(maxsize=4096)
def beta_exceeded(chance: float, a: float, b: float) -> float:
    """The value that a beta variate exceeds with this chance."""
    return _beta_quantile((1 - chance, chance), a, b)


def binomial_above(k: float, n: float, p: float) -> float:
    """The chance of more than k events in n independent trials of probability p; k is below n."""
    return beta_below(p, k + 1, n - k)


def student_below(value: float, degrees: float) -> float:
    """The chance that Student's t with so many degrees of freedom (at least 1) is below a value."""
    ratio = value * value / degrees
    tail = _beta(1 / (1 + ratio), 1 / (1 + 1 / max(ratio, _TINY)), degrees / 2, 0.5)[0] / 2
    return tail if value <= 0 else 1 - tail


def student_quantile(chance: float, degrees: float) -> float:
    """The value below which Student's t with so many degrees of freedom (at least 1) lies with this chance."""
    if chance <= 0.5:
        return -student_quantile(1 - chance, degrees) if chance < 0.5 else 0.0
    start = math.log(_NORMAL.inv_cdf(chance))
    return math.exp(where_one(lambda log: (1 - chance) / max(student_below(-math.exp(log), degrees), _TINY), start))


def smirnov_above(distance: float, n: int) -> float:
    """The chance that the distribution function of n values somewhere lies more than a distance above the true one.

    One side of the test of Kolmogorov & Smirnov (Birnbaum & Tingey 1951).
    """
    if not 0 < distance < 1:
        return 1.0 if distance <= 0 else 0.0
    j = np.arange(math.floor(n * (1 - distance)) + 1)
    logs = np.concatenate(([0.0], np.cumsum(np.log(np.arange(1, n + 1)))))
    below, above = 1 - distance - j / n, distance + j / n
    chances = logs[n] - logs[j] - logs[n - j] + (n - j) * np.log(np.maximum(below, _TINY)) + (j - 1) * np.log(above)
    return min(1.0, distance * float(np.exp(chances).sum()))


def _gamma(value: float, shape: float) -> tuple[float, float]:
    """The chances below and above. The smaller one is an integral over s: the variate is value exp(-s) or value + s."""
    if value <= 0 or value == math.inf:
        return (0.0, 1.0) if value <= 0 else (1.0, 0.0)
    if shape < 0.5:
        below = math.exp(shape * math.log(value) - value - math.lgamma(shape + 1)) + _gamma(value, shape + 1)[0]
        return below, 1 - below
    density = math.sqrt(shape / (2 * math.pi)) * math.exp(-_stirling_rest(shape) - _deviance(shape, value))
    if value < shape:
        s, weights = _quadrature(shape - value, value)
        below = density * float(np.exp(-shape * s - value * np.expm1(-s)) @ weights)
        return below, 1 - below
    s, weights = _quadrature(1 - (shape - 1) / value, abs(shape - 1) / value**2)
    above = density / value * float(np.exp((shape - 1) * np.log1p(s / value) - s) @ weights)
    return 1 - above, above


def _beta(x: float, y: float, a: float, b: float) -> tuple[float, float]:
    """The chances below and above x, where y is 1 - x. The smaller one is an integral over s: the variate is x exp(-s)
    or 1 - y exp(-s)."""
    if x * b > y * a:
        below, above = _beta(y, x, b, a)
        return above, below
    if x == 0:
        return 0.0, 1.0
    n, odds = a + b, x / y
    log_density = _stirling_rest(n) - _stirling_rest(a) - _stirling_rest(b) - _deviance(a, n * x) - _deviance(b, n * y)
    s, weights = _quadrature(a - (b - 1) * odds, abs(b - 1) * odds / y)
    integral = float(np.exp((b - 1) * np.log1p(-odds * np.expm1(-s)) - a * s) @ weights)
    below = math.sqrt(a * b / (2 * math.pi * n)) * math.exp(log_density) / y * integral
    return below, 1 - below


def _quadrature(slope: float, curvature: float) -> tuple[Floats, Floats]:
    """Places and weights to integrate a function that is 1 at 0 and whose log falls with this slope and curvature."""
    width = 2 / (slope + math.sqrt(slope * slope + 2 * curvature))  # where it has fallen by 1
    return width * _PLACES, width * _WEIGHTS


def _deviance(shape: float, value: float) -> float:
    """shape log(shape / value) + value - shape, with all digits where both are nearly equal (Loader 2000)."""
    by = (value - shape) / shape
    return shape * (by - (math.log1p(by) if abs(by) < 0.5 else math.log(value / shape)))


def _stirling_rest(z: float) -> float:
    """log Gamma(z) - (z - 1/2) log z + z - log(2 pi) / 2."""
    if z < _LARGE:
        return math.lgamma(z) - (z - 0.5) * math.log(z) + z - 0.5 * math.log(2 * math.pi)
    r = 1 / (z * z)
    return (1 / 12 - r * (1 / 360 - r * (1 / 1260 - r * (1 / 1680 - r / 1188)))) / z


def _beta_quantile(chances: tuple[float, float], a: float, b: float) -> float:
    """The value that has these chances of a beta variate below and above it, searched among log odds."""

    def at(log_odds: float) -> float:
        return _ratio(_beta(_of_log_odds(log_odds), _of_log_odds(-log_odds), a, b), chances)

    # Where the search begins: log odds are nearly normal. For a small a, the chance rises with the power a.
    z = _NORMAL.inv_cdf(chances[0]) if chances[0] < chances[1] else -_NORMAL.inv_cdf(chances[1])
    start = math.log(a / b) + z * math.sqrt(1 / a + 1 / b)
    if a < 1:
        start = min(start, math.log(a / b) + math.log(chances[0]) / a)
    return _of_log_odds(where_one(at, start))


def _of_log_odds(log_odds: float) -> float:
    return 1 / (1 + math.exp(min(-log_odds, 700.0)))


def _ratio(found: tuple[float, float], asked: tuple[float, float]) -> float:
    """How far the chances below and above are from the requested ones: a rising ratio, from the side that has more
    digits."""
    return found[0] / asked[0] if asked[0] < asked[1] else asked[1] / max(found[1], _TINY)
