"""Did a run stay the same: changes are seen where they are, and seldom where they are not."""

import numpy as np

from rtrun.analysis.order.stationarity import SIGNIFICANT, find_change, test_of_ends, test_of_parts

# pytest would collect them.
ends, parts = test_of_ends, test_of_parts
del test_of_ends, test_of_parts


def test_the_test_of_ends_is_exact() -> None:
    p, count, fraction = ends(np.array([95, 99]), 100)
    # Two of two within the last 5 %: 0.05 squared, four tests.
    assert (count, fraction) == (2, 0.05) and abs(p - 4 * 0.05**2) < 1e-12


def test_even_events_are_no_change() -> None:
    rng = np.random.default_rng(5)
    for k in (2, 5, 30, 300):
        change = find_change(np.sort(rng.choice(100_000, k, replace=False)), 100_000, "misses")
        assert change is None or change.p_value > SIGNIFICANT


def test_a_change_is_seen() -> None:
    rng = np.random.default_rng(6)
    half = find_change(np.sort(rng.choice(50_000, 60, replace=False)), 100_000, "misses")
    assert half is not None and half.p_value < 1e-6
    start = find_change(np.arange(0, 4000, 1000), 100_000, "misses")
    assert start is not None and start.p_value < SIGNIFICANT and "first 3 %" in start.text
    middle = np.concatenate((np.arange(1000, 100_000, 2000), np.arange(50_100, 60_000, 250)))
    eighths = find_change(np.unique(middle), 100_000, "misses")
    assert (
        eighths is not None
        and eighths.p_value < SIGNIFICANT
        and "lie in 12.5 % of a run, after 50 % of it" in eighths.text
    )
    assert parts(np.arange(0, 100_000, 2000), 100_000)[0] > 0.9


def test_a_burst_is_no_change() -> None:
    change = find_change(np.arange(70_000, 70_012), 100_000, "misses")
    assert change is None or change.p_value > SIGNIFICANT
