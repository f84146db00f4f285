"""Comparisons: level and power on dependent data, and the difference between none and none seen."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import ks_2samp

from rtrun.analysis.account import Account
from rtrun.analysis.comparison.differences import ComparisonAnswer, compare, correct, ratio_of_misses
from rtrun.analysis.comparison.layers import LATE, attribute
from rtrun.analysis.deadline import judge
from rtrun.analysis.dependence.blocks import Blocks, add_outputs, cut, split_randomly
from rtrun.analysis.dependence.interleaving import is_interleaved
from rtrun.analysis.histogram import from_samples
from rtrun.analysis.trials import count_misses
from rtrun.plan.question import Question


def process(n: int, rng: np.random.Generator, mean_ns: float = 60_000, memory: float = 0.95) -> np.ndarray:
    noise = rng.normal(size=n + 500) * math.sqrt(1 - memory**2)
    return (mean_ns + 8000 * lfilter([1], [1, -memory], noise)[500:]).astype(np.int64)


def test_alike_is_not_called_different_where_a_test_for_independent_data_does_it() -> None:
    """What the blocks are for: single measurements resampled make differences of chance."""
    rng = np.random.default_rng(3)
    for _ in range(2):
        a, b = process(20_000, rng), process(20_000, rng)
        assert ks_2samp(a, b).pvalue < 0.05
        assert compare([cut(a)], [cut(b)]).answer in (ComparisonAnswer.SAME, ComparisonAnswer.NOT_SEEN)


def test_a_shift_is_seen_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(3)
    shifted = compare([cut(process(20_000, rng))], [cut(process(20_000, rng, 63_000))])
    assert shifted.answer == ComparisonAnswer.RUNS_DIFFER
    assert 1000 < shifted.shifts[0].low_ns <= 3000 <= shifted.shifts[0].high_ns < 5000


def test_none_seen_is_not_none() -> None:
    rng = np.random.default_rng(14)
    small = compare([cut(process(3000, rng))], [cut(process(3000, rng))], margin_ns=500)
    assert small.answer == ComparisonAnswer.NOT_SEEN and not small.shifts[0].within_margin
    large = compare([cut(process(200_000, rng))], [cut(process(200_000, rng))], margin_ns=20_000)
    assert large.answer == ComparisonAnswer.SAME and all(shift.within_margin for shift in large.shifts)


def boots(rng: np.random.Generator, number: int = 6, mean_ns: float = 60_000) -> list[Blocks]:
    """Runs of a boot each, which differ by 1.5 us (standard deviation)."""
    return [cut(process(4000, rng, mean_ns + 1500 * rng.normal())) for _ in range(number)]


def test_five_runs_a_side_put_the_difference_between_boots_into_the_interval() -> None:
    rng = np.random.default_rng(5)
    alike = compare(in_turn(boots(rng), 0), in_turn(boots(rng), 1))
    assert alike.units == "runs" and alike.unit_counts == (6, 6) and alike.interleaved
    assert alike.answer == ComparisonAnswer.NOT_SEEN
    apart = compare(in_turn(boots(rng), 0), in_turn(boots(rng, mean_ns=90_000), 1))
    assert apart.answer == ComparisonAnswer.DIFFERENT


@pytest.mark.parametrize("number", [1, 2, 4])
def test_few_runs_may_differ_but_not_what_they_are_of(number: int) -> None:
    rng = np.random.default_rng(5)
    apart = compare(in_turn(boots(rng, number), 0), in_turn(boots(rng, number, 90_000), 1))
    assert apart.answer == ComparisonAnswer.RUNS_DIFFER
    alike = compare(boots(rng, number), boots(rng, number))
    assert alike.units == "blocks" and "runs alike" in alike.assumes[0]


def test_sets_measured_one_after_the_other_are_never_different() -> None:
    rng = np.random.default_rng(6)
    comparison = compare(in_turn(boots(rng), 0, 1), in_turn(boots(rng, mean_ns=90_000), 6, 1))
    assert comparison.answer == ComparisonAnswer.RUNS_DIFFER and not comparison.interleaved


def test_sets_without_a_common_boot_have_boots_as_units() -> None:
    rng = np.random.default_rng(7)
    a, b = in_turn(boots(rng), 0, boot="a"), in_turn(boots(rng, mean_ns=90_000), 1, boot="b")
    comparison = compare(a, b)
    assert comparison.answer == ComparisonAnswer.RUNS_DIFFER and "boots alike: with 1 and 1" in comparison.assumes[0]
    a, b = ([replace(run, boot=f"{side}{k}") for k, run in enumerate(runs)] for side, runs in (("a", a), ("b", b)))
    assert compare(a, b).units == "boots" and compare(a, b).answer == ComparisonAnswer.DIFFERENT


def test_the_interval_of_a_quantile_holds_a_shift_below_a_microsecond() -> None:
    rng = np.random.default_rng(8)
    a, b = (cut((100_000 + shift + rng.normal(0, 4000, 40_000)).astype(np.int64)) for shift in (0, 700))
    shifts = {shift.figure: shift for shift in compare([a], [b]).shifts}
    assert all(0 < shifts[p].low_ns <= 700 <= shifts[p].high_ns < 1400 for p in ("p50", "p90", "p99"))


def test_a_coarse_clock_gives_no_interval_without_width() -> None:
    rng = np.random.default_rng(9)
    a, b = (cut(rng.normal(300_000, 40_000, 20_000).astype(np.int64) // 30_518 * 30_518) for _ in range(2))
    median = compare([a], [b], clock_step_ns=30_518).shifts[1]
    assert median.low_ns < 0 < median.high_ns and median.high_ns - median.low_ns > 100


def test_a_heavier_tail_is_seen_where_it_is() -> None:
    rng = np.random.default_rng(6)
    a, b = process(100_000, rng, memory=0.1), process(100_000, rng, memory=0.1)
    b = np.where(rng.random(b.size) < 0.005, b + 200_000, b)
    shifts = {shift.figure: shift for shift in compare([cut(a)], [cut(b)]).shifts}
    assert shifts["p99.9"].low_ns > 100_000 and shifts["p50"].within_margin


def test_a_few_values_are_too_few() -> None:
    few = cut(np.array([1000, 2000], dtype=np.int64))
    assert compare([few], [few]).answer == ComparisonAnswer.UNDECIDED
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
    blocks = cut(values)
    assert blocks.n == n and blocks.sums_ns.sum() == pytest.approx(values.sum())
    parts = split_randomly(from_samples(values))
    assert parts.n == n and not parts.ordered
    assert add_outputs([blocks, blocks]).n == 2 * n


def test_wide_values_are_put_into_fewer_columns() -> None:
    values = np.random.default_rng(9).integers(0, 10**12, 50_000)
    assert cut(values).values_ns.size <= 4096 and cut(values).n == 50_000


def test_the_ratio_of_misses_is_exact() -> None:
    def verdict(n: int, k: int):
        values = np.full(n, 100)
        values[np.linspace(0, n - 1, k).astype(int)] = 1000
        return judge(Account([count_misses(values, 500)]), Question(deadline_ns=500, probability=0.5))

    same = ratio_of_misses(verdict(10_000, 20), verdict(10_000, 20))
    assert same.value == 1.0 and same.low < 1 < same.high
    more = ratio_of_misses(verdict(10_000, 10), verdict(10_000, 100))
    assert more.value == pytest.approx(10) and more.low > 4
    none = ratio_of_misses(verdict(1000, 0), verdict(1000, 0))
    assert (none.value, none.low, none.high) == (None, 0.0, math.inf)
    new = ratio_of_misses(verdict(1000, 0), verdict(1000, 8))
    assert new.value == math.inf and new.low > 1


def in_turn(runs: list[Blocks], first: int, step: int = 2, boot: str = "b") -> list[Blocks]:
    """The runs with start times `step` apart, from `first` on."""
    return [
        replace(run, start_time=f"2026-01-01T00:{first + step * k:02d}:00", boot=boot) for k, run in enumerate(runs)
    ]


@pytest.mark.parametrize("order", ["LULULULULU", "LUULLUULLUUL", "LLUULULULU", "LUULULU"])
def test_what_a_layer_adds_is_found_through_a_steady_drift(order: str) -> None:
    """A drift of 10 us from run to run, in the alternating, the balanced, a drawn and an uneven order."""
    rng = np.random.default_rng(11)
    runs = {"L": [], "U": []}
    for place, layer in enumerate(order):
        center_ns = 10_000 * place + (20_000 if layer == "L" else 55_000)
        runs[layer].append(in_turn([cut(process(2000, rng, center_ns))], place)[0])
    mean, *others = attribute(runs["L"], runs["U"], late_above_ns=10**9).added
    assert mean.low <= 35_000 <= mean.high
    # Of 2000 values nobody knows the 9999th of 10 000.
    assert [part.figure for part in (mean, *others)] == ["mean", "median", "p99", LATE]
    assert (others[2].added, others[2].low, others[2].high) == (0, 0, 0)
    assert f"{order.count('L')} and {order.count('U')} runs" in mean.method
    assert mean.high - mean.low < 8000  # the drift of tens of us is not in it


def test_layers_that_were_not_measured_in_turn_are_refused() -> None:
    rng = np.random.default_rng(11)
    lower, upper = ([cut(process(2000, rng)) for _ in range(3)] for _ in range(2))
    for a, b in ((in_turn(lower, 0, 1), in_turn(upper, 3, 1)), (lower, upper)):
        layers = attribute(a, b)
        assert layers.added == () and layers.refused is not None and "in turn" in layers.refused
    few = attribute(in_turn(lower[:2], 0), in_turn(upper[:2], 1))
    assert few.refused is not None and "at least 3" in few.refused


@pytest.mark.parametrize(
    ("a", "b", "answer"),
    [
        ("02468", "13579", True),
        ("01234", "56789", False),
        ("03478", "12569", True),
        ("012", "345", False),
        ("0", "1", False),
        ("012345789B", "6ACDEFGHIJ", False),
    ],
)
def test_measured_in_turn(a: str, b: str, answer: bool) -> None:
    starts = [[f"2026-01-01T00:{int(place, 36):02}:00+00:00" for place in side] for side in (a, b)]
    assert is_interleaved(*starts) is answer
    assert is_interleaved(*reversed(starts)) is answer
    assert not is_interleaved(starts[0], ["unknown"] * len(b))


def test_of_twelve_groups_without_a_difference_none_differs():
    """A twentieth of twelve is one in two: without the correction half of all such campaigns would see a difference."""
    rng = np.random.default_rng(10)
    comparisons = []
    for _ in range(12):
        sets = [[], []]
        for number in range(10):
            values = (38_000 + rng.normal(0, 300) + 7_000 * rng.gamma(3, size=256)).astype(np.int64)
            sets[number % 2].append(replace(cut(values), start_time=f"2026-01-01T00:00:{number:02d}", boot=""))
        comparisons.append(compare(*sets, tests=12))
    assert ComparisonAnswer.DIFFERENT in [comparison.answer for comparison in comparisons]
    assert ComparisonAnswer.DIFFERENT not in [comparison.answer for comparison in correct(comparisons)]
