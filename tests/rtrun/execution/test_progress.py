"""The time left, as the bar tells it."""

import io

import pytest
from rich.console import Console

from rtrun.execution import progress
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import RESTART_S, START_AND_END_S
from rtrun.plan.short_names import short_names_of_runs
from rtrun.results.figures_so_far import FiguresSoFar

RUNS = plan(
    Campaign(
        schema=1,
        name="test",
        runs=[{"suite": "cyclic_timer_tests", "frequency_hz": 100, "repetitions": [1000, 2000, 3000]}],
    ),
    "test",
)


def test_a_run_that_takes_longer_leaves_the_others_their_time(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    estimate = progress._Estimate(RUNS)
    estimate.began(0)
    assert estimate.left_s() == pytest.approx(60 + 3 * START_AND_END_S)
    now[0] = 25.0
    assert estimate.left_s() == pytest.approx(50 + 2 * START_AND_END_S), "late, but the rest still takes its time"
    assert estimate.ended() == 25.0
    assert estimate.left_s() == 20 + 30 + 2 * 15, "each of the rest is expected to cost what the first did"


def test_the_reason_of_a_target_stays_one_line(capsys):
    plain = progress.PlainProgress(RUNS)
    plain.began(0, RUNS[0])
    plain.ended(0, RUNS[0], "failed", "no\x1b[2J\n[2/3] ok         forged")
    plain.note("no\x1b[2J\nrtrun: forged")
    seen = capsys.readouterr()
    assert seen.out.count("\n") == seen.err.count("\n") == 1 and "\x1b" not in seen.out + seen.err


def test_lines_where_there_is_no_terminal(capsys):
    plain = progress.PlainProgress(RUNS)
    plain.began(1, RUNS[1])
    plain.ended(1, RUNS[1], "failed", "no rights")
    assert capsys.readouterr().out.startswith(f"[2/3] failed     {RUNS[1].name}  0.")


def test_restarts_to_come_are_counted(monkeypatch):
    monkeypatch.setattr(progress.time, "monotonic", lambda: 0.0)
    entry = {"suite": "cyclic_timer_tests", "repeats": 2}
    campaign = Campaign.model_validate({"schema": 1, "name": "test", "kernels": ["standard", "rt"], "runs": [entry]})
    runs = plan(campaign, "test")
    estimate = progress._Estimate(runs)
    assert estimate.left_s() == pytest.approx(sum(run.total_s for run in runs) + 3 * RESTART_S)
    estimate.began(2)
    assert estimate.left_s() == pytest.approx(sum(run.total_s for run in runs[2:]) + RESTART_S)


FIGURES = FiguresSoFar(n=1200, min_ns=3123, mean_ns=8_900, max_ns=1_204_300)


def test_figures_so_far_are_those_of_cyclictest():
    assert progress.in_words(FIGURES, RUNS[1]) == "1 200 of 2 000  min 3.1  avg 8.9  max 1 204 us"


@pytest.mark.parametrize("width", [50, 60, 80, 200])
def test_a_narrow_terminal_cuts_the_name_and_never_the_figures(width):
    screen = io.StringIO()
    console = Console(file=screen, width=width, force_terminal=True, legacy_windows=False)
    with progress.showing(RUNS, console) as shown:
        shown.began(1, RUNS[1])
        shown.on_figures(FIGURES)
        shown._bar.refresh()
        drawn = ["".join(part.text for part in line) for line in console.render_lines(shown._bar.get_renderable())]
    assert "1/" not in drawn[1] and drawn[1].rstrip().endswith("1 200 of 2 000  min 3.1  avg 8.9  max 1 204 us")
    assert all(len(line) == width for line in drawn) and len(drawn) == 2
    shown.ended(1, RUNS[1], "ok", None)


def test_the_target_is_not_asked_where_nobody_sees_the_figures():
    with progress.showing(RUNS, Console(file=io.StringIO())) as shown:
        shown.began(0, RUNS[0])
        assert shown.on_figures is None


def test_short_names_tell_runs_apart():
    entries = [
        {"suite": "cyclic_timer_tests", "repeats": 2},
        {"suite": "communication_tests", "condition": ["idle", "cpu80"]},
    ]
    campaign = Campaign.model_validate({"schema": 1, "name": "test", "runs": entries})
    runs = plan(campaign, "test")
    names = short_names_of_runs(runs)
    assert len(set(names.values())) == len(runs)
    assert [*names.values()] == [
        "cyclic_timer repeat=1",
        "cyclic_timer repeat=2",
        "communication",
        "communication load=cpu80",
    ]
