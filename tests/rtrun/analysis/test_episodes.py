"""Episodes of misses: what is one, how often they come, and the bursts that a proof covers by default."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rtrun.analysis.account import Account
from rtrun.analysis.chance.intervals import anytime_upper
from rtrun.analysis.deadline import Answer, Verdict, judge
from rtrun.analysis.dependence.episodes import find_episodes, gap_loops
from rtrun.analysis.trials import Trials, count_misses
from rtrun.plan.question import Question, read_tolerance

DEADLINE = 400_000
MS = 1e6


def values(n: int, *misses: int) -> np.ndarray:
    values_ns = 50_000 + np.arange(n) * 7919 % 1000
    values_ns[list(misses)] = 500_000
    return values_ns


def run(n: int, *misses: int, period_ns: float | None = MS, **where: str) -> Trials:
    return replace(count_misses(values(n, *misses), DEADLINE, period_ns=period_ns), boot="b", **where)


def verdict(*runs: Trials, bursts: int | None = None, period_ns: float | None = MS, **measured: Any) -> Verdict:
    question = Question(deadline_ns=DEADLINE, probability=1e-3, bursts=bursts)
    return judge(Account(runs, period_ns=period_ns, **measured), question)


@pytest.mark.parametrize(
    ("period_ns", "loops"), [(0.1 * MS, 100), (MS, 10), (0.9999 * MS, 10), (5 * MS, 2), (40 * MS, 2), (None, 2)]
)
def test_a_gap_is_10_ms_and_two_loops_at_least(period_ns, loops):
    assert gap_loops(period_ns) == loops


def test_misses_near_one_another_are_one_episode():
    found = find_episodes(np.array([0, 7, 17, 28, 500, 999]), 1000, MS)
    assert (found.begun.count, found.begun_at.tolist()) == (4, [0, 28, 500, 999])
    assert (found.longest_misses, found.longest_loops, found.most_in_a_row) == (3, 18, 1)
    assert find_episodes(np.array([3, 5, 6, 8, 11, 12]), 1000, MS).most_in_a_row == 4
    none = find_episodes(np.empty(0, np.int64), 1000, MS)
    assert (none.begun.count, none.longest_misses, none.longest_loops) == (0, 0, 0)


def test_episodes_are_counted_before_places_of_misses_are_left_out():
    misses = (np.arange(3000)[:, None] * 100 + np.arange(10)).ravel()
    trials = count_misses(values(300_000, *misses), DEADLINE, period_ns=MS)
    assert trials.stride > 1 and trials.episodes is not None
    assert (trials.episodes.begun.count, trials.episodes.longest_misses) == (3000, 10)


def test_a_bound_needs_no_length_of_episodes():
    short, long = (verdict(run(100_000, *range(30_000, 30_000 + size), 70_000)) for size in (2, 9))
    for judged in (short, long):
        assert judged.episodes is not None and judged.episodes.seen == 2
        assert judged.episodes.per_hour_at_most == pytest.approx(3.6e6 * anytime_upper(2, 100_000, 0.95))
    assert long.episodes is not None and (long.episodes.longest_misses, long.episodes.longest_ns) == (9, 9 * MS)
    assert long.upper > short.upper


def test_subscribers_of_one_message_have_the_same_episodes():
    single = verdict(run(100_000, 30_000))
    five = verdict(*[run(100_000, 30_000, run="r")] * 5, period_ns=MS / 5, side_by_side=5.0)
    assert single.episodes is not None and five.episodes is not None
    assert five.episodes.per_hour_at_most == pytest.approx(single.episodes.per_hour_at_most, rel=1e-3)
    assert five.bursts == single.bursts and five.longest_burst == pytest.approx(single.longest_burst, rel=1e-2)
    alone, together = (verdict(*[run(n, run="r")] * 5, period_ns=MS / 5, side_by_side=5.0) for n in (4000, 40_000))
    assert alone.further is not None and alone.further + 20_000 == pytest.approx(5 * 36_888, abs=5)
    assert dict(together.further_for_bursts)[20] + 200_000 == pytest.approx(5 * 20 * 3688.8, rel=1e-3)


def test_boots_that_differ_in_their_episodes_widen_the_bound():
    alike, unlike = (
        verdict(*(replace(run(20_000, *range(99, 99 + 500 * n, 500)), boot=f"b{k}") for k, n in enumerate(counts)))
        for counts in ([4] * 5, [20, 0, 0, 0, 0])
    )
    assert alike.episodes is not None and unlike.episodes is not None and alike.episodes.per_hour_at_most is not None
    assert alike.episodes.seen == unlike.episodes.seen == 20
    assert (unlike.episodes.per_hour_at_most or 0) > 1.5 * alike.episodes.per_hour_at_most


def test_what_nobody_saw_may_hold_any_number_of_episodes():
    for measured in ({"lost": ("it hung",)}, {"hidden_share": 0.01}, {"period_ns": None}):
        judged = verdict(run(10_000, 5000), **measured)
        assert judged.episodes is not None and judged.episodes.seen == 1
        assert judged.episodes.per_hour_at_most is None
    assert verdict(replace(run(10_000), episodes=None)).episodes is None


@pytest.mark.parametrize(
    ("n", "bursts", "answer"),
    [
        (3687, 1, Answer.NEEDS_MORE),
        (3688, 1, Answer.PROVEN),
        (3688, None, Answer.NEEDS_MORE),
        (36_886, None, Answer.NEEDS_MORE),
        (36_888, None, Answer.PROVEN),
        (36_886, 10, Answer.NEEDS_MORE),
        (36_888, 10, Answer.PROVEN),
    ],
)
def test_a_proof_without_a_miss_takes_ten_times_as_many_for_a_stall_of_10_ms(n, bursts, answer):
    judged = verdict(run(n), bursts=bursts)
    assert judged.answer == answer
    assert judged.longest_burst >= 1 or n == 3687


@pytest.mark.parametrize(
    ("period_ns", "length", "why"),
    [
        (MS, 10, "stall"),
        (0.9999 * MS, 10, "stall"),
        (0.2 * MS, 50, "stall"),
        (3 * MS, 4, "stall"),
        (10.01 * MS, 1, "stall"),
        (9.99 * MS, 1, "stall"),
        (1000 * MS, 1, "stall"),
        (1e-300, 10_000_000, "stall"),
        (None, 10, "period not known"),
    ],
)
def test_the_default_is_a_stall_at_the_period_of_the_stream(period_ns, length, why):
    judged = verdict(run(1000, period_ns=period_ns), period_ns=period_ns)
    assert (judged.bursts.length, judged.bursts.why) == (length, why)
    assert judged.bursts_by_default == length
    stated = verdict(run(1000, period_ns=period_ns), period_ns=period_ns, bursts=3)
    assert (stated.bursts.length, stated.bursts.why, stated.bursts_by_default) == (3, "asked", length)


def test_the_longest_that_was_seen_is_covered_too():
    judged = verdict(run(300_000, *range(1000, 1014)))
    assert (judged.bursts.length, judged.bursts.why) == (14, "longest seen")
    assert verdict(run(300_000, *range(1000, 1014)), bursts=1).bursts.length == 1
    apart = verdict(run(300_000, *range(1000, 1200, 5)))
    assert (apart.bursts.length, apart.bursts.why) == (10, "stall"), "an episode, but no burst"
    slow = verdict(run(300_000, 5, 6, 7, period_ns=20 * MS), period_ns=20 * MS)
    assert (slow.bursts.length, slow.bursts.why) == (3, "longest seen")


def test_many_misses_that_chance_lets_lie_near_are_no_burst():
    """Nearly all of them are one episode at 10 kHz; that P(miss) is below what is asked is provable all the same."""
    late = np.flatnonzero(np.random.default_rng(7).random(40_000) < 0.3)
    trials = replace(count_misses(values(40_000, *late), DEADLINE, period_ns=MS / 10), boot="b")
    question = Question(deadline_ns=DEADLINE, probability=0.5)
    judged = judge(Account([trials], period_ns=MS / 10), question)
    assert judged.episodes is not None and judged.episodes.seen < 5 and judged.episodes.longest_misses > 1000
    assert judged.answer == Answer.PROVEN


@pytest.mark.parametrize("tolerance", ["0 in a row", "2 in a row", "9 in a row", "10 in a row", "3 of 100", "4 of 6"])
def test_a_stall_makes_as_many_windows_as_the_default_covers(tolerance):
    tolerated = read_tolerance(tolerance)
    trials = count_misses(values(5000, *range(2000, 2010)), DEADLINE, tolerance=tolerated, period_ns=MS)
    question = Question(deadline_ns=DEADLINE, probability=0.5, tolerance=tolerated)
    none = count_misses(values(5000), DEADLINE, tolerance=tolerated, period_ns=MS)
    judged = judge(Account([replace(none, boot="b")], period_ns=MS), question)
    assert judged.bursts.length == max(1, trials.late)
