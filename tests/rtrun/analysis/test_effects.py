"""Effects over runs, Holm's procedure, and periods."""

import numpy as np
import pytest
from scipy.stats import ttest_ind

from rtrun.analysis.comparison.effects import examine_effect, holm
from rtrun.analysis.order.periods import burst_peaks, find_period


def test_the_chances_are_those_of_welch() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(100, 5, 6), rng.normal(130, 9, 8)
    effect = examine_effect(a, b, sign=1, least_ns=20, refuting_ns=25)
    assert effect.p_above == pytest.approx(ttest_ind(b - 20, a, equal_var=False, alternative="greater").pvalue)
    assert effect.p_below == pytest.approx(ttest_ind(b - 25, a, equal_var=False, alternative="less").pvalue)
    mirrored = examine_effect(b, a, sign=-1, least_ns=20, refuting_ns=25)
    assert mirrored.p_above == pytest.approx(effect.p_above) and mirrored.p_below == pytest.approx(effect.p_below)


def test_runs_that_are_all_equal() -> None:
    effect = examine_effect(np.full(5, 1.0), np.full(5, 3.0), sign=1, least_ns=1, refuting_ns=0)
    assert (effect.p_above, effect.p_below) == (0.0, 1.0)


def test_holm() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005], 0.05) == [True, False, False, True]
    assert holm([], 0.05) == []


def test_chance_rarely_makes_a_period() -> None:
    rng = np.random.default_rng(2)
    seen = sum(
        find_period([(np.sort(rng.integers(0, 20_000, 10)), 20_000) for _ in range(4)])[1] < 0.01 for _ in range(200)
    )
    assert seen <= 6


def test_a_period_is_found_whatever_its_phase() -> None:
    period, p_value = find_period([(np.arange(phase, 20_000, 2000), 20_000) for phase in (3, 700, 1500)])
    assert 2000 % period == 0 and p_value < 1e-6


def test_a_burst_has_one_peak() -> None:
    assert burst_peaks([500, 503, 501, 9000], 10_000).tolist() == [500, 9000]
