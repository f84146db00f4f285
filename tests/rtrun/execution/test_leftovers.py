"""What an earlier call left of a run on the target: when it is picked up, and when it is not."""

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path, PurePosixPath
from types import SimpleNamespace

import pytest

from rtrun.execution import resumption
from rtrun.plan.program import Program
from rtrun.targets import connection, deploy, processes
from rtrun.targets.connection import Connection
from rtrun.targets.errors import TargetError

pytestmark = pytest.mark.sshd


@pytest.fixture
def folder(target):
    return Path(target.work_dir) / "runs" / "campaign" / "run"


@pytest.fixture
def begin(link, folder):
    """Begin the run of a suite with one program, and let these programs be started on this boot."""

    def begin(*started):
        script = folder.parents[2] / "state.sh"
        script.parent.mkdir(parents=True, exist_ok=True)
        script.write_text("echo == host; echo board")
        resumption.begin(
            link,
            PurePosixPath(folder),
            start_time="2026-01-01T00:00:00+00:00",
            service="17",
            own_service=True,
            argv={"suite": ["suite", "-r", "10"]},
            state_script=PurePosixPath(script),
        )
        for name in started:
            (folder / f"{name}.boot_id").write_text(f"{link.boot_id}\n")

    return begin


@pytest.fixture
def inspect(link, folder):
    return lambda: resumption.inspect_leftovers(link, PurePosixPath(folder), ["suite"], ["sampler", "load"])


def test_nothing_is_left(inspect):
    leftovers = inspect()
    assert not leftovers.started and not leftovers.cut_off and not leftovers.can_be_picked_up(["suite"], None)


def test_a_run_that_measures_is_picked_up(begin, inspect):
    begin("sampler", "suite")
    leftovers = inspect()
    assert leftovers.started == {"sampler", "suite"}
    attempt = leftovers.attempt
    assert attempt.argv == {"suite": ["suite", "-r", "10"]} and attempt.before.host == "board"
    assert leftovers.can_be_picked_up(["suite"], None)
    assert leftovers.can_be_picked_up(["suite"], SimpleNamespace(attempt="an earlier one"))
    assert not leftovers.can_be_picked_up(["suite"], SimpleNamespace(attempt=attempt.uid)), "it was closed"
    assert not replace(leftovers, given_up=True).can_be_picked_up(["suite"], None)


def test_a_run_whose_loads_were_started_only_is_not(begin, inspect):
    begin("sampler", "load")
    leftovers = inspect()
    assert leftovers.attempt is not None and not leftovers.can_be_picked_up(["suite"], None)


def test_a_run_that_a_restart_cut_off_is_not(begin, inspect, folder):
    begin("suite")
    (folder / "sampler.boot_id").write_text("11111111-2222-3333-4444-555555555555\n")
    leftovers = inspect()
    assert leftovers.cut_off and not leftovers.can_be_picked_up(["suite"], None)


def test_a_run_that_was_given_up_is_not(begin, inspect, folder):
    begin("suite")
    (folder / "given_up").touch()
    assert not inspect().can_be_picked_up(["suite"], None)


def test_an_attempt_larger_than_believable_is_not_read(begin, inspect, monkeypatch):
    begin("suite")
    monkeypatch.setattr(resumption, "LIMIT_BYTES", 100)
    assert inspect().attempt is None


def test_what_lies_beside_it_is_not_read(begin, inspect, link, folder, monkeypatch):
    """Of a million folders and files the names alone would be more than a command may print; here of fewer."""
    monkeypatch.setattr(connection, "OUTPUT_BYTES_MAX", 100_000)
    begin()
    name = "x" * 240
    for number in range(500):
        (folder.parent / f"{name}{number}").mkdir()
        (folder / f"{name}{number}.lock").touch()
    campaign, remote = PurePosixPath(folder.parent), PurePosixPath(folder)
    assert not resumption.may_run_go_on(link, campaign, ["gone", "run"])
    suite = Program(name="suite", argv=("sleep", "300"), deadline_s=300)
    processes.start(link, PurePosixPath(deploy.ON_TARGET), remote, suite)
    for number in range(500):
        (folder / f"{name}{number}.boot_id").write_text("another\n")
    assert resumption.list_folders(link, campaign, ["gone", "run"]) == ["run"]
    assert resumption.may_run_go_on(link, campaign, ["gone", "run"])
    assert inspect().can_be_picked_up(["suite"], None)
    # Its group is told once it has joined that.
    while "kill --" not in (message := busy(link)):
        assert f"another run is still going on: {folder}/suite; " in message
    assert re.search(r"kill -- -[0-9]+$", message)
    processes.give_up(link, remote)
    resumption.check_idle(link)
    assert not folder.exists()


def busy(link):
    """Why the target is not idle."""
    with pytest.raises(TargetError) as caught:
        resumption.check_idle(link)
    return str(caught.value)


def test_a_build_of_suites_is_no_idle_target(target, link):
    """It would be measured beside compilers, and its programs would be replaced by what was built."""
    folder = PurePosixPath(target.work_dir) / "building"
    link.check(["mkdir", "-p", str(folder)])
    build = Program(name="build", argv=("sleep", "300"), deadline_s=300)
    processes.start(link, PurePosixPath(deploy.ON_TARGET), folder, build)
    with pytest.raises(TargetError, match=f"a build of suites is still going on: {folder}/build; wait for it"):
        resumption.check_idle(link)
    processes.give_up(link, folder)
    resumption.check_idle(link)


def test_a_program_of_another_user_is_seen(link):
    """Its open files are not."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    remote = PurePosixPath(tempfile.mkdtemp()) / "runs/campaign/run"
    Path(remote).mkdir(parents=True)
    Path(remote.parents[2]).chmod(0o755)
    command = ["setpriv", "--reuid=65534", "--clear-groups", "sh", "-c", resumption._BUSY, "sh", str(remote.parents[1])]

    def seen():
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()

    suite = Program(name="suite", argv=("sleep", "300"), deadline_s=300)
    processes.start(link, PurePosixPath(deploy.ON_TARGET), remote, suite)
    assert seen() == [f"{remote}/suite"]
    processes.end(link, remote, "suite")
    assert seen() == []
    shutil.rmtree(remote.parents[2])


def test_half_an_attempt_is_none(begin, folder, monkeypatch):
    """A link that is lost ends the input of the command early."""
    real = Connection.check

    def losing(self, argv, *, stdin="", **more):
        return real(self, argv, stdin=stdin[:-1], **more)

    monkeypatch.setattr(Connection, "check", losing)
    with pytest.raises(TargetError):
        begin()
    assert not (folder / "attempt.json").exists()
