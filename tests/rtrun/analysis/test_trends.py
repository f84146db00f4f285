"""Runs and boots that get worse one after the other are seen by their own level, and what they could show is stated."""

from dataclasses import replace

import numpy as np
import pytest

from rtrun.analysis.account import Account
from rtrun.analysis.deadline import Answer, Verdict, judge
from rtrun.analysis.histogram import from_samples
from rtrun.analysis.order.constancy import examine_constancy, join_boots
from rtrun.analysis.order.trends import find_climb, levels_ns
from rtrun.analysis.trials import Trials, count_misses, count_misses_in_histogram
from rtrun.plan.question import Question, read_tolerance

DEADLINE = 400_000


def run_of(values: np.ndarray, run: int, boot: int, *, in_order: bool = True) -> Trials:
    samples = values.astype(np.int64)
    trials = count_misses(samples, DEADLINE)
    if not in_order:
        trials = count_misses_in_histogram(from_samples(samples), DEADLINE)
    return replace(trials, run=str(run), boot=str(boot), start_time=f"{run:04}")


def around(rng: np.random.Generator, middle_us: np.ndarray | float, n: int) -> np.ndarray:
    return 1000 * (middle_us + rng.normal(size=n))


def answer(runs: list[Trials]) -> Verdict:
    return judge(Account(runs), Question(deadline_ns=DEADLINE, probability=1e-3, bursts=1))


def is_seen(runs: list[Trials]) -> bool:
    constancy = examine_constancy(join_boots(runs), probability=1e-3, confidence=0.95, deadline_ns=DEADLINE)
    return constancy.change is not None


def climbing(step_us: float, boots: int = 10, *, n: int = 5000, in_order: bool = True) -> list[Trials]:
    rng = np.random.default_rng(1)
    return [run_of(around(rng, 390 - step_us * (boots - 1 - k), n), k, k, in_order=in_order) for k in range(boots)]


@pytest.mark.parametrize("step_us", [2, 25, 40])
def test_boots_that_climb_prove_nothing(step_us: float) -> None:
    verdict = answer(climbing(step_us))
    assert verdict.answer is Answer.NEEDS_MORE
    assert verdict.change is not None and verdict.change.text == "high values are higher in later boots"
    assert verdict.climbs[0].reached_after == pytest.approx((400 - 394) / step_us, abs=1.5)


@pytest.mark.parametrize("n", [80, 5000])
def test_histograms_of_boots_that_climb_prove_nothing(n: int) -> None:
    """They keep no order within a run; the order of the runs is known."""
    verdict = answer(climbing(25, n=n, in_order=False))
    assert verdict.answer is Answer.NEEDS_MORE
    assert verdict.change is not None and verdict.change.text == "high values are higher in later boots"
    assert answer(climbing(0, n=5000, in_order=False)).answer is Answer.IF_INDEPENDENT


def test_a_climb_far_below_the_deadline_takes_no_answer_away() -> None:
    rng = np.random.default_rng(1)
    verdict = answer([run_of(around(rng, 10 + 10 * k, 5000), k, k) for k in range(10)])
    assert verdict.answer is Answer.PROVEN
    assert verdict.climbs[0].reached_after == pytest.approx(30, abs=1), "it is told all the same"


def test_a_leak_within_each_run_proves_nothing() -> None:
    rng = np.random.default_rng(1)
    for boots, per_boot in ((1, 30), (6, 5)):
        runs = [run_of(around(rng, np.linspace(100, 380, 2000), 2000), k, k % boots) for k in range(boots * per_boot)]
        verdict = answer(runs)
        assert verdict.answer is Answer.NEEDS_MORE
        assert verdict.change is not None and "pieces of each run, cut into 64" in verdict.change.text


def test_units_of_any_length_are_compared_at_one_share() -> None:
    rng = np.random.default_rng(2)
    units = [[run_of(rng.exponential(20_000, n), k, k)] for k, n in enumerate((2000, 8000, 4000, 3000, 2500))]
    (levels,) = levels_ns([units])
    assert levels.size == 5 and np.ptp(levels) < 40_000
    # A hundred times as long: what it reaches as often lies below all that is kept of it, and it is left out.
    units.append([run_of(rng.exponential(20_000, 400_000), 5, 5)])
    assert levels_ns([units])[0].size == 5


def test_a_climb_as_small_as_is_stated_is_seen() -> None:
    rng = np.random.default_rng(4)

    def boots(slope_us: float) -> list[Trials]:
        return [run_of(around(rng, 300 + 5 * rng.normal() + slope_us * k, 2000), k, k) for k in range(10)]

    even = find_climb("boot", [[[run] for run in boots(0)]], DEADLINE)
    assert even is not None and even.smallest_ns is not None
    assert is_seen(boots(even.smallest_ns / 1000)) and not is_seen(boots(even.smallest_ns / 3000))


def test_bursts_of_a_boot_are_no_boot_that_is_too_bad() -> None:
    """Windows that overlap hold the same misses: a hundred of them are late for the misses of one."""
    rng = np.random.default_rng(6)
    tolerance = read_tolerance("3 of 100")
    question = Question(deadline_ns=DEADLINE, probability=0.02, bursts=1, tolerance=tolerance)
    for _ in range(5):
        values = [np.where(rng.random(20_000) < 0.0102, 500_000, 100_000) for _ in range(4)]
        runs = [
            replace(count_misses(values_ns, DEADLINE, tolerance=tolerance), run=str(k), boot=str(k), start_time=str(k))
            for k, values_ns in enumerate(values)
        ]
        change = judge(Account(runs), question).change
        assert change is None or "on its own" not in change.text


def test_few_boots_show_no_climb() -> None:
    climb = find_climb("boot", [[[run] for run in climbing(25, 4)]], DEADLINE)
    assert climb is not None and climb.units == 4 and climb.smallest_ns is None
    assert find_climb("boot", [[[run] for run in climbing(25, 1)]], DEADLINE) is None


def test_a_system_that_got_better_is_not_refuted_by_what_it_was() -> None:
    rng = np.random.default_rng(5)

    def boots(rates: list[float]) -> list[Trials]:
        values = [np.where(rng.random(5000) < rate, 500, 100) * 1000 for rate in rates]
        return [run_of(values_ns, k, k) for k, values_ns in enumerate(values)]

    better = answer(boots([0.01] * 6 + [0.0] * 6))
    assert better.answer is Answer.NEEDS_MORE and better.change is not None
    worse = answer(boots([0.0] * 6 + [0.01] * 6))
    assert worse.answer is Answer.REFUTED and worse.change is not None
