"""How many measurements an answer takes, and from how many boots it must come."""

from dataclasses import replace

import numpy as np
import pytest

from rtrun.analysis.account import Account
from rtrun.analysis.chance.further import plan_measurements
from rtrun.analysis.chance.intervals import anytime_interval
from rtrun.analysis.deadline import Answer, judge
from rtrun.analysis.trials import count_misses
from rtrun.plan.question import THESIS


def test_without_a_miss_it_is_the_plain_interval():
    assert plan_measurements(replace(THESIS, probability=1e-6, bursts=1)) == (True, 3_688_878)


@pytest.mark.parametrize(("rate", "is_proven"), [(2e-4, True), (5e-4, True), (3e-3, False)])
def test_the_number_is_enough_nine_times_in_ten(rate, is_proven):
    planned = plan_measurements(replace(THESIS, probability=1e-3, bursts=1), rate=rate)
    assert planned is not None and planned[0] is is_proven
    misses = np.random.default_rng(3).poisson(rate * planned[1], 2000)
    decided = 0
    for count in misses:
        lower, upper = anytime_interval(int(count), planned[1], 0.95)
        decided += upper < 1e-3 if is_proven else lower > 1e-3
    assert 0.87 <= decided / 2000 <= 0.99


def test_a_rate_at_the_target_is_never_decided():
    assert plan_measurements(replace(THESIS, probability=1e-3, bursts=1), rate=1e-3) is None


@pytest.mark.parametrize("late", [False, True])
def test_an_answer_waits_for_its_boots(late):
    values = np.full(4000, 500_000 if late else 0, np.int64) + np.arange(4000) % 7
    trials = count_misses(values, 400_000)

    def answer(boots, wanted):
        runs = [replace(trials, run=f"r{n}", boot=f"b{n}", start_time=str(n)) for n in range(boots)]
        verdict = judge(Account(runs), replace(THESIS, probability=1e-3, boots=wanted, bursts=1))
        return verdict.answer, verdict.boots_missing

    certain = Answer.REFUTED if late else Answer.PROVEN
    assert answer(3, 1) == (certain, 0) and answer(3, 3) == (certain, 0)
    assert answer(3, 4) == (Answer.NEEDS_MORE, 1)
