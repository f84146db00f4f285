"""Campaigns with a goal, end to end: the real command, the real sshd, a stand-in for the suite that never lies."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from faulty import target_file

from rtrun.cli import main
from rtrun.results.journal import Journal

pytestmark = [pytest.mark.sshd, pytest.mark.ros]

# The stand-in ticks once a millisecond whatever it is asked for: at 1000 Hz it is never late, at 2000 Hz always.
CAMPAIGN = """
schema: 1
name: brakes
order: interleaved
seed: 7
common: {{repetitions: 102}}
runs: [{{suite: cyclic_timer_tests, frequency_hz: {frequencies}}}]
until: {{deadline: 400us, probability: {probability}, confidence: 0.95, at_most: {at_most}, boots: {boots}, bursts: 1}}
"""


@pytest.fixture
def campaign(tmp_path, rebooting, suites_folder, wishes, ros_master, monkeypatch):
    """Writes campaign and target; returns the words of the command."""
    monkeypatch.chdir(tmp_path)
    boot = "cat /proc/sys/kernel/random/uuid >" + str(tmp_path / "boot_id")
    own = {"suites": str(suites_folder), "restart": ["sh", "-c", boot]}
    target = target_file(rebooting, ros_master) | own
    (tmp_path / "target.yml").write_text(json.dumps(target))

    def write(frequencies, *, probability="0.02", at_most="10min", boots=2):
        words = {"frequencies": frequencies, "probability": probability, "at_most": at_most, "boots": boots}
        (tmp_path / "campaign.yml").write_text(CAMPAIGN.format(**words))
        return ["run", "campaign.yml", "--target", "target.yml"]

    return write


def answers(capsys):
    capsys.readouterr()
    assert main(["verdict", "results/brakes", "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    return {group["runs"][0][:3]: group["answer"] for group in groups}


def boots():
    return {json.loads(path.read_text())["target"]["boot_id"] for path in Path("results/brakes").glob("*/run.json")}


def test_one_group_is_proven_and_one_refuted_on_two_boots(campaign, wishes, capsys):
    words = campaign([1000, 2000], probability="0.032")
    assert main(words) == 0
    out = capsys.readouterr().out
    # 185 measurements on two boots without a miss prove P < 0.032: two runs of 100.
    assert sorted(call.split()[1] for call in wishes.calls()) == ["1000"] * 2 + ["2000"] * 2
    assert re.search(r"NEEDS MORE  cyclic_timer .*1 of 2 boots; about \d+ s left", out), out
    end = out.partition(", on at least 2 boots")[2]
    assert " PROVEN " in end and " REFUTED " in end and "NEEDS MORE" not in end
    assert end.endswith("rtrun report results/brakes\n")
    assert answers(capsys) == {"001": "PROVEN", "002": "REFUTED"}
    assert len(boots()) == 2
    assert main(["gate", "results/brakes"]) == 1, "the goal is the question of the gate as well"
    assert "REFUTED" in capsys.readouterr().out
    assert main(words) == 0
    assert "nothing is left to measure" in capsys.readouterr().err
    assert len(wishes.calls()) == 4


def test_it_ends_when_the_time_is_over_and_goes_on_when_it_gets_more(campaign, wishes, capsys, monkeypatch):
    with monkeypatch.context() as clock:
        clock.setattr(Journal, "spent_s", lambda *_: float(len(wishes.calls())))
        assert main(campaign([1000], probability="1e-3", at_most="3s", boots=1)) == 0
    out = capsys.readouterr().out
    assert "NEEDS MORE" in out and re.search(r"3 \d\d\d more \(\d+ s\)", out), out
    goes_on = (
        "campaign.yml: until.at_most: 3 s are over, and 1 of 1 group has no answer: allow more, and the same command "
        "goes on; what was measured counts\n"
    )
    assert goes_on in out
    assert len(wishes.calls()) == 3, "a run counts as a second here"
    assert main(["gate", "results/brakes"]) == 1
    assert main(campaign([1000], probability="0.01", at_most="10min", boots=1)) == 0
    assert "at_most" not in capsys.readouterr().out
    assert answers(capsys) == {"001": "PROVEN"}
    assert len(wishes.calls()) == 4, "368 measurements without a miss prove P < 0.01: what was measured counts"


def test_a_killed_runner_goes_on_in_its_round(campaign, wishes, capsys, tmp_path):
    words = campaign([1000], boots=3)
    wishes.will("ok", "sleep 3", "ok")
    process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], env=os.environ, cwd=tmp_path)
    wishes.await_calls(2)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert main(words) == 0
    assert len(wishes.calls()) == 3, "what was going on was picked up"
    assert len(boots()) == 3
    assert answers(capsys) == {"001": "PROVEN"}


def test_a_target_that_nobody_can_restart_is_refused_before_anything_is_measured(campaign, wishes, capsys, tmp_path):
    words = campaign([1000])
    path = tmp_path / "target.yml"
    target = json.loads(path.read_text())
    del target["restart"]
    path.write_text(json.dumps(target))
    assert main(words) == 2
    assert "until.boots: asks for 2 boots, but the file of target loopback does not say how" in capsys.readouterr().err
    assert wishes.calls() == []
