"""The rounds of a campaign that measures until it is certain."""

import pytest

from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.rounds import boot_of_round, outlook, plan_round, rounds_for, rounds_of_boot

CAMPAIGN = {
    "schema": 1,
    "name": "test",
    "order": "interleaved",
    "seed": 7,
    "runs": [{"suite": "cyclic_timer_tests", "repetitions": 1002, "frequency_hz": [100, 200, 300, 400]}],
}
GROUPS = plan(Campaign(**CAMPAIGN), "test")
NAMES = [group.name for group in GROUPS]


def test_a_round_has_each_open_group_once_in_an_order_of_its_own():
    rounds = [plan_round(GROUPS, number, 7) for number in range(1, 9)]
    assert rounds[0] == GROUPS, "the first round is the campaign as it is planned without a goal"
    for number, runs in enumerate(rounds, start=1):
        assert {run.parameters["frequency_hz"] for run in runs} == {100, 200, 300, 400}
        assert {run.repeat for run in runs} == {number}
    orders = [tuple(run.parameters["frequency_hz"] for run in runs) for runs in rounds]
    assert len(set(orders)) > 4, "the order is drawn"
    assert orders[1::2] == [order[::-1] for order in orders[::2]], "L U U L: a drift moves all groups alike"
    names = [run.name for runs in rounds for run in runs]
    assert len(set(names)) == len(names) and "001-cyclic_timer_tests_l1002_fq100-r3" in names
    assert len(plan_round(GROUPS[:1], 5, 7)) == 1


@pytest.mark.parametrize(("measurements", "rounds"), [(1, 1), (1000, 1), (1001, 2), (10_000, 10)])
def test_start_up_values_do_not_count(measurements, rounds):
    assert rounds_for(GROUPS[0], measurements) == rounds


@pytest.mark.parametrize(
    ("measurements", "boots", "boot_rounds"),
    [(16_000, 8, 2), (16_000, 1, 16), (1000, 8, 1), (15_999, 8, 2), (15_000, 8, 1)],
)
def test_the_rounds_of_the_best_case_are_spread_over_the_boots(measurements, boots, boot_rounds):
    needed = dict.fromkeys(NAMES, measurements)
    assert rounds_of_boot(GROUPS, needed, boots) == boot_rounds
    assert boot_of_round(1, boot_rounds) == 0 and boot_of_round(boot_rounds + 1, boot_rounds) == 1
    assert outlook(GROUPS, needed, boots=boots, boot_rounds=boot_rounds).boots >= boots


def test_the_outlook_counts_rounds_boots_and_seconds():
    times = outlook(GROUPS, dict.fromkeys(NAMES, 16_000), boots=8, boot_rounds=2)
    assert (times.rounds, times.boots) == (16, 8)
    assert times.measuring_s == pytest.approx(16 * 1002 * (1 / 100 + 1 / 200 + 1 / 300 + 1 / 400))
    few = outlook(GROUPS, dict.fromkeys(NAMES, 1), boots=8, boot_rounds=1)
    assert (few.rounds, few.boots) == (8, 8), "the boots that the answer must rest on take a round each"
