"""Distributions and searches that are ours against scipy's."""

import math

import numpy as np
import pytest
from scipy import optimize, special, stats

from rtrun.analysis.chance import distributions
from rtrun.analysis.chance.search import crossing, lowest_point

N = 300
# scipy has fewer digits in places: of the chi-squared below 1e-6 for a million degrees of freedom eight, where ours has
# twelve (`test_where_scipy_has_fewer_digits`).
CLOSE = 1e-11


def spread(low, high, seed):
    """Numbers even in their logs."""
    return np.exp(np.random.default_rng(seed).uniform(math.log(low), math.log(high), N))


def assert_alike(ours, scipys, *arguments, least=1e-200):
    expected = scipys(*arguments)
    found = np.array([ours(*map(float, values)) for values in zip(*arguments, strict=True)])
    kept = expected > least
    assert kept.sum() > N / 2
    assert found[kept] == pytest.approx(expected[kept], rel=CLOSE)
    assert found[~kept] == pytest.approx(expected[~kept], abs=least * 2)


@pytest.mark.parametrize("a", [0.02, 0.5, 1.0, 7.3, 1000.0, 1e6])
@pytest.mark.parametrize("b", [0.5, 1.0, 40.0, 2e6, 1e9])
def test_beta(a, b):
    mean, deviation = a / (a + b), math.sqrt(a * b / (a + b + 1)) / (a + b)
    near = mean + deviation * np.random.default_rng(1).uniform(-8, 8, N)
    values = np.where((near > 0) & (near < 1), near, spread(1e-12, 1, 2))
    values[:2] = 0, 1
    pairs = np.full(N, a), np.full(N, b)
    assert_alike(lambda a, b, x: distributions.beta_below(x, a, b), special.betainc, *pairs, values)
    assert_alike(lambda a, b, x: distributions.beta_above(x, a, b), special.betaincc, *pairs, values)


@pytest.mark.parametrize("a", [0.5, 1.0, 7.3, 1000.0, 1e6])
@pytest.mark.parametrize("b", [40.0, 2e6, 1e9])
def test_quantiles_of_beta(a, b):
    """By scipy's chances: its quantile for a = 1000 and b = 1e9 is 1.9e-6, whatever the chance."""
    for chance in (1e-9, 1e-4, 0.025, 0.3, 0.7, 0.95, 0.9999):
        assert special.betainc(a, b, distributions.beta_quantile(chance, a, b)) == pytest.approx(chance, rel=1e-10)
        assert special.betaincc(a, b, distributions.beta_exceeded(chance, a, b)) == pytest.approx(chance, rel=1e-10)


def test_gamma_and_chi_squared():
    degrees = spread(1, 1e5, 1)
    values = np.maximum(1e-3, degrees + np.sqrt(2 * degrees) * np.random.default_rng(2).uniform(-4, 8, N))
    assert_alike(lambda k, x: distributions.chi_squared_above(x, k), special.chdtrc, degrees, values)
    assert_alike(lambda k, x: distributions.gamma_below(x, k), special.gammainc, degrees / 50, values / 50)
    chances = np.concatenate((spread(1e-9, 0.5, 3)[::2], 1 - spread(1e-6, 0.5, 4)[::2]))
    assert_alike(lambda k, p: distributions.chi_squared_exceeded(p, k), special.chdtri, degrees, chances)
    assert distributions.chi_squared_above(0.0, 3) == 1 and distributions.chi_squared_above(math.inf, 3) == 0


def test_student():
    degrees, values = spread(1, 1e6, 1), np.random.default_rng(2).standard_t(2, N) * 3
    assert_alike(lambda k, t: distributions.student_below(t, k), special.stdtr, degrees, values)
    assert_alike(lambda k, p: distributions.student_quantile(p, k), special.stdtrit, degrees, 1 - spread(1e-7, 0.5, 3))
    assert distributions.student_quantile(0.1, 5) == -distributions.student_quantile(0.9, 5)


def test_normal_poisson_binomial_and_smirnov():
    chances = spread(1e-12, 1, 1)
    assert distributions.normal_quantiles(chances) == pytest.approx(special.ndtri(chances), rel=CLOSE)
    means = spread(1e-3, 1e9, 2)
    for chance in (0.1, 0.9):
        expected = np.ceil(np.maximum(0, special.pdtrik(chance, means)))
        assert [distributions.poisson_quantile(chance, mean) for mean in means.tolist()] == expected.tolist()
    k, n = np.floor(spread(1, 100, 3)), np.floor(spread(101, 5000, 4))
    found = [distributions.binomial_above(*case) for case in zip(k.tolist(), n.tolist(), (k / n).tolist(), strict=True)]
    assert found == pytest.approx(stats.binom.sf(k, n, k / n), rel=CLOSE)
    n = np.floor(spread(1, 1000, 5))
    farthest = spread(0.001, 1, 6)
    for count, distance in zip(n.tolist(), farthest.tolist(), strict=True):
        expected = float(special.smirnov(int(count), distance))
        assert distributions.smirnov_above(distance, int(count)) == pytest.approx(expected, rel=1e-10, abs=1e-200)


@pytest.mark.parametrize("function", ["beta_below", "beta_above", "gamma_above", "student_below", "chi_squared_above"])
def test_no_number_stays_none(function):
    arguments = (3.0, 4.0) if function.startswith("beta") else (3.0,)
    assert math.isnan(getattr(distributions, function)(math.nan, *arguments))


def test_where_scipy_has_fewer_digits():
    """Their exact values, from the series of the incomplete gamma function in numbers of 60 digits."""
    assert distributions.gamma_below(976772 / 2, 983569 / 2) == pytest.approx(5.9613952936597647e-07, rel=1e-12)


def valley(place):
    x, y = place
    return 100 * (y - x * x) ** 2 + (1 - x) ** 2


def test_the_lowest_point_is_that_of_scipys_simplex():
    begin = np.array([-1.2, 1.0])
    simplex = np.vstack([begin, begin + 0.1 * np.eye(2)])
    options = {"xatol": 1e-7, "fatol": 1e-8, "maxiter": 1500, "initial_simplex": simplex}
    expected = optimize.minimize(valley, begin, method="Nelder-Mead", options=options)
    place, least = lowest_point(valley, begin.tolist(), step=0.1, tolerance=1e-8)
    assert place == pytest.approx(expected.x, abs=1e-6) == [1, 1] and least == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize("function", [lambda x: x**3 - 2, lambda x: math.exp(x) - 9, lambda x: math.atan(x - 1.7)])
def test_a_crossing_is_that_of_scipy(function):
    expected = optimize.brentq(function, 0, 8)
    assert crossing(function, 0, 8, tolerance=1e-6) == pytest.approx(expected, abs=1e-6)
    assert crossing(function, 8, 0, tolerance=1e-6) == pytest.approx(expected, abs=1e-6)
