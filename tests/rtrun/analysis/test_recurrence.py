"""The search for a period of late values, on values whose truth is known: tests/coverage/late_values.py has more."""

import numpy as np
import pytest

from rtrun.analysis.order.recurrence import counts_tried, find_recurrence

S = 10**9
LOOP = 10**6  # 1 kHz
LENGTH = 30 * S


def search(times, *, others=600):
    """The period of late values at these times; as many others as make a thousandth or two are drawn behind them."""
    random = np.random.default_rng(3)
    late = np.unique(np.asarray(times, dtype=np.int64) // LOOP * LOOP)
    rest = random.permutation(LENGTH // LOOP)[:others] * LOOP
    highest = np.concatenate([random.permutation(late), rest])
    return find_recurrence(highest, begin=0, end=LENGTH, values=LENGTH // LOOP)


@pytest.mark.parametrize("period_ns", [20 * LOOP, 333_333_333, S // 2, S, 1_234_567_890, LENGTH // 8])
@pytest.mark.parametrize("lost", [0.0, 0.25])
def test_a_period_is_found(period_ns, lost):
    random = np.random.default_rng(1)
    exact = np.arange(0.3 * period_ns, LENGTH, period_ns)
    times = exact + random.normal(0, 0.002 * period_ns, exact.size)
    if exact.size >= 20:
        times = times[random.random(times.size) >= lost]
    found = search(times)
    assert found is not None
    assert found.period == pytest.approx(period_ns, rel=2e-3)
    assert found.covered <= found.cycles
    assert found.cycles == pytest.approx(LENGTH / period_ns, abs=1)


def test_a_period_among_other_late_values():
    random = np.random.default_rng(2)
    found = search(np.concatenate([np.arange(0, LENGTH, S), random.integers(0, LENGTH, 20)]))
    assert found is not None
    assert found.period == pytest.approx(S, rel=1e-3)


def test_a_burst_each_second_counts_once():
    times = (np.arange(0, LENGTH, S)[:, None] + np.arange(5) * LOOP).ravel()
    found = search(times)
    assert found is not None
    assert (found.covered, found.cycles, round(found.period / S, 3)) == (30, 30, 1.0)


def test_late_values_in_a_tenth_of_the_run_have_no_period():
    assert search(np.arange(LENGTH * 9 // 10, LENGTH, S // 10), others=0) is None


def test_too_few_values_or_too_short_a_run():
    assert search(np.arange(0, LENGTH, 6 * S)) is None
    assert list(counts_tried(79)) == []
    places = np.arange(12, dtype=np.int64) * LOOP
    assert find_recurrence(places, begin=0, end=12 * LOOP, values=12) is None
