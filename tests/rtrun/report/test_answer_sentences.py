"""The answers as `quick` and `report` put them: what was late, and how many may be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report.campaigns import latencies, oneshot_run

from rtrun.judgement.study import study
from rtrun.judgement.verdicts import answer_to
from rtrun.plan.question import Question
from rtrun.report.scenarios import scenarios
from rtrun.report.sentences import answers_in_words, headline, sentence

DEADLINE_NS = 400_000


def texts(root: Path, values: np.ndarray, **asked: float | int) -> tuple[str, str]:
    """The headline, and the sentence about one run of these values."""
    oneshot_run(root, "a", values)
    analysed = study(root, Question(deadline_ns=DEADLINE_NS, **asked), bounds=False)
    shown = scenarios(analysed)
    return headline(analysed, shown), sentence(shown[0])


def late(count: int, n: int) -> np.ndarray:
    """So many single misses among n values, at random."""
    values = np.minimum(latencies(n, 1), DEADLINE_NS - 1000)
    values[np.random.default_rng(5).choice(n, count, replace=False)] = 5 * DEADLINE_NS
    return values


@pytest.mark.parametrize(
    ("values", "asked", "text"),
    [
        (late(0, 5000), {"probability": 1e-2}, "none of 5 000 late, worst "),
        (
            late(8, 12_000),
            {"probability": 1e-2, "bursts": 1},
            "8 of 12 000 late, worst 2 ms: at most 19 in 10 000 are late",
        ),
        (
            late(900, 3000),
            {"probability": 1e-2},
            "900 of 3 000 late, worst 2 ms: too many, at least 25 in 100",
        ),
        (
            late(0, 300),
            {"probability": 1e-3, "bursts": 1},
            "1 000 are late; 4 s more of measuring without a late one prove at most 1 in 1 000",
        ),
        (
            late(0, 5000),
            {"probability": 1e-3},
            "32 s more of measuring without a late one prove at most 1 in 1 000, even if they come 9 in a row",
        ),
    ],
)
def test_a_sentence_says_what_was_late_and_how_many_may_be(tmp_path, values, asked, text):
    assert text in texts(tmp_path, values, **asked)[1]


def test_where_only_boots_are_missing_nothing_is_said_of_more_measurements(tmp_path):
    text = texts(tmp_path, late(0, 5000), probability=1e-2, boots=3)[1]
    assert text.endswith("2 more boots missing")


def test_what_changed_prevents_a_rate(tmp_path):
    values = late(0, 20_000)
    values[:40:2] = 5 * DEADLINE_NS
    values[10_000:10_400:3] = 5 * DEADLINE_NS
    assert (
        "the system changed while it was measured, so no upper limit can be given ("
        in texts(tmp_path, values, probability=1e-3)[1]
    )


@pytest.mark.parametrize(
    ("count", "text"), [(0, "never missed in 1 test on "), (3, "missed at least once in 1 test on ")]
)
def test_the_headline_says_where_the_deadline_was_missed(tmp_path, count, text):
    assert texts(tmp_path, late(count, 2000))[0].startswith(f"400 us was {text}")


def test_answers_are_counted_in_words():
    answers = ["PROVEN", "REFUTED", "PROVEN", "NEEDS MORE", "no deadline"]
    assert answers_in_words(answers, "1 in 100") == (
        "At most 1 in 100 late? No in 1 of 4 tests, yes in 2, not known yet in 1."
    )


@pytest.mark.parametrize("values", [late(0, 5000), late(8, 12_000), late(900, 3000)])
@pytest.mark.parametrize("probability", [1e-2, 1e-3, 1e-6])
def test_another_probability_needs_no_second_look_at_the_files(tmp_path, values, probability):
    oneshot_run(tmp_path, "a", values)
    asked = Question(deadline_ns=DEADLINE_NS, probability=1e-2)
    (group,) = study(tmp_path, asked, bounds=False).groups
    (anew,) = scenarios(study(tmp_path, replace(asked, probability=probability), bounds=False))
    assert answer_to(group, probability) == anew.answer
