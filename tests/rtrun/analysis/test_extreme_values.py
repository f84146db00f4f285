"""Worst cases: right where the assumptions hold, refused with the reason where they do not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter
from scipy.stats import genextreme, genpareto, norm

from rtrun.analysis.tails.extreme_values import Bound, tail_of
from rtrun.analysis.tails.fits import GEV, GPD, fit, negative_log_likelihood, profile_interval, sample_of
from rtrun.analysis.tails.worst_case import disagreement, exponential_tail, worst_case

N = 200_000


def rng(seed: int = 5) -> np.random.Generator:
    return np.random.default_rng(seed)


def exponential(n: int = N, seed: int = 5, scale: float = 5000.0) -> np.ndarray:
    return (50_000 + rng(seed).exponential(scale, n)).astype(np.int64)


def bounds(values: np.ndarray, probability: float = 1e-6, quantum_ns: int = 1) -> tuple[Bound, ...]:
    return worst_case([tail_of(values)], probability=probability, quantum_ns=quantum_ns)


@pytest.mark.parametrize("step", [1, 1000])
@pytest.mark.parametrize("shape", [-0.2, 0.0, 0.2])
def test_fits_find_the_parameters_whatever_the_resolution(shape: float, step: int) -> None:
    values = genpareto.rvs(shape, scale=5000, size=20_000, random_state=rng()).astype(np.int64) // step * step
    (found_shape, scale), _ = fit(GPD, sample_of(values, step))
    assert found_shape == pytest.approx(shape, abs=0.04) and scale == pytest.approx(5000, rel=0.05)
    maxima = genextreme.rvs(-shape, 100_000, 5000, size=20_000, random_state=rng()).astype(np.int64) // step * step
    (found_shape, scale, location), _ = fit(GEV, sample_of(maxima, step))
    assert found_shape == pytest.approx(shape, abs=0.04) and scale == pytest.approx(5000, rel=0.05)
    assert location == pytest.approx(100_000, rel=0.01)


@pytest.mark.parametrize("step", [1, 1000])
def test_bounds_cover_the_true_level(step: int) -> None:
    truth = 50_000 - 5000 * np.log(1e-6)
    for bound in bounds(exponential() // step * step, quantum_ns=step):
        assert bound.refused is None
        assert bound.low_ns is not None and bound.high_ns is not None and bound.level_ns is not None
        assert bound.low_ns <= bound.level_ns <= bound.high_ns
        assert bound.low_ns <= truth <= bound.high_ns


@pytest.mark.parametrize("seed", range(6))
def test_the_ends_of_an_interval_are_where_the_likelihood_has_dropped_by_its_limit(seed: int) -> None:
    """The likelihood of each end by a search of its own, which begins in many places."""
    drawn = 100_000 + 20_000 * genextreme.rvs(-0.2, size=30, random_state=seed)
    sample, chance = sample_of(drawn.astype(np.int64), 1000), 0.01
    parameters, least = fit(GEV, sample)
    _, scale, location = parameters
    for level in profile_interval(GEV, sample, (parameters, least), chance, 0.95):

        def cost(free: np.ndarray, level: float = level) -> float:
            return negative_log_likelihood(GEV, sample, GEV.with_level(level, chance, free))

        begins = [
            [shape, np.log((level - location - moved * scale) / GEV.level(chance, (shape, 1, 0)))]
            for shape in np.linspace(-0.9, 0.95, 38)
            for moved in (-0.3, 0, 0.3)
        ]
        with np.errstate(all="ignore"):
            lowest = minimize(cost, min(begins, key=cost), method="Nelder-Mead", options={"xatol": 1e-6}).fun
        assert lowest - least == pytest.approx(1.9207, abs=0.002)


def refused_for(values: np.ndarray, *reasons: str, **more: float) -> None:
    for bound in bounds(values, **more):  # type: ignore[arg-type]
        assert bound.refused is not None and any(reason in bound.refused for reason in reasons), bound.refused
        assert (bound.level_ns, bound.low_ns, bound.high_ns) == (None, None, None)


def test_a_trend_is_refused() -> None:
    refused_for((50_000 + rng().exponential(5000, N) * np.linspace(1, 2, N)).astype(np.int64), "stationarity")


def test_a_step_in_the_middle_is_refused() -> None:
    refused_for(np.concatenate([exponential(N // 2), exponential(N // 2, 6) + 40_000]), "stationarity", "bursts leave")


def test_a_tail_narrower_than_the_resolution_is_refused() -> None:
    # The third opinion needs 500 independent high values, and steps this coarse leave fewer.
    coarse = exponential(scale=500.0) // 1000 * 1000
    refused_for(coarse, "quantisation", "fewer than 500 independent high values", quantum_ns=1000)


def test_constant_values_are_refused() -> None:
    for bound in bounds(np.full(N, 50_000)):
        assert bound.refused is not None and bound.level_ns is None


def test_two_kinds_of_values_are_refused() -> None:
    values = rng().integers(50_000, 51_000, N)
    values[rng(9).random(N) < 1e-3] = 900_000
    for bound in bounds(values):
        assert bound.refused is not None and bound.level_ns is None


def test_a_surprise_in_the_second_half_is_refused() -> None:
    values = exponential()
    values[-5] = 9_000_000
    for bound in bounds(values):
        assert bound.refused is not None and any(
            reason in bound.refused for reason in ("back-test", "fit", "vary more")
        )


def test_slow_waves_are_refused_or_covered() -> None:
    """Dependence over the length of blocks shows between the peaks."""
    wave = np.repeat(rng().normal(size=N // 2000), 2000) * 15_000
    values = (100_000 + wave + rng(6).exponential(3000, N)).astype(np.int64)
    peaks, *_ = bounds(values)
    assert peaks.refused is not None


def test_short_memory_is_declustered() -> None:
    noise = rng().normal(size=N) * np.sqrt(1 - 0.9**2)
    values = (100_000 + 10_000 * lfilter([1], [1, -0.9], noise)).astype(np.int64)
    peaks, *_ = bounds(values)
    bursts = next(check for check in peaks.checks if "extremal index" in check.seen)
    assert float(bursts.seen.split()[2].rstrip(",")) < 0.9
    assert peaks.refused is None


@pytest.mark.parametrize("n", [0, 1, 30])
def test_too_few_values_are_refused(n: int) -> None:
    for bound in bounds(exponential(n), probability=1e-2):
        assert bound.refused is not None


def test_too_far_beyond_the_data_is_refused() -> None:
    refused_for(exponential(), "100 times beyond", probability=1e-12)


def test_a_probability_within_the_data_is_refused() -> None:
    refused_for(exponential(), "within the data", probability=0.2)


def test_runs_are_taken_in_their_order() -> None:
    parts = [tail_of(exponential(N // 2, seed)) for seed in (1, 2)]
    peaks, maxima, _ = worst_case(parts, probability=1e-6)
    assert peaks.refused is None and maxima.refused is None
    louder = [parts[0], tail_of(exponential(N // 2, 3) + 60_000)]
    assert all(bound.refused is not None for bound in worst_case(louder, probability=1e-6))


def test_a_tail_lighter_than_exponential_is_bounded_by_the_residual_cv() -> None:
    """Normal values: the GPD's interval is too short more often than it says, the exponential tail's is not."""
    truth = 100_000 + 5000 * norm.isf(1e-6)
    found = []
    for seed in range(12):
        bound = exponential_tail([tail_of(rng(seed).normal(100_000, 5000, N).astype(np.int64))], 1e-6, 0.95, 1)
        if bound.high_ns is not None:
            found.append(bound.high_ns >= truth)
    assert len(found) >= 10 and np.mean(found) >= 0.9


def test_a_heavy_tail_has_no_exponential_bound() -> None:
    values = (50_000 + genpareto.rvs(0.3, scale=5000, size=N, random_state=rng())).astype(np.int64)
    assert "vary more" in str(worst_case([tail_of(values)], probability=1e-6)[2].refused)


def test_opinions_that_have_nothing_in_common_are_named() -> None:
    peaks, maxima, _ = bounds(exponential())
    assert disagreement([peaks, maxima]) is None
    assert peaks.low_ns is not None and maxima.high_ns is not None
    apart = replace(maxima, low_ns=peaks.low_ns - 2e6, high_ns=peaks.low_ns - 1e6)
    assert "GPD and GEV disagree" in str(disagreement([peaks, apart]))
    refused = replace(maxima, refused="no fit", low_ns=None, high_ns=None)
    assert disagreement([peaks, refused]) is None


def test_simulated_opinions_that_have_nothing_in_common_are_named() -> None:
    """Three in a thousand values lie about a second peak: GPD and GEV see another tail in them."""
    drawn = rng(3)
    values = 100_000 + drawn.exponential(3000, N)
    second = drawn.random(N) < 3e-3
    values[second] = 120_000 + drawn.exponential(500, second.sum())
    peaks, maxima, exponential_bound = bounds(values.astype(np.int64), 1e-7)
    assert peaks.high_ns is not None and maxima.low_ns is not None and peaks.high_ns < maxima.low_ns
    assert "GPD and GEV disagree" in str(disagreement([peaks, maxima, exponential_bound]))


def test_a_light_tail_is_no_disagreement() -> None:
    """Uniform values: the exponential tail bounds them from above, far from what GPD and GEV agree on."""
    peaks, maxima, exponential_bound = bounds((100_000 + 5000 * rng(0).random(N)).astype(np.int64), 1e-7)
    assert peaks.high_ns is not None and maxima.high_ns is not None and exponential_bound.low_ns is not None
    assert exponential_bound.low_ns > max(peaks.high_ns, maxima.high_ns)
    assert disagreement([peaks, maxima, exponential_bound]) is None


def test_fits_are_those_of_scipy() -> None:
    """The oracle: scipy fits the same families to samples without steps by their density."""
    excess = genpareto.rvs(0.1, scale=5000, size=5000, random_state=rng())
    shape, _, scale = genpareto.fit(excess, floc=0)
    assert fit(GPD, sample_of(excess.astype(np.int64), 1))[0] == pytest.approx((shape, scale), rel=0.03, abs=0.005)
    maxima = genextreme.rvs(-0.1, 100_000, 5000, size=5000, random_state=rng())
    shape, location, scale = genextreme.fit(maxima, -0.1, loc=100_000, scale=5000)
    assert fit(GEV, sample_of(maxima.astype(np.int64), 1))[0] == pytest.approx(
        (-shape, scale, location), rel=0.03, abs=0.005
    )


def test_levels_are_those_of_scipy() -> None:
    """The oracle: the level that scipy's fit to all values above the same threshold gives."""
    values = exponential(50_000)
    bound = bounds(values, probability=1e-5)[0]
    assert bound.threshold_ns is not None and bound.level_ns is not None
    excess = values[values > bound.threshold_ns] - bound.threshold_ns
    shape, _, scale = genpareto.fit(excess, floc=0)
    beyond = genpareto.isf(1e-5 * values.size / excess.size, shape, scale=scale)
    assert bound.level_ns == pytest.approx(bound.threshold_ns + beyond, rel=0.02)


def test_the_same_values_give_the_same_bound() -> None:
    assert bounds(exponential()) == bounds(exponential())
