"""The search for a period of late values, on events whose truth is known."""

import numpy as np
import pytest

from rtrun.analysis.recurrence import ALPHA, find_recurrence

S = 10**9
LOOP = 10**6  # 1 kHz
LENGTH = 30 * S
DRAWS = 100


def on_loops(times):
    """Times as a measurement has them: of loops, each once, in order."""
    return np.unique(np.asarray(times, dtype=np.int64) // LOOP * LOOP)


def search(times, length=LENGTH):
    return find_recurrence(on_loops(times), begin=0, end=length, loop=LOOP)


@pytest.mark.parametrize("period_ns", [S, S // 4, S // 2, 1_234_567_890])
@pytest.mark.parametrize("lost", [0.0, 0.25])
def test_a_period_is_found(period_ns, lost):
    random = np.random.default_rng(1)
    exact = np.arange(0.3 * period_ns, LENGTH - period_ns, period_ns)
    times = exact + random.normal(0, 0.02 * period_ns, exact.size)
    times = times[random.random(times.size) >= lost]
    found = search(np.sort(times))
    assert found is not None
    assert found.period == pytest.approx(period_ns, rel=2e-3)
    assert found.covered <= found.cycles


def test_a_period_among_other_late_values():
    random = np.random.default_rng(2)
    found = search(np.sort(np.concatenate([np.arange(0, LENGTH, S), random.integers(0, LENGTH, 40)])))
    assert found is not None
    assert found.period == pytest.approx(S, rel=1e-3)


def test_a_burst_each_second_counts_once():
    times = (np.arange(0, LENGTH, S)[:, None] + np.arange(5) * LOOP).ravel()
    found = search(times)
    assert found is not None
    assert (found.events, round(found.period / S, 3)) == (30, 1.0)


def uniform(random):
    return random.integers(0, LENGTH, 100)


def few(random):
    return random.integers(0, LENGTH, 15)


def in_a_regime(random):
    """All of them in the last tenth of the run."""
    return random.integers(LENGTH * 9 // 10, LENGTH, 80)


def in_bursts(random):
    starts = random.integers(0, LENGTH, 20)
    return (starts[:, None] + random.integers(0, S // 2, (20, 6))).ravel() % LENGTH


@pytest.mark.parametrize("draw", [uniform, few, in_a_regime, in_bursts])
def test_no_period_of_random_events(draw):
    """One of a hundred is allowed; the seed is fixed, so that the test has one outcome."""
    random = np.random.default_rng(3)
    false = sum(search(np.sort(draw(random))) is not None for _ in range(DRAWS))
    assert false <= 2 * ALPHA * DRAWS


def test_too_few_events_or_too_short_a_run():
    assert search(np.arange(0, LENGTH, 6 * S)) is None
    assert find_recurrence(np.arange(12, dtype=np.int64) * LOOP, begin=0, end=12 * LOOP, loop=LOOP) is None
    assert search(np.array([], dtype=np.int64)) is None
