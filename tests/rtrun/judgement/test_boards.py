"""Answers of several boards: pooled where they are alike, told apart where they are not."""

import json
from dataclasses import replace

import pytest
from report.campaigns import latencies, oneshot_run

from rtrun.analysis.deadline import Answer
from rtrun.cli import main
from rtrun.execution.goal import standings_of
from rtrun.judgement.standings import standings
from rtrun.judgement.study import study
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.question import THESIS

TARGET = {"kernel_release": "6.1.0-rt", "kernel_version": "#1 SMP PREEMPT_RT", "cpus": 2, "governor": "performance"}
QUESTION = replace(THESIS, probability=1e-3, bursts=1)
WORDS = ["--deadline", "400us", "--probability", "1e-3", "--confidence", "0.95", "--bursts", "1"]


def write(root, board, boot="", *, late=0, n=3200, name=None, **target):
    """A run on a board whose first `late` values miss the deadline; seven apart, so that they form no burst."""
    values = latencies(n, sum(map(ord, board + boot)), 90.0)
    values[: 701 * late : 701] = 500_000
    facts = {"name": board, "boot_id": f"{board}{boot}", **TARGET, **target}
    oneshot_run(root, name or f"001-{board}{boot}", values, target=facts)


def test_alike_boards_prove_together_what_none_proves_alone(tmp_path, capsys):
    for board in ("a", "b"):
        write(tmp_path, board)
    studied = study(tmp_path, QUESTION)
    assert [group.verdict.answer for group in studied.groups] == [Answer.NEEDS_MORE] * 2
    (pooled,) = studied.pooled
    assert pooled.verdict.answer is Answer.PROVEN and pooled.n == sum(group.n for group in studied.groups)
    assert pooled.boards == ("a", "b") and pooled.verdict.boards == 2
    assert main(["verdict", str(tmp_path), *WORDS]) == 0
    out = capsys.readouterr().out
    assert (
        ", 2 boards" in out and ", a " in out and "of single boards: p99.9 " in out and " (a) to " in out + " (b) to "
    )
    assert main(["gate", str(tmp_path), "-v", *WORDS]) == 0
    out = capsys.readouterr().out
    assert "holds for the 2 boards together" in out
    assert "boards of another kind may be up to 85 % of all" in " ".join(out.split())
    assert "measured in 1 of the 24 hours of a day" in " ".join(out.split())
    assert main(["report", str(tmp_path), *WORDS, "--format", "markdown", "--output", "-"]) == 0
    out = capsys.readouterr().out
    assert "is met in the one scenario" in out and "for the 2 boards together" in out and "not decided" not in out
    assert main(["report", str(tmp_path), *WORDS, "--format", "json", "--output", "-"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    assert [group["verdict"]["answer"] for group in groups] == ["PROVEN", "NEEDS MORE", "NEEDS MORE"]


@pytest.mark.parametrize(
    ("fact", "other"),
    [
        ("machine", "aarch64"),
        ("cpus", 4),
        ("kernel_release", "6.6.0-rt"),
        ("kernel_version", "#2 SMP PREEMPT_RT"),
        ("preempt_rt", False),
        ("clocksource", "hpet"),
        ("governor", "powersave"),
        ("middleware_version", "2"),
    ],
)
def test_boards_that_differ_in_what_matters_are_not_pooled(tmp_path, fact, other):
    write(tmp_path, "a")
    write(tmp_path, "b", **{fact: other})
    assert study(tmp_path, QUESTION).pooled == ()


def test_boards_that_differ_are_not_pooled_and_it_is_said_in_what(tmp_path, capsys):
    write(tmp_path, "a")
    write(tmp_path, "b", governor="powersave")
    assert study(tmp_path, QUESTION).pooled == ()
    assert main(["verdict", str(tmp_path), *WORDS]) == 0
    assert "boards that differ in governor are not pooled: performance on a; powersave on b" in capsys.readouterr().out
    assert main(["gate", str(tmp_path), *WORDS]) == 1, "neither board alone proves it"


def test_boards_are_clusters(tmp_path):
    """The same misses say less when they are all of one board."""
    for root, misses in ((tmp_path / "even", (3, 3, 3)), (tmp_path / "uneven", (9, 0, 0))):
        for board, late in zip(("a", "b", "c"), misses, strict=True):
            write(root, board, late=late, n=7000)
    even, uneven = (study(tmp_path / name, QUESTION).pooled[0].verdict for name in ("even", "uneven"))
    assert even.misses == uneven.misses == 9
    assert uneven.design_effect > 2 * even.design_effect and uneven.upper > even.upper


def test_a_board_that_misses_fails_the_gate_whatever_the_others_prove(tmp_path, capsys):
    write(tmp_path, "a", late=30, n=25_000)
    for boot in range(8):
        write(tmp_path, "b", str(boot), n=60_000)
    question = ["--deadline", "400us", "--probability", "5e-4", "--confidence", "0.95", "--bursts", "1"]
    assert main(["gate", str(tmp_path), *question]) == 1
    out = capsys.readouterr().out
    assert "FAIL  REFUTED" in out


@pytest.mark.parametrize("governor", ["performance", "powersave"])
def test_a_goal_is_reached_by_alike_boards_together_and_by_each_of_unlike_ones(tmp_path, governor):
    entry = {"suite": "oneshot_timer_tests", "repetitions": 100, "timeout_us": 1000, "policy": "RR"}
    (group,) = plan(Campaign(schema=1, name="test", order="interleaved", seed=7, runs=[entry]), "test")
    write(tmp_path, "a", n=9000, name=group.name)
    write(tmp_path, "b", n=3400, name=f"{group.name}-r2", governor=governor)
    (chosen,) = standings_of([group], standings(study(tmp_path, QUESTION))).values()
    assert chosen.is_final == (governor == "performance")
    assert chosen.boards == ({"a", "b"} if governor == "performance" else {"b"})


def test_programs_read_which_boards_a_group_is_of(tmp_path, capsys):
    for board in ("a", "b"):
        write(tmp_path, board)
    assert main(["verdict", str(tmp_path), *WORDS, "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    assert [group["boards"] for group in groups] == [["a", "b"], ["a"], ["b"]]


@pytest.mark.parametrize(("n", "columns", "width"), [(240, 240, 1), (9600, 240, 40), (9601, 235, 41)])
def test_a_course_has_240_columns_at_most(tmp_path, n, columns, width):
    write(tmp_path, "a", n=n)
    (group,) = study(tmp_path, QUESTION).groups
    course = group.digests[0].course
    assert (course.low_ns.size, course.width) == (columns, width)
