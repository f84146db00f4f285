"""Campaigns on a target behind a real sshd with a real ROS master; the suite is one that goes wrong on request."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest
from faulty import measure, record, runs_of, write_files

from conftest import seeing, serve
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.cli import main
from rtrun.execution import campaign_runner, preparation
from rtrun.execution.middleware import roscpp
from rtrun.execution.subjects import suite
from rtrun.plan.campaign import Campaign, plan
from rtrun.results.reading import read_run
from rtrun.targets.errors import TargetError, TargetGone
from rtrun.targets.link import Link
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros]


@pytest.fixture
def watching():
    return Watching()


@pytest.fixture
def target(ready_target):
    return ready_target


def master_is_gone(target):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", target.master_port)) != 0


def test_a_campaign_from_end_to_end(bare_target, tmp_path, watching, wishes):
    runs = runs_of(2)
    statuses = measure(bare_target, runs, tmp_path / "results", watching)
    assert statuses == ["ok", "ok"]
    folder = tmp_path / "results" / runs[0].name
    written = record(tmp_path / "results", runs[0])
    assert set(written["files"]) == {path.name for path in folder.iterdir()} - {"run.json"}
    assert {"cyclic_timer_tests.stdout", "cyclic_timer_tests_l10_fq100.npy", "target.json"} <= set(written["files"])
    configurations = [Path("/proc/config.gz"), Path(f"/boot/config-{os.uname().release}")]
    assert ("kernel.config.gz" in written["files"]) == any(path.exists() for path in configurations)
    assert (folder / "cyclic_timer_tests.stdout").read_text() == "\tINFO: done\n"
    state = json.loads((folder / "target.json").read_text())
    assert state["before"]["boot_id"] == Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    assert state["own_service"] is True
    assert written["target"]["kernel_release"] == os.uname().release
    (program,) = written["programs"]
    own = {line.split(":", 2)[2] for line in Path("/proc/self/cgroup").read_text().splitlines()}
    assert {group["path"] for group in program["control_groups"]} & own
    assert all(group.get("before") and group.get("after") for group in program["control_groups"] if "quota_us" in group)
    assert master_is_gone(bare_target), "a master that the runner started is ended"
    assert list((Path(bare_target.work_dir) / "runs").rglob("*.npy")) == [], "nothing stays on the bare_target"


def test_finished_runs_are_not_measured_again(target, tmp_path, watching, wishes):
    runs = runs_of(3)
    wishes.will("ok", "fail")
    assert measure(target, runs, tmp_path / "results", watching) == ["ok", "failed", "ok"]
    assert measure(target, runs, tmp_path / "results", watching) == ["ok", "ok", "ok"]
    assert len(wishes.calls()) == 4
    assert any("2 of 3 runs are finished" in note for note in watching.notes)
    assert (tmp_path / "results" / f"{runs[1].name}.old-1" / "run.json").exists(), "the failed run is kept beside it"


# What the suite does wrong, and what becomes of its run; {output} is the name of what it writes.
WRONG = {
    "fail": ("failed", "exit status 1: ERROR: cannot set RR priority 95: CAP_SYS_NICE is missing"),
    "silent": ("failed", "{output}.json is missing though"),
    "killed": ("failed", "cyclic_timer_tests ended with exit status 137"),
    "incomplete": ("incomplete", "the publisher ended"),
    "junk json": ("failed", "{output}.json: not JSON that is read here"),
    "deep json": ("failed", "{output}.json: not JSON that is read here"),
    "digits": ("failed", "{output}.json: not JSON that is read here"),
    "surrogate": ("failed", "{output}.json: not JSON that is read here"),
    "link": ("failed", "{output}.json is missing"),
    "huge json": ("failed", "{output}.json has 1073741824 bytes, at most 16777216 were expected: it was not taken"),
    "huge.log": ("failed", "{output}.log has 134217728 bytes, at most 67108864 were expected: it was not taken"),
    "truncated": ("invalid", "{output}.npy"),
    "misheard": ("invalid", "asked for repetitions 10, the suite measured repetitions 11"),
    "miscounted": ("invalid", "10 asked for, but 11 measured + not fired + missing"),
    "commands": ("failed", "kept as {output}.log.refused: {output}.log:1: no log of a suite: no suite writes the"),
}


@pytest.fixture
def two_ros2(ready_target, tmp_path):
    """The target, with two ROS 2 below /opt/ros, and its file selects none."""
    setups = []
    for distro in ("humble", "jazzy"):
        library = tmp_path / "opt" / "ros" / distro / "lib" / "librcl.so"
        library.parent.mkdir(parents=True)
        library.touch()
        setups.append(library.parents[1] / "setup.sh")
        setups[-1].touch()
    (tmp_path / "sshd").mkdir()
    with serve(tmp_path / "sshd", seeing({"/opt": tmp_path / "opt"})) as server:
        yield replace(ready_target, address=server.address)


def test_several_ros2_stop_only_what_needs_one(two_ros2, tmp_path, watching):
    runs = runs_of(1, middleware=["roscpp", "rcl"])
    several = "several ROS (/opt/ros/humble/setup.sh, /opt/ros/jazzy/setup.sh): put one into the target file as"
    assert measure(two_ros2, runs, tmp_path / "results", watching) == ["ok", "incomplete"]
    assert several in watching.ends[-1][1]
    with pytest.raises(TargetError, match="several ROS"):
        measure(two_ros2, runs[1:], tmp_path / "alone", watching)


def test_runs_that_go_wrong_are_closed_with_the_reason_and_the_campaign_goes_on(target, tmp_path, watching, wishes):
    wishes.will(*WRONG)
    runs = runs_of(len(WRONG) + 1)
    statuses = measure(target, runs, tmp_path / "results", watching)
    assert statuses == [*(status for status, _ in WRONG.values()), "ok"]
    for run, (status, reason) in zip(runs, WRONG.values(), strict=False):
        output = f"cyclic_timer_tests_l10_fq{run.parameters['frequency_hz']}"
        written = record(tmp_path / "results", run)
        assert written["status"] == status and reason.format(output=output) in written["reason"], written["reason"]
    # The log with commands, the last one, is there under another name alone.
    assert f"{output}.log" not in written["files"] and f"{output}.log.refused" in written["files"]
    assert written["reason"] == written["refused"][f"{output}.log"]


@pytest.mark.trace
def test_a_trace_that_is_too_large_is_named_and_costs_the_run_nothing(target, tmp_path, watching, wishes):
    wishes.will("huge-trace-1.txt")
    (run,) = runs = runs_of(1, trace={"above": "50us"})
    assert measure(target, runs, tmp_path / "results", watching) == ["ok"]
    written = record(tmp_path / "results", run)
    name = "cyclic_timer_tests_l10_fq100-trace-1.txt"
    assert name not in written["files"]
    assert written["refused"] == {name: f"{name} has 134217728 bytes, at most 67108864 were expected: it was not taken"}


@pytest.mark.root
def test_programs_of_2014_write_logs_only(target, tmp_path, watching, wishes):
    wishes.will("2014", "2014")
    runs = runs_of(1, repetitions=300, frequency_hz=1000, policy=["0", "RR"])
    assert measure(target, runs, tmp_path / "results", watching) == ["ok", "invalid"]
    assert {
        name for name in record(tmp_path / "results", runs[0])["files"] if name.startswith("cyclic_timer_tests_l")
    } == {"cyclic_timer_tests_l300_fq1000.log"}
    (row,) = read_run(tmp_path / "results" / runs[0].name).results
    assert row.figures.n + len(row.header.startup) == 300
    reason = record(tmp_path / "results", runs[1])["reason"]
    # They have no json that says so either. The run is short: whether anybody sees its threads is chance.
    assert reason.startswith(("nobody saw RR 95 in effect", "asked for RR 95, in effect was")), reason


@pytest.mark.parametrize("option", [{"clock": "monotonic"}, {"rt_scope": "measuring-thread"}])
def test_an_option_that_programs_of_2014_ignore_makes_the_run_invalid(target, tmp_path, watching, wishes, option):
    wishes.will("2014")
    (run,) = runs = runs_of(1, repetitions=300, frequency_hz=1000, **option)
    assert measure(target, runs, tmp_path / "results", watching) == ["invalid"]
    assert "but nobody can see it in effect" in record(tmp_path / "results", run)["reason"]


def test_a_suite_that_hangs_is_ended_by_the_target(target, tmp_path, watching, wishes, monkeypatch):
    monkeypatch.setattr(suite, "DEADLINE_EXTRA_S", 8.0)
    wishes.will("sleep 300")
    statuses = measure(target, runs_of(2), tmp_path / "results", watching)
    assert statuses == ["failed", "ok"]
    assert "did not end within" in watching.ends[0][1]


def test_a_link_cut_in_the_middle_costs_nothing(target, tmp_path, watching, wishes, monkeypatch):
    seen = []
    real = Link.__enter__

    def remembering(self):
        seen.append(self)
        return real(self)

    monkeypatch.setattr(Link, "__enter__", remembering)
    wishes.will("sleep 2")
    cut = threading.Timer(1.2, lambda: seen[0]._connection.shell.stream.shut_down())
    watching.at_start = lambda number: cut.start() if number == 0 else None
    assert measure(target, runs_of(2), tmp_path / "results", watching) == ["ok", "ok"]
    assert len(wishes.calls()) == 2
    assert any("connection broke" in note for note in watching.notes)


def test_a_target_that_stays_away_is_an_error_and_finished_runs_stay(target, tmp_path, watching, wishes):
    away = threading.Event()
    target = replace(target, failure=lambda: TargetGone("the board was switched off") if away.is_set() else None)
    with Link(target, watching.notes.append):
        pass
    runs = runs_of(2)

    def switch_off(number):
        if number == 1:
            away.set()
            raise TargetGone("the board was switched off")

    watching.at_start = switch_off
    with pytest.raises(TargetGone, match="switched off"):
        measure(target, runs, tmp_path / "results", watching)
    assert campaign_runner.count_finished(tmp_path / "results", runs) == 1


def test_a_changed_campaign_is_not_mixed_with_the_old_one(target, tmp_path, watching, wishes):
    measure(target, runs_of(1), tmp_path / "results", watching)
    with pytest.raises(UsageError, match="holds another campaign"):
        measure(target, runs_of(2), tmp_path / "results", watching)


def test_a_master_that_is_there_is_used_and_left_alone(target, tmp_path, watching):
    runs = runs_of(1)
    assert measure(target, runs, tmp_path / "results", watching) == ["ok"]
    state = json.loads((tmp_path / "results" / runs[0].name / "target.json").read_text())
    assert state["own_service"] is False
    with Link(target, watching.notes.append) as link:
        assert roscpp.ask_pid(link) is not None


def test_a_port_that_is_no_master(bare_target, tmp_path, watching, wishes, monkeypatch):
    monkeypatch.setattr(roscpp, "START_S", 3.0)
    with socket.create_server(("127.0.0.1", bare_target.master_port)) as server:
        threading.Thread(target=answer_junk, args=(server,), daemon=True).start()
        with pytest.raises(TargetError, match="taken by a program that does not answer as a ROS master"):
            measure(bare_target, runs_of(1), tmp_path / "results", watching)


def test_a_board_that_is_slow_to_boot_is_slow_to_start_a_master(bare_target, tmp_path, watching, wishes, monkeypatch):
    monkeypatch.setattr(roscpp, "START_S", 0.0)
    target = replace(bare_target, boot_s=60)
    assert measure(target, runs_of(1), tmp_path / "results", watching) == ["ok"]


def answer_junk(server):
    while True:
        try:
            link, _ = server.accept()
        except OSError:
            return
        link.sendall(b"220 mail ready\r\n")
        link.close()


def test_a_master_that_dies_in_the_middle_of_a_run(bare_target, tmp_path, watching, wishes):
    wishes.will("ok", "sleep 3")
    runs = runs_of(3)

    def kill_the_master(number):
        if number == 1:
            (pid,) = Path(bare_target.work_dir).glob("master/*/rosmaster.pid")
            threading.Thread(target=kill_it, args=(int(pid.read_text()),)).start()

    def kill_it(pid):
        wishes.await_calls(2)
        os.killpg(pid, signal.SIGKILL)

    watching.at_start = kill_the_master
    with pytest.raises(TargetError, match="the ROS master died"):
        measure(bare_target, runs, tmp_path / "results", watching)
    assert record(tmp_path / "results", runs[0])["status"] == "ok"
    assert record(tmp_path / "results", runs[1])["reason"].startswith("the ROS master died during the run")
    watching.at_start = lambda number: None
    assert measure(bare_target, runs, tmp_path / "results", watching) == ["ok", "ok", "ok"]


@pytest.fixture
def without_ros(bare_target, wishes, monkeypatch):
    """A target that has nothing of any middleware."""
    real = preparation.inspection.inspect
    monkeypatch.setattr(preparation.inspection, "inspect", lambda *words: replace(real(*words), middlewares={}))
    return bare_target


def test_no_ros_on_the_target(without_ros, tmp_path, watching):
    with pytest.raises(TargetError, match="no ROS on the target"):
        measure(without_ros, runs_of(1), tmp_path / "results", watching)


@pytest.mark.root
def test_what_needs_no_ros_is_measured_without(without_ros, tmp_path, watching):
    baseline = {"suite": "cyclictest", "repetitions": 100}
    (alone,) = plan(Campaign(schema=1, name="test", runs=[baseline]), "test")
    assert measure(without_ros, [alone], tmp_path / "alone", watching) == ["ok"]
    assert record(tmp_path / "alone", alone)["target"].get("setup") is None
    assert not list(Path(without_ros.work_dir).glob("master/*"))
    both = plan(Campaign(schema=1, name="test", runs=[{"suite": "cyclic_timer_tests"}, baseline]), "test")
    assert measure(without_ros, both, tmp_path / "both", watching) == ["incomplete", "ok"]
    assert "no ROS on the target" in watching.ends[-2][1]


def test_a_suite_that_is_not_on_the_target(target, tmp_path, watching):
    with pytest.raises(TargetError, match="cyclic_timer_tests is not installed on the target"):
        measure(replace(target, suites=None), runs_of(1), tmp_path / "results", watching)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MiB, for what a full disk does."""
    folder = tmp_path / "small"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m,mode=755", "tmpfs", folder], check=True)
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


@pytest.mark.root
def test_a_full_disk_on_the_target(target, tmp_path, watching, wishes, small_disk):
    target = replace(target, work_dir=PurePosixPath(small_disk))
    (target.suites / "lib" / "large").write_bytes(os.urandom(2_000_000))
    with pytest.raises(TargetError, match=r"cannot write .*disk is full"):
        measure(target, runs_of(1), tmp_path / "results", watching)


@pytest.mark.root
def test_a_disk_of_the_target_that_is_full_when_the_suite_ends(target, tmp_path, watching, wishes, small_disk):
    """The run is whole: that its exit status finds no room must not have it measured again."""
    target = replace(target, work_dir=PurePosixPath(small_disk))
    wishes.will("full")
    assert measure(target, runs_of(1), tmp_path / "results", watching) == ["ok"], watching.ends


# The program writes so little that the last block takes most of a minute to fill.
@pytest.mark.root
@pytest.mark.parametrize("sampler", ["script", pytest.param("program", marks=pytest.mark.slow)])
def test_a_disk_of_the_target_that_is_full_while_the_suite_runs(
    request, target, tmp_path, watching, wishes, small_disk, sampler
):
    if sampler == "program":
        folder = Path(target.suites) / "lib/rt_tests_sampler"
        folder.mkdir()
        shutil.copy(request.getfixturevalue("sampler_program"), folder)
    # Of small blocks: in one of a tmpfs many observations have room.
    subprocess.run(["umount", small_disk], check=True)
    (tmp_path / "image").write_bytes(bytes(2**20))
    subprocess.run(["mkfs.ext2", "-q", "-b", "1024", "-m", "0", "-N", "128", tmp_path / "image"], check=True)
    subprocess.run(["mount", "-o", "loop", tmp_path / "image", small_disk], check=True)
    (small_disk / "lost+found").rmdir()
    wishes.will("full for long")
    runs = runs_of(1)
    measure(replace(target, work_dir=PurePosixPath(small_disk)), runs, tmp_path / "results", watching)
    written = record(tmp_path / "results", runs[0])
    reason = "nobody saw what was in effect to the end: the disk of the target was full (df -h)"
    assert (written["status"], written["reason"]) == ("invalid", reason)
    assert written["in_effect"]["observations"] > 0


@pytest.mark.root
def test_a_full_disk_here(target, tmp_path, watching, wishes, small_disk):
    runs = runs_of(2)

    def fill(number):
        if number == 1:
            (small_disk / "ballast").write_bytes(b"x" * (os.statvfs(small_disk).f_bavail * 4096))

    watching.at_start = fill
    with pytest.raises(InfrastructureError, match=r"cannot keep the results: No space left on device|disk is full"):
        measure(target, runs, small_disk / "results", watching)
    assert campaign_runner.count_finished(small_disk / "results", runs) == 1


def rtrun(tmp_path, words):
    return subprocess.Popen(
        [sys.executable, "-m", "rtrun.cli", *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt(bare_target, tmp_path, wishes, number):
    words = write_files(tmp_path, bare_target, 3)
    wishes.will("ok", "sleep 100")
    runner = rtrun(tmp_path, words)
    while len(wishes.calls()) < 2:
        assert runner.poll() is None
        time.sleep(0.05)
    runner.send_signal(number)
    out, err = runner.communicate(timeout=240)
    assert runner.returncode == 130
    assert "1 of 3 runs are finished and kept in results/test; the same command goes on there" in out
    assert err.splitlines()[-1] == "rtrun: interrupted"
    assert master_is_gone(bare_target)
    assert rtrun(tmp_path, words).wait(240) == 0
    assert [call.split()[1] for call in wishes.calls()] == ["100", "101", "101", "102"]


def test_a_killed_runner_finds_its_run_again(bare_target, tmp_path, wishes):
    words = write_files(tmp_path, bare_target, 2)
    wishes.will("sleep 3")
    runner = rtrun(tmp_path, words)
    while len(wishes.calls()) < 1:
        assert runner.poll() is None
        time.sleep(0.05)
    runner.kill()
    runner.communicate()
    second = rtrun(tmp_path, words)
    _, err = second.communicate(timeout=240)
    assert second.returncode == 0, err
    assert len(wishes.calls()) == 2, "the run that was going on is picked up, not repeated"
    assert master_is_gone(bare_target)


def test_a_campaign_goes_on_without_a_reader(bare_target, tmp_path, wishes):
    words = write_files(tmp_path, bare_target, 3)
    runner = rtrun(tmp_path, words)
    assert runner.stdout.readline()
    runner.stdout.close()
    assert runner.wait(timeout=240) == 0
    assert len(wishes.calls()) == 3


def test_exit_status_of_failed_runs_and_of_a_finished_campaign(target, tmp_path, wishes, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = write_files(tmp_path, target, 1)
    wishes.will("fail")
    assert main(words) == 3
    out = capsys.readouterr().out
    assert "CAP_SYS_NICE is missing" in out and "next:" not in out
    assert main(words) == 0
    assert re.search(r"^next: \S*rtrun report results/test$", capsys.readouterr().out, re.M)
    assert main(words) == 0
    assert "all 1 runs are finished" in capsys.readouterr().err
    assert len(wishes.calls()) == 2
    assert main([*words, "--fresh"]) == 0
    assert (tmp_path / "results" / "test-2").is_dir() and len(wishes.calls()) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema: 1\nname: x\nkind: telnet\n", "target.yml:3: kind: unknown kind 'telnet', allowed: ssh, qemu"),
        (
            "schema: 1\nname: x\nkind: ssh\nhost: h\nkey: ~nosuchuser/x\n",
            "key: the user of '~nosuchuser' is unknown here",
        ),
        ('schema: 1\nname: x\nkind: ssh\nhost: h\nsuites: "a\\0"\n', "suites: a path holds printable characters"),
        ("schema: 1\nname: x\nkind: qemu\nboard: ~nosuchuser/x\n", "board: the user of '~nosuchuser' is unknown here"),
        ("schema: 1\nname: x\nkind: ssh\nhost: h\nkey: nowhere\n", "nowhere: No such file or directory: name the file"),
        ("schema: 1\nname: x\nkind: ssh\nhost: h\nkey: campaign.yml\n", "campaign.yml: is no private key that can be"),
        ("schema: 1\nname: x\nkind: ssh\nhost: h\nknown_hosts: nowhere\n", "nowhere: no such file: name one of host"),
        (
            "schema: 1\nname: x\nkind: ssh\nhost: h\nhost_key: SHA256:short\n",
            "target.yml:5: host_key: 'SHA256:short' is",
        ),
        ("schema: 1\nname: x\nkind: ssh\nhost: h\nport: 0\n", "target.yml:5: port: takes a number from 1 up, got 0"),
        (
            "schema: 1\nname: x\nkind: ssh\nhots: h\n",
            "target.yml:4: unknown key 'hots', did you mean 'host'? allowed: schema",
        ),
        (
            "schema: 1\nname: x\nkind: ssh\nhost: h\nwork_dir: /tmp/../../etc\n",
            "work_dir: '/tmp/../../etc' is not a whole path",
        ),
        ("schema: 1\nname: x\nkind: ssh\nhost: h\nwork_dir: /\n", "work_dir: '/' is not a whole path"),
        ("schema: 1\nname: x\nkind: qemu\nboard: nowhere\n", "no board there, make one: "),
        ("schema: 1\nname: x\nkind: local\nsuites: nowhere\n", "no such folder; suites are built with"),
    ],
)
def test_bad_target_files(tmp_path, text, message, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "target.yml").write_text(text)
    (tmp_path / "campaign.yml").write_text("schema: 1\nname: test\nruns: [{suite: cyclic_timer_tests}]\n")
    assert main(["run", "campaign.yml", "--target", "target.yml"]) == 2
    assert message in capsys.readouterr().err
