"""The goal of a folder of runs: what it may become after answers were seen."""

import pytest
from report.campaigns import latencies, oneshot_run

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.plan.goal import Goal
from rtrun.results.goal_file import read_goal, write_goal


def goal(**keys):
    return Goal(**{"deadline": "10ms", "probability": "1e-3", "at_most": "1h", **keys})


def measure(results):
    oneshot_run(results, "001", latencies(500, 1))


def test_a_deadline_that_is_chosen_after_looking_is_refused(tmp_path, capsys):
    write_goal(tmp_path, goal())
    write_goal(tmp_path, goal(deadline="9ms"))
    measure(tmp_path)
    with pytest.raises(
        UsageError, match=r"for P\(value > 9 ms\), the campaign asks for P\(value > 8 ms\) now.*--fresh"
    ):
        write_goal(tmp_path, goal(deadline="8ms"))
    assert read_goal(tmp_path).deadline_ns == 9_000_000
    assert main(["verdict", str(tmp_path), "--deadline", "8ms"]) == 0
    assert "measured for P(value > 9 ms): the answer to another question" in capsys.readouterr().err


@pytest.mark.parametrize("change", [{"at_most": "2h"}, {"probability": "1e-2"}, {"boots": 3}, {"bursts": 5}])
def test_what_the_interval_holds_for_may_change(tmp_path, change):
    write_goal(tmp_path, goal())
    measure(tmp_path)
    write_goal(tmp_path, goal(**change))
    assert read_goal(tmp_path) == goal(**change)


def test_a_goal_states_bursts_only_where_somebody_did(tmp_path):
    for bursts in (None, 1, 7):
        write_goal(tmp_path, goal(bursts=bursts))
        assert read_goal(tmp_path).question.bursts == bursts
        assert ('"bursts"' in (tmp_path / "goal.json").read_text()) == (bursts is not None)


@pytest.mark.parametrize(
    ("stated", "asked", "is_less"),
    [(None, 1, True), (None, 9, False), (None, 8, True), (5, 4, True), (5, 5, False), (5, 6, False), (1, 1, False)],
)
def test_a_gate_that_covers_shorter_bursts_than_the_goal_asks_less(tmp_path, stated, asked, is_less, capsys):
    """A one-shot timer of 1 ms measures every 1.1 ms: a stall of 10 ms makes it late nine times."""
    write_goal(tmp_path, goal(bursts=stated))
    oneshot_run(tmp_path, "001", latencies(40_000, 1))
    asks = ["gate", str(tmp_path), "--bursts", str(asked)]
    assert main(asks) == int(is_less)
    printed = " ".join(capsys.readouterr().out.split())
    assert ("ASKS LESS" in printed) == is_less
    if is_less:
        now = "misses that come singly" if asked == 1 else f"bursts of up to {asked} misses"
        before = "bursts of 10 ms" if stated is None else f"bursts of up to {stated} misses"
        assert f"covering {now}, not {before}" in printed
        assert main([*asks, "--instead-of-goal"]) == 0


def test_bursts_are_a_whole_number_of_misses(tmp_path, capsys):
    measure(tmp_path)
    for wrong in ("0", "-1", "1.5", "1001", "9" * 5000, "٤", "ten"):
        assert main(["verdict", str(tmp_path), f"--bursts={wrong}"]) == 2
        assert "is no number of misses in a row, 1 to 1000" in " ".join(capsys.readouterr().err.split())


LESS = {
    "probability": ["--probability", "1e-2"],
    "deadline": ["--deadline", "11ms"],
    "confidence": ["--confidence", "0.9"],
    "misses tolerated": ["--tolerate", "2 in a row"],
}


@pytest.mark.parametrize("what", LESS)
def test_a_gate_that_asks_less_than_the_goal_fails_unless_it_is_told_to(tmp_path, what, capsys):
    write_goal(tmp_path, goal())
    oneshot_run(tmp_path, "001", latencies(40_000, 1))
    assert main(["gate", str(tmp_path)]) == 0
    assert "ASKS LESS" not in capsys.readouterr().out
    assert main(["gate", str(tmp_path), *LESS[what]]) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "FAIL ASKS LESS question" in printed and f"asks less than the goal of the campaign: a {what} of" in (
        printed.replace("goal of the campaign: misses tolerated: ", "goal of the campaign: a misses tolerated of ")
    )
    assert main(["gate", str(tmp_path), *LESS[what], "--instead-of-goal"]) == 0


@pytest.mark.parametrize(
    "more", [["--probability", "1e-3"], ["--deadline", "9ms"], ["--tolerate", "1 in a row"], ["--confidence", "0.99"]]
)
def test_a_gate_that_asks_more_decides(tmp_path, more, capsys):
    write_goal(tmp_path, goal(probability="1e-2", tolerate="2 in a row"))
    oneshot_run(tmp_path, "001", latencies(40_000, 1))
    main(["gate", str(tmp_path), *more])
    assert "ASKS LESS" not in capsys.readouterr().out
