"""Each sentence of a verdict with the state that makes it: no reader is to be misled by one."""

from dataclasses import replace

import numpy as np
import pytest

from rtrun.analysis.account import Account
from rtrun.analysis.comparison.differences import Ratio
from rtrun.analysis.deadline import judge
from rtrun.analysis.dependence.episodes import find_episodes
from rtrun.analysis.order.stationarity import Change
from rtrun.analysis.trials import Trials, count_misses
from rtrun.judgement.verdicts import scope_in_short, sentences
from rtrun.plan.question import NONE_TOLERATED, THESIS, Tolerance, boots_for, read_tolerance, unlike_share
from rtrun.report.compare import _ratio

QUESTION = replace(THESIS, probability=1e-3, bursts=1)
PERIOD_NS = 1e6


TWO, FEW = read_tolerance("2 in a row"), read_tolerance("3 of 100")
TOLERANT = replace(QUESTION, of="jitter", tolerance=TWO)


def trials(n: int, *late: int, boots: int = 1, tolerance: Tolerance = NONE_TOLERATED) -> list[Trials]:
    """Runs of a boot each, n measurements in all, with misses at these places of the first one."""
    runs = []
    for boot in range(boots):
        values = np.full(n // boots, 50_000) + np.arange(n // boots) * 7919 % 1000
        values[[place for place in late if not boot]] = 600_000
        counted = count_misses(values, 400_000, tolerance=tolerance)
        runs.append(replace(counted, boot=f"b{boot}", run=f"r{boot}", start_time=f"{boot:03}"))
    return runs


def test_the_answer_says_what_it_covers_and_for_what_it_already_holds():
    by_default = replace(QUESTION, bursts=None)

    def text_of(measured, question=by_default, period_ns=PERIOD_NS):
        timed = [replace(run, episodes=find_episodes(run.missed_at, run.n, period_ns)) for run in measured]
        return "; ".join(sentences(judge(Account(timed, period_ns=period_ns), question)))

    default = "bursts of 10 ms (10 misses in a row, the default)"
    assert f"for misses that come singly it already holds; has to cover {default}; 32 8" in text_of(trials(4000))
    assert f"for bursts of up to 5 misses it already holds; has to cover {default}; 16 8" in text_of(trials(20_000))
    short = text_of(trials(1000))
    assert "already holds" not in short and f"has to cover {default}; 35 8" in short
    assert "holds for bursts of up to 27 misses (without a miss, 84 4" in text_of(trials(100_000))
    assert f"covers {default}" in text_of(trials(100_000))
    assert "covers bursts of 10 ms (a single miss, the default)" in text_of(trials(4000), period_ns=20e6)
    unknown = text_of(trials(100_000), period_ns=None)
    assert "bursts of 10 ms (10 misses in a row, the default; the period is not known and counts as 1 ms)" in unknown
    seen = text_of(trials(200_000, *range(500, 512)))
    assert "covers the longest burst that was seen (12 misses in a row, the default)" in seen
    assert "(1 seen, the longest of 12 misses within 12 ms)" in seen
    stated = text_of(trials(4000), replace(QUESTION, bursts=20))
    assert "for misses that come singly it already holds; has to cover bursts of up to 20 misses" in stated
    assert "the default" not in stated + text_of(trials(4000), QUESTION)
    assert "(2 seen, single misses)" in text_of(trials(4000, 500, 3000))
    assert "already holds" not in text_of(trials(4000), replace(by_default, boots=3))


ADDED = "for the system measure on 5 boots or more"


@pytest.mark.parametrize(
    ("measured", "question", "words"),
    [
        (trials(0), QUESTION, "3 688 more measurements (4 s) prove it if no miss comes"),
        (
            trials(1000),
            QUESTION,
            "2 688 more measurements (3 s) prove it if no miss comes; after 1 000 without one, the chance of that is",
        ),
        (trials(4000, 2000), QUESTION, "prove it if no other miss comes; if misses stay as frequent, PROVEN after "),
        (
            trials(2000, 100, 700, 1200, 1900),
            QUESTION,
            "if misses stay as frequent, no number of measurements is likely to decide it",
        ),
        (trials(2000, *range(50, 2000, 310)), QUESTION, "if misses stay as frequent, REFUTED after"),
        (trials(4500), replace(QUESTION, boots=3), "worst 51.00 us; 2 more boots"),
        (trials(4000), QUESTION, "holds for misses that come singly (without a miss, 69 7"),
        (trials(4000), QUESTION, f"holds for the boot that was measured; {ADDED}"),
        (trials(2000, *range(10, 2000, 10)), QUESTION, f"holds for the boot that was measured; {ADDED}"),
        (trials(20_000), QUESTION, "holds for bursts of up to 5 misses ("),
        (
            trials(5000, boots=5),
            QUESTION,
            "measured on 5 boots: boots of another kind may be up to 53 % of",
        ),
        (
            [*trials(5000, boots=5), replace(trials(400)[0], run="5", boot="short")],
            QUESTION,
            "measured on 6 boots: boots of another kind may be up to 65 % of all, since 1 of the 6 boots is too",
        ),
        (
            trials(4000),
            replace(QUESTION, of="lateness"),
            "0 of 4 000 late; P(lateness > 400 us) at most 0.00093; at most 3 319 episodes of",
        ),
        (
            trials(4000, 7, tolerance=TWO),
            TOLERANT,
            "0 of 3 998 windows hold too many misses; P(more than 2 in a row with jitter",
        ),
        (trials(4000, 7, 8, 9, tolerance=TWO), TOLERANT, "1 of 3 998 windows hold too many"),
        (
            trials(4000, tolerance=FEW),
            replace(TOLERANT, tolerance=FEW),
            "P(more than 3 of 100 with jitter > 400 us) at most 0.08",
        ),
        (
            trials(4000),
            replace(QUESTION, bursts=20),
            "69 776 more measurements (1 min 10 s) prove it if no miss comes; after 4 000 without one",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_sentence(measured, question, words):
    text = "; ".join(sentences(judge(Account(measured, period_ns=PERIOD_NS), question)))
    assert words in text, text
    for nonsense in (" 0 more", "(0 s)", "0 h)", "up to 1 misses"):
        assert nonsense not in text


def test_a_change_is_said_before_anything_else():
    verdict = judge(Account(trials(4000), period_ns=PERIOD_NS), QUESTION)
    change = Change(p_value=1e-9, significant=0.01, text="it rose", missing_loops=60_000)
    assert sentences(replace(verdict, answer="NEEDS MORE", change=change)) == [
        "the system changed while it was measured: it rose (p = 1e-09)",
        "0 of 4 000 late",
        "P(value > 400 us) at most 0.00093",
        "at most 3 319 episodes of misses an hour (none seen)",
        "worst 51.00 us",
        "a load that comes and goes is part of the process once it has come back five times: "
        "60 000 more measurements (1 min 00 s)",
    ]


@pytest.mark.parametrize(
    ("measured", "words"),
    [
        (trials(4000), "in this boot, if late values come singly"),
        (
            trials(100_000, boots=5),
            "on boots like the 5 that were measured (5 boots can miss another kind, even one that is 53 % of all "
            "boots), even if late values come 22 in a row",
        ),
    ],
)
def test_the_table_says_beside_the_answer_what_it_holds_for(measured, words):
    assert scope_in_short(judge(Account(measured), QUESTION)) == words


def test_one_late_value_is_a_burst_where_the_period_is_as_long():
    by_default = judge(Account(trials(4000), period_ns=20e6), replace(QUESTION, bursts=None))
    assert scope_in_short(by_default) == "in this boot, if late values come singly (a burst of 10 ms has one)"


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (Ratio(value=None, low=0, high=np.inf), "no miss on either side: nothing can be said of a change"),
        (Ratio(value=np.inf, low=0.66, high=np.inf), "misses in B only: times 0.66 at least (95 % CI)"),
        (Ratio(value=0, low=0, high=1.5), "misses in A only: times 1.5 at most (95 % CI)"),
        (Ratio(value=2, low=0.66, high=3), "times 2, 95 % CI 0.66 to 3"),
        (Ratio(value=2, low=0.66, high=np.inf), "times 2, 95 % CI 0.66 at least"),
    ],
)
def test_a_ratio_of_misses(ratio, words):
    assert _ratio(ratio, 0.95) == words


def test_a_share_of_boots_and_their_number_are_inverse():
    assert boots_for(0.05, 0.95) == 72
    assert unlike_share(72, 0.95) <= 0.05 < unlike_share(71, 0.95)


def test_one_miss_more_in_a_burst_changes_little():
    """Bursts are counted, not misses: there is no cliff at 20 misses."""
    question = replace(THESIS, probability=1e-4)
    missing = [
        judge(Account(trials(100_000, *range(50_000, 50_000 + size))), question).further for size in (19, 20, 21)
    ]
    assert missing[1] < 1.2 * missing[0] and missing[2] < 1.2 * missing[1]
