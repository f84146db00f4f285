"""Comparisons: level and power on dependent data, and the difference between none and none seen."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from rtrun.analysis.blocks import Blocks, add_outputs, cut, split_randomly
from rtrun.analysis.comparison import Change, compare, ratio_of_misses
from rtrun.analysis.deadline import count_misses, judge
from rtrun.analysis.histogram import from_samples
from rtrun.analysis.layers import attribute


def process(n: int, rng: np.random.Generator, mean_ns: float = 60_000, memory: float = 0.95) -> np.ndarray:
    noise = rng.normal(size=n + 500) * math.sqrt(1 - memory**2)
    return (mean_ns + 8000 * lfilter([1], [1, -memory], noise)[500:]).astype(np.int64)


def test_alike_is_rarely_called_different() -> None:
    rng = np.random.default_rng(2)
    answers = [compare([cut(process(20_000, rng))], [cut(process(20_000, rng))]).answer for _ in range(60)]
    assert answers.count(Change.DIFFERENT) <= 8  # 3 expected


def test_a_test_for_independent_data_would_call_them_different() -> None:
    """What the blocks are for: single measurements resampled make differences of chance."""
    from scipy.stats import ks_2samp

    rng = np.random.default_rng(2)
    wrong = sum(ks_2samp(process(5000, rng), process(5000, rng)).pvalue < 0.05 for _ in range(40))
    assert wrong >= 20


def test_a_shift_is_seen_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(3)
    found = [compare([cut(process(20_000, rng))], [cut(process(20_000, rng, 63_000))]) for _ in range(40)]
    assert sum(c.answer == Change.DIFFERENT for c in found) >= 38
    assert sum(c.shifts[0].low_ns <= 3000 <= c.shifts[0].high_ns for c in found) >= 34


def test_none_seen_is_not_none() -> None:
    rng = np.random.default_rng(14)
    small = compare([cut(process(3000, rng))], [cut(process(3000, rng))], margin_ns=500)
    assert small.answer == Change.NOT_SEEN and not small.shifts[0].within_margin
    large = compare([cut(process(200_000, rng))], [cut(process(200_000, rng))], margin_ns=20_000)
    assert large.answer == Change.SAME and all(shift.within_margin for shift in large.shifts)


def test_five_runs_a_side_put_the_difference_between_boots_into_the_interval() -> None:
    rng = np.random.default_rng(5)

    def boots() -> list[Blocks]:
        return [cut(process(4000, rng, 60_000 + 1500 * rng.normal())) for _ in range(6)]

    found = [compare(boots(), boots()) for _ in range(40)]
    assert all(c.units == "runs" and c.unit_counts == (6, 6) for c in found)
    assert sum(c.answer == Change.DIFFERENT for c in found) <= 5
    single = compare(boots()[:1], boots()[:1])
    assert single.units == "blocks" and "boots" in single.assumes[0]


def test_a_heavier_tail_is_seen_where_it_is() -> None:
    rng = np.random.default_rng(6)
    a, b = process(100_000, rng, memory=0.1), process(100_000, rng, memory=0.1)
    b = np.where(rng.random(b.size) < 0.005, b + 200_000, b)
    shifts = {shift.figure: shift for shift in compare([cut(a)], [cut(b)]).shifts}
    assert shifts["p99.9"].low_ns > 100_000 and not shifts["p50"].seen


def test_a_few_values_are_too_few() -> None:
    few = cut(np.array([1000, 2000], dtype=np.int64))
    assert compare([few], [few]).answer == Change.UNDECIDED
    assert compare([few], [cut(process(5000, np.random.default_rng(1)))]).shifts == ()
    with pytest.raises(ValueError, match="no measurement"):
        compare([few], [])


def test_the_same_sets_give_the_same_answer() -> None:
    rng = np.random.default_rng(7)
    a, b = cut(process(5000, rng)), cut(process(5000, rng))
    assert compare([a], [b]) == compare([a], [b])


@pytest.mark.parametrize("n", [1, 5, 64, 1000])
def test_blocks_lose_nothing(n: int) -> None:
    values = process(n, np.random.default_rng(8))
    found = cut(values)
    assert found.n == n and found.sums_ns.sum() == pytest.approx(values.sum())
    parts = split_randomly(from_samples(values))
    assert parts.n == n and not parts.ordered
    assert add_outputs([found, found]).n == 2 * n


def test_wide_values_are_put_into_fewer_columns() -> None:
    values = np.random.default_rng(9).integers(0, 10**12, 50_000)
    assert cut(values).values_ns.size <= 4096 and cut(values).n == 50_000


def test_the_ratio_of_misses_is_exact() -> None:
    def verdict(n: int, k: int):
        values = np.full(n, 100)
        values[np.linspace(0, n - 1, k).astype(int)] = 1000
        return judge([count_misses(values, 500)], deadline_ns=500, probability=0.5, confidence=0.95)

    same = ratio_of_misses(verdict(10_000, 20), verdict(10_000, 20))
    assert same.value == 1.0 and same.low < 1 < same.high
    more = ratio_of_misses(verdict(10_000, 10), verdict(10_000, 100))
    assert more.value == pytest.approx(10) and more.low > 4
    none = ratio_of_misses(verdict(1000, 0), verdict(1000, 0))
    assert (none.value, none.low, none.high) == (None, 0.0, math.inf)
    new = ratio_of_misses(verdict(1000, 0), verdict(1000, 8))
    assert new.value == math.inf and new.low > 1


def test_what_a_layer_adds_is_found_through_a_drift() -> None:
    rng = np.random.default_rng(10)
    inside = 0
    for _ in range(60):
        drift = np.cumsum(rng.normal(size=5)) * 10_000
        lower = [cut(process(2000, rng, 20_000 + d)) for d in drift]
        upper = [cut(process(2000, rng, 55_000 + d)) for d in drift]
        mean, p99 = attribute(lower, upper)
        assert (mean.figure, p99.figure) == ("mean", "p99") and "5 interleaved pairs" in mean.method
        inside += mean.low_ns <= 35_000 <= mean.high_ns
    assert inside >= 53
    assert mean.high_ns - mean.low_ns < 8000  # the drift of tens of us is not in it


def test_runs_not_interleaved_are_compared_by_blocks() -> None:
    rng = np.random.default_rng(11)
    (mean, _) = attribute([cut(process(5000, rng))], [cut(process(5000, rng, 90_000)), cut(process(5000, rng, 90_000))])
    assert mean.added_ns == pytest.approx(30_000, abs=2500) and "not interleaved" in mean.method
