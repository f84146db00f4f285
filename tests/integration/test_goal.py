"""Campaigns with a goal on the rehearsal board: through a restart of the board and a killed runner."""

import json
import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import rtgen.cli
from rtrun.cli import main

pytestmark = [pytest.mark.qemu, pytest.mark.slow, pytest.mark.ros, pytest.mark.timeout(900)]
TOP = Path(__file__).parents[2]
BOARD = TOP / "build" / "board" / "qemu-armv7"


@pytest.fixture
def target(tmp_path, monkeypatch):
    """The rehearsal board, where KVM seems to work: virtual machines get verdicts, emulated ones none."""
    monkeypatch.chdir(TOP)
    assert rtgen.cli.main(["board", "build", "--machine", "qemu-armv7"]) == 0
    assert rtgen.cli.main(["suites", "build", "--machine", "qemu-armv7"]) == 0
    folder = tmp_path / "board"
    folder.mkdir()
    for path in BOARD.iterdir():
        (folder / path.name).symlink_to(path.resolve())
    board = json.loads((BOARD / "board.json").read_text())
    (folder / "board.json").unlink()
    # The guest that is to prove KVM ends at once; the board itself is emulated all the same.
    stand_in = tmp_path / "qemu"
    stand_in.write_text(f'#!/bin/sh\ncase "$*" in *panic=-1*) exit 0 ;; esac\nexec {board["qemu"]["binary"]} "$@"\n')
    stand_in.chmod(0o755)
    board["qemu"] |= {"binary": str(stand_in), "kvm": {"processor": platform.machine(), "arguments": ["-name", "kvm"]}}
    (folder / "board.json").write_text(json.dumps(board))
    monkeypatch.chdir(tmp_path)
    text = f"schema: 1\nname: board\nkind: qemu\nboard: board\nsuites: {TOP / 'build' / 'suites' / 'qemu-armv7'}\n"
    (tmp_path / "target.yml").write_text(text)
    return tmp_path / "target.yml"


def write_campaign(text):
    Path("campaign.yml").write_text("schema: 1\nname: goal\norder: interleaved\nseed: 3\n" + text)
    return ["run", "campaign.yml", "--target", "target.yml"]


def answers(capsys):
    capsys.readouterr()
    assert main(["verdict", "results/goal", "--json"]) == 0
    return {group["runs"][0][:3]: group["answer"] for group in json.loads(capsys.readouterr().out)["groups"]}


def closed():
    return sorted(Path("results/goal").glob("0*/run.json"))


@pytest.mark.usefixtures("target")
def test_proven_on_three_boots_through_a_killed_runner_and_a_restart_of_the_board(capsys):
    words = write_campaign(
        "runs: [{suite: cyclic_timer_tests, frequency_hz: 50, repetitions: 42, policy: RR}]\n"
        "until: {deadline: 10s, probability: 0.05, at_most: 1h, boots: 3}\n"
    )
    process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], env=os.environ)
    while not closed():
        assert process.poll() is None
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert main(words) == 0
    assert capsys.readouterr().err.count("restarting the target") == 1, "the killed runner's board was another boot"
    assert len({json.loads(path.read_text())["target"]["boot_id"] for path in closed()}) == 3
    assert len(closed()) == 3
    assert answers(capsys) == {"001": "PROVEN"}
    assert main(["gate", "results/goal"]) == 1, "a virtual machine"
    assert main(["gate", "results/goal", "--platform", "virtual"]) == 0


@pytest.mark.usefixtures("target")
def test_one_group_is_refuted_and_the_other_runs_out_of_time(capsys):
    """No message and no timer of this board is within 10 us. That more than nine of ten are late takes 120 values.

    Of the timer there is one a run, which takes more than two seconds: too few in the time. It also has to hold the
    start of the board.
    """
    words = write_campaign(
        "common: {frequency_hz: 20, policy: RR}\n"
        "runs: [{suite: communication_tests, repetitions: 62}, {suite: cyclic_timer_tests, repetitions: 3}]\n"
        "until: {deadline: 10us, probability: 0.9, at_most: 4min}\n"
    )
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "REFUTED" in out and "NEEDS MORE" in out
    assert answers(capsys) == {"001": "REFUTED", "002": "NEEDS MORE"}
    names = [path.parent.name[:3] for path in closed()]
    assert names.count("002") > names.count("001"), "the time of the group with its answer went to the other one"
    assert main(["gate", "results/goal"]) == 1
