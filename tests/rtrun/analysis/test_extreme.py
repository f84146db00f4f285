"""Worst cases: right where the assumptions hold, refused with the reason where they do not."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import genextreme, genpareto

from rtrun.analysis.extreme import Bound, tail_of, worst_case
from rtrun.analysis.tails import GEV, GPD, fit, sample_of

N = 200_000


def rng(seed: int = 5) -> np.random.Generator:
    return np.random.default_rng(seed)


def exponential(n: int = N, seed: int = 5, scale: float = 5000.0) -> np.ndarray:
    return (50_000 + rng(seed).exponential(scale, n)).astype(np.int64)


def bounds(values: np.ndarray, probability: float = 1e-6, quantum_ns: int = 1) -> tuple[Bound, Bound]:
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
    inside, made = 0, 0
    for seed in range(20):
        for bound in bounds(exponential(seed=seed) // step * step, quantum_ns=step):
            if bound.refused is None:
                assert bound.low_ns is not None and bound.high_ns is not None and bound.level_ns is not None
                assert bound.low_ns <= bound.level_ns <= bound.high_ns
                made += 1
                inside += bound.low_ns <= truth <= bound.high_ns
    assert made >= 32  # at most a fifth wrongly refused
    assert inside / made >= 0.88


def refused_for(values: np.ndarray, *reasons: str, **more: float) -> None:
    for bound in bounds(values, **more):  # type: ignore[arg-type]
        assert bound.refused is not None and any(reason in bound.refused for reason in reasons), bound.refused
        assert (bound.level_ns, bound.low_ns, bound.high_ns) == (None, None, None)


def test_a_trend_is_refused() -> None:
    refused_for((50_000 + rng().exponential(5000, N) * np.linspace(1, 2, N)).astype(np.int64), "stationarity")


def test_a_step_in_the_middle_is_refused() -> None:
    refused_for(np.concatenate([exponential(N // 2), exponential(N // 2, 6) + 40_000]), "stationarity", "bursts leave")


def test_a_tail_narrower_than_the_resolution_is_refused() -> None:
    refused_for(exponential(scale=500.0) // 1000 * 1000, "quantisation", quantum_ns=1000)


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
        assert bound.refused is not None and ("back-test" in bound.refused or "fit" in bound.refused)


def test_slow_waves_are_refused_or_covered() -> None:
    """Dependence over the length of blocks shows between the peaks."""
    wave = np.repeat(rng().normal(size=N // 2000), 2000) * 15_000
    values = (100_000 + wave + rng(6).exponential(3000, N)).astype(np.int64)
    peaks, _ = bounds(values)
    assert peaks.refused is not None


def test_short_memory_is_declustered() -> None:
    noise = rng().normal(size=N) * np.sqrt(1 - 0.9**2)
    values = (100_000 + 10_000 * lfilter([1], [1, -0.9], noise)).astype(np.int64)
    peaks, _ = bounds(values)
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
    peaks, maxima = worst_case(parts, probability=1e-6)
    assert peaks.refused is None and maxima.refused is None
    louder = [parts[0], tail_of(exponential(N // 2, 3) + 60_000)]
    assert all(bound.refused is not None for bound in worst_case(louder, probability=1e-6))


def test_the_same_values_give_the_same_bound() -> None:
    assert bounds(exponential()) == bounds(exponential())
