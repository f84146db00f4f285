"""The time left, as the bar tells it."""

import pytest

from rtrun.execution import progress
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import RESTART_S, START_AND_END_S

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
