"""Deadline verdicts: the answers, what they rest on, and what is refused; their error rates are in tests/coverage/."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import rank_filter

from rtrun.analysis.account import Account
from rtrun.analysis.chance.further import plan_measurements
from rtrun.analysis.chance.intervals import anytime_interval
from rtrun.analysis.deadline import Answer, Verdict, judge
from rtrun.analysis.histogram import Histogram, from_samples
from rtrun.analysis.trials import Trials, count_misses, count_misses_in_histogram
from rtrun.plan.question import THESIS, Question, Tolerance

DEADLINE = 400_000


def verdict(*runs: Trials, probability: float = 1e-3, bursts: int | None = 1, **measured: Any) -> Verdict:
    question = Question(deadline_ns=DEADLINE, probability=probability, bursts=bursts)
    return judge(Account(runs, **measured), question)


def with_misses(n: int, *positions: int) -> np.ndarray:
    values = np.random.default_rng(n).integers(50_000, 90_000, n)
    values[list(positions)] = 500_000
    return values


def test_no_trial_tells_nothing() -> None:
    assert anytime_interval(0, 0, 0.95) == (0.0, 1.0)
    assert verdict().answer == Answer.NEEDS_MORE


def test_three_answers() -> None:
    assert verdict(count_misses(with_misses(5000), DEADLINE)).answer == Answer.PROVEN
    assert verdict(count_misses(with_misses(3000), DEADLINE)).answer == Answer.NEEDS_MORE
    spread = with_misses(5000, *range(0, 5000, 250))
    assert verdict(count_misses(spread, DEADLINE)).answer == Answer.REFUTED


def test_the_number_still_needed_is_exact() -> None:
    judged = verdict(count_misses(with_misses(1000), DEADLINE), period_ns=1e6)
    assert judged.further is not None
    enough = 1000 + judged.further
    assert anytime_interval(0, enough, 0.95)[1] < 1e-3 <= anytime_interval(0, enough - 1, 0.95)[1]
    assert judged.hours(judged.further) == pytest.approx(judged.further / 3.6e6)


def test_a_rate_that_goes_on_decides_one_way_or_the_other() -> None:
    often = verdict(count_misses(with_misses(1000, *range(17, 1000, 250)), DEADLINE))
    assert often.answer == Answer.NEEDS_MORE
    assert often.further_likely is not None and often.further_likely[0] == Answer.REFUTED
    seldom = verdict(count_misses(with_misses(5000, 2017), DEADLINE))
    assert seldom.further_likely is not None and seldom.further_likely[0] == Answer.PROVEN
    assert seldom.further is not None and seldom.further < seldom.further_likely[1]


def test_late_is_above_the_deadline_not_on_it() -> None:
    assert count_misses(np.array([DEADLINE, DEADLINE + 1]), DEADLINE).late == 1


def test_what_never_came_met_no_deadline() -> None:
    trials = count_misses(with_misses(8, 2), DEADLINE, absent=np.array([0, 5]))
    assert (trials.n, trials.late, trials.absent) == (10, 1, 2)
    assert trials.misses is not None and trials.misses.count == 3
    # The third sample to come is loop 3: misses at 0, 3 and 5, each in a pair of its own, two in the first four.
    assert trials.misses.blocks[0] == (5, 3, 3)
    assert trials.misses.blocks[1] == (2, 3, 5)


def test_emulated_numbers_are_no_statement() -> None:
    judged = verdict(count_misses(with_misses(9000), DEADLINE), emulated=True)
    assert judged.answer == Answer.NO_STATEMENT and judged.refused == "measured on an emulated board"


def test_a_deadline_finer_than_the_clock_is_refused() -> None:
    assert verdict(count_misses(with_misses(9000), DEADLINE), clock_step_ns=250_000).answer == Answer.NO_STATEMENT
    assert verdict(count_misses(with_misses(9000), DEADLINE), clock_step_ns=30_518).answer == Answer.PROVEN


def test_a_histogram_says_what_it_assumes() -> None:
    judged = verdict(count_misses_in_histogram(from_samples(with_misses(5000)), DEADLINE))
    assert judged.answer == Answer.IF_INDEPENDENT and "independent" in judged.assumes[0]


def test_subscribers_of_one_message_count_once() -> None:
    runs = [count_misses(with_misses(1000 + k), DEADLINE) for k in range(5)]
    assert verdict(*runs).answer == Answer.PROVEN
    assert verdict(*runs, side_by_side=5).answer == Answer.NEEDS_MORE


@pytest.mark.parametrize("wrong", [0.0, 1.0, -1.0, float("nan")])
def test_a_probability_lies_between_0_and_1(wrong: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        verdict(probability=wrong)


def of_boot(n: int, misses: int, boot: str, run: str = "") -> Trials:
    # No two runs miss at the same places.
    places = np.random.default_rng(misses).permutation(n)[:misses]
    return replace(count_misses(with_misses(n, *places), DEADLINE), boot=boot, run=run or boot)


def test_two_boots_that_differ_are_worth_little() -> None:
    one_boot = verdict(of_boot(50_000, 10, "a", "1"), of_boot(50_000, 14, "a", "2"))
    assert one_boot.answer == Answer.PROVEN and one_boot.boots == 1
    two_boots = verdict(of_boot(50_000, 10, "a"), of_boot(50_000, 30, "b"))
    assert two_boots.answer == Answer.NEEDS_MORE and two_boots.boots == 2
    assert two_boots.n_effective / two_boots.n == pytest.approx(40 / (1 + 40 / 2) / 40, rel=0.01)


def test_a_second_miss_in_the_other_boot_does_not_help() -> None:
    upper = [verdict(of_boot(9000, a, "a"), of_boot(9000, b, "b")).upper for a, b in ((0, 0), (0, 1), (1, 1), (0, 2))]
    assert upper[0] < upper[1] < upper[3] and upper[1] < 1.1 * upper[2]


@pytest.mark.parametrize(("boots", "enough"), [(1, 3690), (2, 6000), (3, 4400), (9, 4401), (10, 3690)])
def test_few_boots_take_more_without_a_miss(boots: int, enough: int) -> None:
    """Few that are alike by chance hide that boots differ. The number that is planned is the number that is enough."""

    def measured(n: int) -> Verdict:
        # The highest values at even distances: they form no bursts.
        values = 50_000 + np.arange(math.ceil(n / boots)) % 7
        return verdict(*(replace(count_misses(values, DEADLINE), boot=str(boot)) for boot in range(boots)))

    proven, short = measured(enough), measured(math.floor(0.98 * enough))
    assert (proven.answer, short.answer) == (Answer.PROVEN, Answer.NEEDS_MORE)
    planned = plan_measurements(replace(THESIS, probability=1e-3, bursts=1, boots=boots))
    assert planned == (True, short.n + short.further) and short.n < planned[1] <= proven.n


@pytest.mark.parametrize("lengths", [(9000, 3300), (60_000, 1000), (400, 40_000)])
def test_runs_of_unlike_lengths_are_no_bursts(lengths: tuple[int, ...]) -> None:
    """The highest values of a run are another share of a short one than of a long one: that is no dependence."""
    rng = np.random.default_rng(5)
    runs = [count_misses(rng.integers(50_000, 90_000, n), DEADLINE) for n in lengths]
    assert verdict(*(replace(run, boot=str(n)) for run, n in zip(runs, lengths, strict=True))).design_effect < 1.5


def test_runs_of_one_boot_that_differ_are_clusters() -> None:
    alike = verdict(*(of_boot(1000, 5, "a", str(k)) for k in range(8)))
    assert alike.design_effect == 1
    apart = verdict(*(of_boot(1000, 40 * (k == 3), "a", str(k)) for k in range(8)))
    assert apart.design_effect > 30


def test_two_misses_one_after_the_other_are_a_burst() -> None:
    apart, adjacent = (verdict(count_misses(with_misses(100_000, 500, at), DEADLINE)) for at in (60_000, 501))
    assert apart.design_effect == 1 and adjacent.design_effect == 2
    assert adjacent.upper > 1.4 * apart.upper and adjacent.change is None
    three = verdict(count_misses(with_misses(100_000, 500, 501, 502), DEADLINE), probability=1e-6)
    assert three.further is not None and three.further < 25_000_000


def test_the_longest_burst_that_a_proof_holds_for() -> None:
    judged = verdict(count_misses(with_misses(10_000), DEADLINE))
    assert judged.longest_burst == pytest.approx(10_000 * 1e-3 / 3.689, rel=1e-3)
    lengths = dict(judged.further_for_bursts)
    assert set(lengths) == {20, 50}
    assert lengths[20] + 10_000 == pytest.approx(20 * 3689, rel=1e-3)
    longer = verdict(count_misses(with_misses(10_000 + lengths[20]), DEADLINE))
    assert longer.longest_burst >= 20 and set(dict(longer.further_for_bursts)) == {50}


def test_misses_that_gather_at_the_end_prove_nothing() -> None:
    judged = verdict(count_misses(with_misses(50_000, 48_000, 48_700, 49_300, 49_999), DEADLINE))
    assert judged.upper < 1e-3 and judged.answer == Answer.NEEDS_MORE
    assert judged.change is not None and "all 4 misses lie in the last 4 %" in judged.change.text


def test_values_that_rise_prove_nothing() -> None:
    values = with_misses(50_000) + np.linspace(0, 140_000, 50_000).astype(np.int64)
    judged = verdict(count_misses(values, DEADLINE))
    assert judged.answer == Answer.NEEDS_MORE and judged.change is not None and "highest values" in judged.change.text


@pytest.mark.parametrize(("value_ns", "late"), [(DEADLINE - 1, 0), (DEADLINE, 0), (DEADLINE + 1, 1)])
def test_a_value_that_equals_the_deadline_meets_it(value_ns: int, late: int) -> None:
    values = np.array([value_ns, 50_000], dtype=np.int64)
    assert count_misses(values, DEADLINE).late == late
    assert count_misses_in_histogram(from_samples(values, 1), DEADLINE).late == late


@pytest.mark.parametrize(
    ("value_ns", "late", "unclear"), [(399_999, 0, 0), (400_000, 1, 1), (400_999, 1, 1), (401_000, 1, 0)]
)
def test_what_is_in_the_bin_of_the_deadline_is_late_and_said_to_be(value_ns: int, late: int, unclear: int) -> None:
    trials = count_misses_in_histogram(from_samples(np.array([value_ns, 50_000], dtype=np.int64)), 400_000)
    assert (trials.late, trials.unclear) == (late, unclear)
    assumption = "1 values within a step of the clock, or a bin of a log, of the deadline are late"
    assert (assumption in verdict(trials).assumes) is bool(unclear)


@pytest.mark.parametrize(("step_ns", "late"), [(1, 0), (1000, 1), (30_518, 2)])
def test_what_a_coarse_clock_shows_as_in_time_may_be_late(step_ns: int, late: int) -> None:
    values = np.array([50_000, 370_000, 399_500, 400_000 - 30_518], dtype=np.int64)
    trials = count_misses(values, DEADLINE, step_ns=step_ns)
    assert (trials.late, trials.unclear) == (late, late)


def test_what_may_have_met_the_deadline_refutes_nothing() -> None:
    values = np.full(5000, 400_500, dtype=np.int64)
    assert verdict(count_misses_in_histogram(from_samples(values), 400_000)).answer == Answer.NEEDS_MORE
    assert verdict(count_misses_in_histogram(from_samples(values), 399_999)).answer == Answer.REFUTED


def test_a_deadline_that_ends_its_bin_leaves_no_doubt() -> None:
    trials = count_misses_in_histogram(from_samples(np.array([400_000], dtype=np.int64)), 400_999)
    assert (trials.late, trials.unclear) == (0, 0)


def test_a_largest_value_that_was_printed_in_whole_bins_may_be_above_the_deadline() -> None:
    bins = {"values_ns": np.array([1000]), "counts": np.array([9]), "overflow": 1, "overflow_from_ns": 400_000}
    assert Histogram(**bins, max_ns=400_000).above(400_000) == 1
    assert Histogram(**bins, max_ns=400_000).above(400_999) == 0


@pytest.mark.parametrize("tolerance", [(1, 2), (0, 7), (3, 100), (40, 90)])
@pytest.mark.parametrize("deadline_ns", [20_000, 90_000, 2_000_000])
@pytest.mark.parametrize("step_ns", [1, 10_000])
def test_windows_are_decided_by_an_order_statistic(tolerance, deadline_ns, step_ns):
    rng = np.random.default_rng(deadline_ns)
    values = (50_000 * rng.lognormal(0, 1, 20_000)).astype(np.int64) // step_ns * step_ns
    values[rng.integers(0, values.size, 60)] = 10**15  # as if it never came
    misses, among = tolerance
    decides = rank_filter(values, rank=-misses - 1, size=among)[among // 2 :][: values.size - among + 1]
    expected = count_misses(decides, deadline_ns)
    absent = np.flatnonzero(values == 10**15)
    windows = count_misses(values, deadline_ns, tolerance=Tolerance(misses=misses, among=among))
    without = count_misses(values[values < 10**15], deadline_ns, absent, Tolerance(misses=misses, among=among))
    for field in ("n", "late", "misses", "level", "high_at", "high_ns"):
        assert np.array_equal(getattr(windows, field), getattr(expected, field)), field
    assert (without.n, without.late + without.absent) == (expected.n, expected.late)
    assert without.absent == np.count_nonzero(decides == 10**15)


def clean_runs(number: int, boot: str = "boot") -> list[Trials]:
    return [
        replace(count_misses(with_misses(500), DEADLINE), run=f"{k}", boot=boot or f"{k}", start_time=f"{k:04}")
        for k in range(number)
    ]


@pytest.mark.parametrize(("boot", "unit"), [("boot", "run"), ("", "boot")])
def test_as_many_clean_units_as_it_says_outweigh_one_that_was_lost(boot: str, unit: str) -> None:
    first = verdict(*clean_runs(20, boot), probability=0.1, lost=("x: it hung",))
    assert (first.answer, first.unit) == (Answer.NEEDS_MORE, unit) and first.further is None
    assert first.units_missing and first.upper > 0.1
    enough = 20 + first.units_missing
    assert verdict(*clean_runs(enough, boot), probability=0.1, lost=("x: it hung",)).answer == Answer.PROVEN
    few = verdict(*clean_runs(enough // 3, boot), probability=0.1, lost=("x: it hung",))
    assert few.answer == Answer.NEEDS_MORE


def test_an_attempt_that_was_lost_takes_no_refutation_away() -> None:
    spread = count_misses(with_misses(5000, *range(0, 5000, 250)), DEADLINE)
    assert verdict(spread, lost=("x: it hung",)).answer == Answer.REFUTED


def test_time_that_load_hid_is_late_for_a_proof_and_in_time_for_a_refutation() -> None:
    good, bad = (count_misses(with_misses(5000, *range(0, late, 250)), DEADLINE) for late in (0, 5000))
    hidden = {"unseen_share": 0.002, "hidden_share": 0.002}
    assert verdict(good, **hidden).answer == Answer.NEEDS_MORE
    assert verdict(good, probability=1e-2, **hidden).answer == Answer.PROVEN
    assert verdict(good, unseen_share=0.5).answer == Answer.PROVEN, "and it says of how much of the time"
    assert verdict(bad, unseen_share=0.1).answer == Answer.REFUTED
    assert verdict(bad, unseen_share=0.9).answer == Answer.NEEDS_MORE


def test_boots_that_nobody_knows_are_one() -> None:
    question = Question(deadline_ns=DEADLINE, probability=1e-3, boots=5, bursts=1)
    unknown = [replace(run, boot="") for run in clean_runs(20)]
    judged = judge(Account(unknown), question)
    assert (judged.answer, judged.boots, judged.boots_missing) == (Answer.NEEDS_MORE, None, 4)
    known = [replace(run, boot=f"{number % 4}") for number, run in enumerate(clean_runs(20))]
    assert judge(Account([*known, *unknown]), question).boots_missing == 1
    assert (
        judge(Account([replace(run, boot=f"{n % 5}") for n, run in enumerate(known)]), question).answer == Answer.PROVEN
    )
