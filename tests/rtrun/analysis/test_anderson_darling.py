"""The Anderson-Darling test of a fitted GPD against scipy's, and the choice of a threshold."""

import numpy as np
import pytest
from scipy.stats import genpareto, goodness_of_fit

from rtrun.analysis.tails.anderson_darling import forward_stop, p_value
from rtrun.analysis.tails.extreme_values import tail_of
from rtrun.analysis.tails.fits import GPD, fit, sample_of
from rtrun.analysis.tails.peaks import peaks_over_threshold


def p_of(excesses: np.ndarray, quantum_ns: int = 1) -> float:
    values = excesses.astype(np.int64) // quantum_ns * quantum_ns
    return p_value(values, quantum_ns, fit(GPD, sample_of(values, quantum_ns))[0])


@pytest.mark.parametrize(("kind", "seed"), [("pareto", 4), ("square root", 1)])
def test_p_values_are_those_of_scipys_simulation(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    excesses = genpareto.rvs(0.1, scale=5000, size=100, random_state=rng)
    if kind == "square root":
        excesses = 5000 * np.sqrt(excesses / 5000)
    oracle = goodness_of_fit(
        genpareto,
        excesses,
        known_params={"loc": 0},
        statistic="ad",
        n_mc_samples=60,
        random_state=np.random.RandomState(3),
    )
    # 60 simulated samples know a p-value to 0.13 (two standard errors at 0.5).
    assert p_of(excesses) == pytest.approx(oracle.pvalue, abs=0.15)


@pytest.mark.parametrize("quantum_ns", [1, 1000])
@pytest.mark.parametrize("shape", [-0.3, 0.0, 0.3])
def test_a_fit_of_what_it_is_fitted_to_is_not_rejected(shape: float, quantum_ns: int) -> None:
    found = [p_of(genpareto.rvs(shape, scale=5000, size=400, random_state=seed), quantum_ns) for seed in range(4)]
    assert min(found) > 0.05 and max(found) < 0.99


def test_other_distributions_are_rejected() -> None:
    rng = np.random.default_rng(1)
    assert p_of(np.abs(rng.normal(20_000, 5000, 1000))) < 1e-3
    assert p_of(np.concatenate([rng.exponential(1000, 500), 20_000 + rng.exponential(1000, 500)])) < 1e-3


@pytest.mark.parametrize(
    ("p_values", "rejected"),
    [([], 0), ([0.5, 0.9], 0), ([0.01, 0.02, 0.8, 0.9], 2), ([0.2, 0.001, 0.001, 0.9], 3), ([0.001, 1.0], 1)],
)
def test_forward_stop_rejects_as_long_as_the_mean_surprise_is_small(p_values: list[float], rejected: int) -> None:
    assert forward_stop(p_values, 0.1) == rejected


def test_the_threshold_lies_where_the_tail_begins_to_be_a_gpd() -> None:
    """Of 100 000 values the 300 highest have a tail 20 times as wide as what lies below them."""
    rng = np.random.default_rng(2)
    values = (50_000 + rng.uniform(0, 30_000, 100_000)).astype(np.int64)
    tail = rng.permutation(100_000)[:300]
    values[tail] = (80_000 + rng.exponential(6000, 300)).astype(np.int64)
    bound = peaks_over_threshold([tail_of(values)], 1e-5, 0.95, 1)
    assert bound.refused is None and bound.threshold_ns is not None and bound.high_ns is not None
    assert bound.threshold_ns > 79_900
    assert bound.low_ns is not None and bound.low_ns < 80_000 + 6000 * np.log(300) < bound.high_ns
