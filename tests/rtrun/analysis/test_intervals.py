"""Intervals of a probability: exact for one look, and right however often somebody looks."""

import numpy as np
import pytest
from scipy.stats import beta

from rtrun.analysis.chance.intervals import anytime_interval, clopper_pearson


@pytest.mark.parametrize(("k", "n"), [(0, 10), (1, 94_000_000), (3, 50), (50, 50), (7, 1000)])
def test_the_interval_is_that_of_clopper_and_pearson(k: int, n: int) -> None:
    low, high = clopper_pearson(k, n, 0.95)
    assert low == pytest.approx(beta.ppf(0.025, k, n - k + 1) if k else 0.0, rel=1e-6)
    assert high == pytest.approx(beta.ppf(0.975, k + 1, n - k) if k < n else 1.0, rel=1e-6)


def test_the_thesis_one_miss_in_94_million() -> None:
    low, high = clopper_pearson(1, 94_000_000, 0.95)
    assert 2.6e-10 < low < 2.8e-10 and 5.8e-8 < high < 6.0e-8


def test_no_trial_tells_nothing() -> None:
    assert clopper_pearson(0, 0, 0.95) == (0.0, 1.0)
    assert anytime_interval(0, 0, 0.95) == (0.0, 1.0)


def test_without_a_miss_looking_again_costs_nothing() -> None:
    assert anytime_interval(0, 3689, 0.95) == clopper_pearson(0, 3689, 0.95)


def first_proof(interval, p: float, most: int) -> list[int]:
    """For each number of events the first n at which the interval's upper end is below p."""
    ends = []
    for k in range(most):
        low, high = 1, 100 * (k + 10) * round(1 / p)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if interval(k, middle, 0.95)[1] < p else (middle, high)
        ends.append(high)
    return ends


def last_refutation(interval, p: float, most: int) -> list[int]:
    """For each number of events from 1 on the last n at which the interval's lower end is above p; 0 for none."""
    ends = []
    for k in range(1, most + 1):
        low, high = 0, 2 * k * round(1 / p)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if middle >= k and interval(k, middle, 0.95)[0] > p else (low, middle)
        ends.append(low)
    return ends


@pytest.mark.parametrize(("interval", "proven", "refuted"), [(anytime_interval, 0.05, 0.05), (clopper_pearson, 1, 1)])
def test_looking_after_every_measurement(interval, proven: float, refuted: float) -> None:
    """The share of sequences with p exactly at the target that are ever answered wrongly, up to 100 events."""
    p, most = 1e-2, 100
    events = np.random.default_rng(20140715).geometric(p, (3000, most + 1)).cumsum(axis=1)
    # With k events the proof comes at a fixed n: wrong if event k + 1 (1-based) has not come by then.
    ever_proven = (events[:, :most] > first_proof(interval, p, most)).any(axis=1).mean()
    ever_refuted = (events[:, :most] <= last_refutation(interval, p, most)).any(axis=1).mean()
    if interval is anytime_interval:
        assert ever_proven <= proven and ever_refuted <= refuted
    else:  # one look's interval does not hold for many: what the other one is for
        assert ever_proven > 0.15 and ever_refuted > 0.15
