"""One campaign on several boards, each behind an sshd of its own; the suite goes wrong on request."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from faulty import lost, write_faulty_suites

from conftest import serve
from rtfiles.errors import InfrastructureError
from rtrun.cli import main
from rtrun.results.journal import Journal
from rtrun.results.record import verify

pytestmark = [pytest.mark.sshd, pytest.mark.ros]
RESULTS = Path("results/test")


class Board:
    """A board of the farm: its sshd, what its programs shall do and have done, its target file."""

    def __init__(self, folder, sshd, ros_master):
        self.sshd = sshd
        self.name = folder.name
        self.wishes = write_faulty_suites(folder / "suites")
        self.work_dir = folder / "target"
        self.file = folder / "target.yml"
        self.file.write_text(
            f"schema: 1\nname: {self.name}\nkind: ssh\nhost: 127.0.0.1\nport: {sshd.port}\nuser: {sshd.user}\n"
            f"key: {sshd.key}\nhost_key: {sshd.host_key}\nsuites: suites\nwork_dir: {self.work_dir}\n"
            f"ros_master_port: {ros_master}\nreconnect_s: 1\n"
        )

    def vanish(self):
        """Break all connections forever."""
        children = Path(f"/proc/{self.sshd.process.pid}/task/{self.sshd.process.pid}/children").read_text().split()
        self.sshd.process.kill()
        subprocess.run(["kill", "-9", *children], check=False)

    def end_programs(self):
        """End what a board that vanished went on with."""
        for pid in self.work_dir.glob("runs/*/*/*.pid"):
            with contextlib.suppress(ProcessLookupError, ValueError):
                os.killpg(int(pid.read_text()), signal.SIGKILL)


@pytest.fixture
def farm(tmp_path, ros_master, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = [tmp_path / name for name in ("left", "right")]
    for folder in folders:
        folder.mkdir()
    with serve(folders[0]) as first, serve(folders[1]) as second:
        boards = [Board(folder, sshd, ros_master) for folder, sshd in zip(folders, (first, second), strict=True)]
        yield boards
        for board in boards:
            board.end_programs()


def command(farm, text):
    Path("campaign.yml").write_text("schema: 1\nname: test\n" + text)
    return ["run", "campaign.yml", *(word for board in farm for word in ("--target", str(board.file)))]


def let_both_begin(left, right):
    """Let the first run of each board wait until the other board has begun one: neither is too late for its part."""
    left.wishes.will(f"await {right.wishes.journal}")
    right.wishes.will(f"await {left.wishes.journal}")


def let_right_hang(left, right):
    """Let the first run on the right end never, and that on the left when the right one has begun."""
    left.wishes.will(f"await {right.wishes.journal}")
    right.wishes.will("await /nonexistent")


def closed():
    return {path.parent.name: json.loads(path.read_text()) for path in RESULTS.glob("[0-9]*/run.json")}


def calls(farm):
    return sorted(call for board in farm for call in board.wishes.calls())


def test_boards_share_a_campaign(farm, capsys):
    words = command(
        farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101], repeats: 3}]\n"
    )
    let_both_begin(*farm)
    assert main(words) == 0
    records = closed()
    assert len(records) == len(calls(farm)) == 6
    assert {record["target"]["name"] for record in records.values()} == {"left", "right"}
    by_repeat = {}
    for record in records.values():
        by_repeat.setdefault(record["repeat"], set()).add(record["target"]["name"])
    assert all(len(names) == 1 for names in by_repeat.values()), "what is compared is measured on one board"
    out = capsys.readouterr().out
    assert out.count("ok         left ") + out.count("ok         right ") == 6
    assert not list(farm[0].work_dir.glob("runs/*")) and not list(farm[1].work_dir.glob("runs/*"))
    assert main(words) == 0 and "all 6 runs are finished" in capsys.readouterr().err


def test_a_board_that_vanishes_does_not_stop_the_other(farm, capsys):
    left, right = farm
    words = command(farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101, 102, 103]}]\n")
    let_right_hang(left, right)
    process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], stderr=subprocess.PIPE, text=True)
    right.wishes.await_calls()
    right.vanish()
    assert process.wait(120) == 0
    assert "rtrun: right: " in (err := process.stderr.read()) and "the other boards measure what it leaves" in err
    assert {record["target"]["name"] for record in closed().values()} == {"left"} and len(closed()) == 4
    assert len(left.wishes.calls()) == 4
    # Whether its link was lost or it hung, nobody knows.
    (attempt,) = lost(RESULTS)
    assert attempt.endswith(": begun and never closed")


def test_a_runner_that_is_killed_again_and_again_loses_no_run_and_measures_none_twice(farm):
    words = command(
        farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101, 102, 103, 104, 105]}]\n"
    )
    for number in range(3):
        # The first new run of each board goes on until the runner is killed.
        gate = Path(f"gate{number}").absolute()
        for board in farm:
            board.wishes.will(f"await {gate}")
        process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], stderr=subprocess.DEVNULL)
        while len(calls(farm)) < 2 * (number + 1):
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
        gate.touch()
    assert main(words) == 0
    assert [call.split()[1] for call in calls(farm)] == [str(100 + number) for number in range(6)]
    assert all(verify(RESULTS / name).status == "ok" for name in closed()) and len(closed()) == 6
    assert not [left for board in farm for left in board.work_dir.glob("runs/*")]


def test_what_a_board_had_begun_when_it_vanished_is_cleared_when_it_comes_back(farm, ros_master, tmp_path):
    right = farm[1]
    words = command(farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101]}]\n")
    let_right_hang(*farm)
    process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], stderr=subprocess.DEVNULL)
    right.wishes.await_calls()
    right.vanish()
    assert process.wait(120) == 0
    (begun,) = right.work_dir.glob("runs/*/*")
    (tmp_path / "again").mkdir()
    with serve(tmp_path / "again") as sshd:
        text = right.file.read_text().replace(f"port: {right.sshd.port}", f"port: {sshd.port}")
        right.file.write_text(
            text.replace(str(right.sshd.key), str(sshd.key)).replace(right.sshd.host_key, sshd.host_key)
        )
        (RESULTS / begun.name / "run.json").rename(RESULTS / "run.json")
        other = next(name for name in closed())
        (RESULTS / other / "run.json").unlink()
        (RESULTS / "run.json").rename(RESULTS / begun.name / "run.json")
        assert main(["run", "campaign.yml", "--target", str(right.file)]) == 0
    assert closed()[begun.name]["target"]["name"] == "left" and closed()[other]["target"]["name"] == "right"
    assert not list(right.work_dir.glob("runs/*"))


def begun_on_all(farm):
    """The words of a campaign, and the rtrun that measures it, once each board has a run that goes on for ever."""
    words = command(farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101]}]\n")
    for board in farm:
        board.wishes.will("await /nonexistent")
    process = subprocess.Popen([sys.executable, "-m", "rtrun.cli", *words], stderr=subprocess.PIPE, text=True)
    for board in farm:
        board.wishes.await_calls()
    return words, process


def test_ctrl_c_leaves_nothing_on_any_board(farm):
    _, process = begun_on_all(farm)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130, process.stderr.read()
    assert not [left for board in farm for left in board.work_dir.glob("runs/*/*")]
    assert closed() == {}


@pytest.mark.root
def test_what_ctrl_c_cannot_remove_is_said(farm):
    words, process = begun_on_all(farm)
    (folder,) = farm[0].work_dir.glob("runs/*/*")
    mounted = folder / "mounted"
    mounted.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", mounted], check=True)
    try:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        subprocess.run(["umount", mounted], check=True)
    assert process.returncode == 130
    assert f"{folder.name} was given up, and {folder} stays on the target: " in err and "mounted" in err
    assert not list(farm[1].work_dir.glob("runs/*/*"))
    assert main(words) == 0
    assert not list(farm[0].work_dir.glob("runs/*"))


@pytest.mark.root
def test_a_run_that_is_closed_is_not_measured_again_where_its_board_fails_after_that(farm, capsys):
    """Its folder on the target cannot be removed."""
    left, right = farm
    words = command(farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101, 102]}]\n")
    let_both_begin(left, right)
    left.wishes.will("busy")
    try:
        assert main(words) == 0
        assert "the other boards measure what it leaves" in capsys.readouterr().err
        assert len(calls(farm)) == len(closed()) == 3 and not list(RESULTS.glob("*.old-*"))
    finally:
        for mounted in left.work_dir.glob("runs/*/*/mounted"):
            subprocess.run(["umount", mounted], check=True)


@pytest.mark.parametrize("state", ["measuring", "ended", "closed"])
def test_where_this_machine_cannot_keep_a_run_no_other_board_measures_it(farm, state, capsys, monkeypatch):
    """As when the disk of the results is full: that is no failure of a board."""
    words = command(farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101, 102, 103]}]\n")
    let_both_begin(*farm)
    note, failed = Journal.note, []

    def fail_once(journal, time, run, what, reason=None):
        if what == state and not failed:
            failed.append(run)
            raise InfrastructureError("journal.sqlite: cannot keep the results: disk full")
        note(journal, time, run, what, reason)

    monkeypatch.setattr(Journal, "note", fail_once)
    assert main(words) == 3
    assert "cannot keep the results" in capsys.readouterr().err
    assert main(words) == 0
    assert len(calls(farm)) == len(closed()) == 4 and not list(RESULTS.glob("*.old-*"))


def test_no_board_is_left(farm, capsys):
    words = command(farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: [100, 101]}]\n")
    for board in farm:
        board.vanish()
    assert main(words) == 3
    err = capsys.readouterr().err
    # Once each, and nobody measures what they leave.
    assert err.count("rtrun: left: ") == err.count("rtrun: right: ") == 1 and "the other boards" not in err


def test_a_goal_is_reached_by_all_boards_together(farm, capsys):
    words = command(
        farm,
        "order: interleaved\nseed: 3\nruns: [{suite: cyclic_timer_tests, frequency_hz: 100, repetitions: 42}]\n"
        "until: {deadline: 10s, probability: 0.05, at_most: 1h}\n",
    )
    let_both_begin(*farm)
    assert main(words) == 0
    names = [record["target"]["name"] for record in closed().values()]
    assert set(names) == {"left", "right"}
    assert "PROVEN" in capsys.readouterr().out
    # At least 40 measurements a run; 119 on two boots without a miss prove it, and the other board may have one more
    # run under way.
    assert len(names) <= 5


def test_two_boards_of_one_name_and_a_board_that_has_no_part_in_the_folder(farm, capsys):
    words = command(farm, "runs: [{suite: cyclic_timer_tests, repetitions: 10, frequency_hz: 100}]\n")
    assert main([*words, "--target", str(farm[0].file)]) == 2
    assert "a second target called left" in capsys.readouterr().err
    assert main(words) == 0
    other = farm[0].file.with_name("other.yml")
    other.write_text(farm[0].file.read_text().replace("name: left", "name: other"))
    assert main([*words[:2], "--target", str(other)]) == 2
    assert "holds runs on the target left, right, not other" in capsys.readouterr().err
