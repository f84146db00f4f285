"""Every gap between two steps of a run in which the runner or the link may stop: what is found there afterwards."""

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import time
from pathlib import Path, PurePosixPath

import faulty
import pytest
from faulty import lost, record, runs_of

from rtrun.execution import board, campaign_runner, planned_programs, resumption, run_execution
from rtrun.execution.middleware import roscpp
from rtrun.execution.middleware.known import SERVICES
from rtrun.execution.subjects import suite
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.program import Program
from rtrun.results import run_directory
from rtrun.targets import deploy, processes
from rtrun.targets.connection import Connection
from rtrun.targets.errors import ConnectionLost, DeadlineExpired, TargetError
from rtrun.targets.link import BREAKS_MAX, Link, TargetRebooted
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros]


class Stop(Exception):
    """The runner ends here, as kill -9 would end it."""


def stop(*_, **__):
    raise Stop


def close_and_stop(*args, close=run_directory.close):
    """Stand for `run_directory.close`, the real one of which is bound before it is replaced."""
    close(*args)
    raise Stop


@pytest.fixture
def target(ready_target):
    return ready_target


@pytest.fixture
def measure(tmp_path):
    return lambda target, runs, watching=None: faulty.measure(target, runs, tmp_path / "results", watching)


@pytest.fixture
def interrupt(monkeypatch, measure):
    """Measure until one step of the runner, which is replaced meanwhile, raises `error`."""

    def interrupt(target, runs, step, error, *, module=run_execution.processes, name="wait", match=None):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, step)
            with pytest.raises(error, match=match):
                measure(target, runs)

    return interrupt


def failing(wishes, error):
    """Stands in for the waiting: an error once the suite runs; a lost link stays lost."""

    def wait(link, *_, **__):
        wishes.await_calls()
        if isinstance(error, ConnectionLost):
            link._given_up = error
            link.drop()
        raise error

    return wait


def out_of_reach(wishes):
    return failing(wishes, ConnectionLost("gone"))


@pytest.mark.parametrize("end", [Stop, KeyboardInterrupt])
def test_after_the_sampler_was_ended(bare_target, tmp_path, wishes, measure, interrupt, end):
    """What we ended ourselves, sampler and ROS master, is not taken for dead."""
    runs = runs_of(1)

    def pull(*_, **__):
        raise end

    interrupt(bare_target, runs, pull, end, module=run_execution.download, name="pull")
    assert measure(bare_target, runs) == ["ok"]
    assert len(wishes.calls()) == 1
    assert lost(tmp_path / "results") == []


def test_an_error_of_ours_leaves_the_run_and_its_master_alone(bare_target, wishes, measure, interrupt):
    wishes.will("sleep 2")
    runs = runs_of(1)
    message = "cannot fork; the run goes on and is picked up by the next call"
    interrupt(bare_target, runs, failing(wishes, TargetError("sh: cannot fork")), TargetError, match=message)
    assert measure(bare_target, runs) == ["ok"]
    assert len(wishes.calls()) == 1


WAITING, ENDING, LOOKING = 'flock -s "$program.lock"', "write_if_absent", "[ -e given_up ] && echo"


@pytest.mark.parametrize("steps", [[WAITING], [ENDING], [WAITING, LOOKING]], ids=["waiting", "ending", "picking up"])
def test_a_link_that_breaks_again_and_again_leaves_the_run_its_master(bare_target, wishes, monkeypatch, measure, steps):
    wishes.will("sleep 4" if LOOKING in steps else "sleep 2")
    runs, steps = runs_of(1), [step for step in steps for _ in range(BREAKS_MAX)]
    real = Connection.check

    def check(self, argv, **more):
        if steps and any(steps[0] in word for word in argv):
            wishes.await_calls()
            del steps[0]
            self.shell.stream.shut_down()
        return real(self, argv, **more)

    monkeypatch.setattr(Connection, "check", check)
    while steps:
        with pytest.raises(ConnectionLost, match="the 5th connection to break at the same step"):
            measure(bare_target, runs)
        assert list(Path(bare_target.work_dir).glob("master/*/rosmaster.pid"))
    assert measure(bare_target, runs) == ["ok"]
    assert len(wishes.calls()) == 1
    assert not list(Path(bare_target.work_dir).glob("master/*"))


def test_what_the_target_should_have_ended_is_given_up_and_counts_as_late(target, tmp_path, wishes, measure, interrupt):
    wishes.will("ok", "sleep 60")
    runs = runs_of(2)

    def wait(link, folder, name, wait=processes.wait, **more):
        if "fq101" in folder.name:
            wishes.await_calls(2)
            raise DeadlineExpired("sh: 75 s were over")
        return wait(link, folder, name, **more)

    interrupt(target, runs, wait, DeadlineExpired)
    assert not list(Path(target.work_dir).glob("runs/*/*"))
    expected = [f"{runs[1].name}: took longer than it may: sh: 75 s were over"]
    assert lost(tmp_path / "results") == expected
    assert measure(target, runs) == ["ok", "ok"]
    assert lost(tmp_path / "results") == expected, "whoever measures it again"


@pytest.mark.parametrize("extra_s", [run_execution.HUNG_EXTRA_S, -60.0], ids=["in its time", "after its time"])
def test_ctrl_c_has_nothing_to_do_with_lateness_unless_it_hangs(
    target, tmp_path, wishes, measure, interrupt, monkeypatch, extra_s
):
    monkeypatch.setattr(run_execution, "HUNG_EXTRA_S", extra_s)
    runs = runs_of(1)
    interrupt(target, runs, failing(wishes, KeyboardInterrupt()), KeyboardInterrupt)
    assert measure(target, runs) == ["ok"]
    is_late = [
        reason.startswith(f"{runs[0].name}: took longer than it may: interrupted after ")
        for reason in lost(tmp_path / "results")
    ]
    assert is_late == [True] * (extra_s < 0)


@pytest.mark.parametrize("is_there", [True, False], ids=["the target has it", "it is gone"])
@pytest.mark.parametrize("step", ["before", "after"])
def test_a_runner_that_is_killed_when_it_starts_the_measuring(
    target, tmp_path, wishes, measure, interrupt, step, is_there
):
    runs = runs_of(1)

    def start(*words, start=processes.start, **more):
        if step == "after":
            start(*words, **more)
            wishes.await_calls()
        raise Stop

    interrupt(target, runs, start, Stop, name="start")
    if not is_there:
        (folder,) = Path(target.work_dir).glob("runs/*/*")
        with Link(target, print) as link:
            processes.give_up(link, PurePosixPath(folder))
    assert measure(target, runs) == ["ok"]
    assert len(wishes.calls()) == 1 + (step == "after" and not is_there)
    assert lost(tmp_path / "results") == [f"{runs[0].name}: begun and never closed"] * (not is_there)


def test_a_run_that_cannot_be_started_was_not_late(target, tmp_path, wishes, measure, interrupt):
    def start(*_, **__):
        raise TargetError("sh: cannot fork")

    interrupt(target, runs_of(1), start, TargetError, name="start")
    assert measure(target, runs_of(1)) == ["ok"]
    assert lost(tmp_path / "results") == []


def test_a_runner_that_is_killed_and_never_comes_back(target, tmp_path, wishes, interrupt):
    runs = runs_of(2)

    def wait(link, folder, name, wait=processes.wait, **more):
        if "fq101" in folder.name:
            raise Stop
        return wait(link, folder, name, **more)

    interrupt(target, runs, wait, Stop)
    assert lost(tmp_path / "results") == [f"{runs[1].name}: begun and never closed"]


@pytest.mark.parametrize("before", [True, False])
def test_a_publisher_does_not_go_on_without_its_subscriber(
    target, tmp_path, suites_folder, wishes, measure, monkeypatch, before
):
    folder, started, ended = suites_folder / "lib/communication_tests", tmp_path / "started", tmp_path / "ended"
    folder.mkdir()
    awaits = "" if before else f"until [ -e {started} ]; do sleep 0.1; done; "
    for name, does in (
        ("publisher", f"touch {started}; sleep 20; touch {ended}"),
        ("subscriber", f"{awaits}echo no memory >&2; exit 1"),
    ):
        (folder / f"communication_tests_{name}").write_text(f"#!/bin/sh\n{does}\n")
        (folder / f"communication_tests_{name}").chmod(0o755)
    if not before:
        connected = dataclasses.replace(SERVICES["roscpp"], count_subscribers=lambda *_: 1)
        monkeypatch.setitem(SERVICES, "roscpp", connected)
        monkeypatch.setattr(run_execution.processes, "WAIT_S", 1.0)
    entries = [{"suite": "communication_tests", "repetitions": 10}, {"suite": "cyclic_timer_tests", "repetitions": 10}]
    runs = plan(Campaign(schema=1, name="test", runs=entries), "test")
    assert measure(target, runs) == ["failed", "ok"]
    when, what = ("before", "was started") if before else ("while", "was running")
    reason = f"communication_tests_subscriber ended {when} communication_tests_publisher {what}: no memory"
    assert record(tmp_path / "results", runs[0])["reason"] == reason
    assert started.exists() is not before and not ended.exists()


def test_before_the_suite_was_started(target, tmp_path, wishes, measure, interrupt):
    """Nothing measured yet: it begins anew, with the state of the target that it then finds."""
    runs = runs_of(1)
    interrupt(target, runs, stop, Stop, module=suite, name="start")
    (attempt_file,) = Path(target.work_dir).glob("runs/*/*/attempt.json")
    uid = json.loads(attempt_file.read_text())["uid"]
    assert measure(target, runs) == ["ok"]
    assert record(tmp_path / "results", runs[0])["attempt"] != uid


def test_what_goes_on_comes_first(target, tmp_path, wishes, measure, interrupt):
    """A failed run is repeated after the one that an earlier call left, not beside it."""
    wishes.will("fail", "sleep 4")
    runs = runs_of(2)
    real = processes.wait

    def wait(link, folder, name, **more):
        if "fq101" not in folder.name:
            return real(link, folder, name, **more)
        wishes.await_calls(2)
        return out_of_reach(wishes)(link)

    interrupt(target, runs, wait, ConnectionLost)
    assert measure(target, runs) == ["ok", "ok"]
    ends = [record(tmp_path / "results", run) for run in runs]
    assert ends[1]["end_time"] < ends[0]["start_time"]
    assert len(wishes.calls()) == 3


def test_a_load_that_ended_while_nobody_looked(target, wishes, monkeypatch, measure, interrupt):
    """It outlived the suite: the run is whole."""
    monkeypatch.setattr(suite, "DEADLINE_EXTRA_S", 8.0)
    monkeypatch.setattr(planned_programs.conditions, "OUTLIVE_S", 1.0)
    wishes.will("sleep 3")
    runs = runs_of(1, condition="io", repetitions=100)
    interrupt(target, runs, stop, Stop)
    while not list(Path(target.work_dir).rglob("stress.exit")):
        time.sleep(0.1)
    assert measure(target, runs) == ["ok"]
    assert len(wishes.calls()) == 1


@pytest.mark.parametrize("call", [1, 2, 3])
def test_a_link_lost_in_a_call_of_the_master(target, monkeypatch, measure, call):
    """It is not taken for a master that died."""
    calls = []
    real = Connection.open_port

    @contextlib.contextmanager
    def breaking(self, port, **more):
        with real(self, port, **more) as channel:
            calls.append(port)
            if len(calls) == call:
                self.shell.stream.shut_down()
            yield channel

    monkeypatch.setattr(Connection, "open_port", breaking)
    watching = Watching()
    assert measure(target, runs_of(1), watching) == ["ok"]
    assert any("connecting again" in note for note in watching.notes)


def test_a_call_for_other_runs_leaves_a_run_that_has_ended(target, tmp_path, wishes, measure, interrupt):
    """Nothing of it lives any more; the call that wants it fetches it."""
    runs = runs_of(2, sampler="none")
    interrupt(target, runs, stop, Stop)
    (folder,) = Path(target.work_dir).glob(f"runs/*/{runs[0].name}")
    while not (folder / "cyclic_timer_tests.exit").exists():
        time.sleep(0.05)
    watching = Watching()
    campaign_runner.run_campaign(target, "test", runs, tmp_path / "results", watching, chosen=runs[1:])
    assert any(runs[0].name in note and "left for one that measures it" in note for note in watching.notes)
    assert measure(target, runs) == ["ok", "ok"]
    assert len(wishes.calls()) == 2


def test_a_campaign_that_is_refused_leaves_the_master_to_the_one_that_measures(bare_target, measure, monkeypatch):
    """It came between two runs, found the master that was there, and uses it."""
    begun = []

    def begin(link, *words, begin=resumption.begin, **more):
        begun.append(link)
        if len(begun) == 2:
            other = Program(name="suite", argv=("sleep", "300"), deadline_s=300)
            link.check(["mkdir", "-p", str(others)])
            processes.start(link, PurePosixPath(deploy.ON_TARGET), others, other)
        return begin(link, *words, **more)

    others = PurePosixPath(bare_target.work_dir) / "runs/other/run"
    monkeypatch.setattr(resumption, "begin", begin)
    with pytest.raises(TargetError, match="another run is still going on"):
        measure(bare_target, runs_of(2))
    assert list(Path(bare_target.work_dir).glob("master/*/rosmaster.pid"))
    with Link(bare_target, print) as link:
        processes.give_up(link, others)
    assert measure(bare_target, runs_of(2)) == ["ok", "ok"]
    assert not list(Path(bare_target.work_dir).glob("master/*"))


def test_a_run_of_another_campaign_is_not_disturbed(target, tmp_path, wishes, interrupt):
    wishes.will("sleep 60")
    interrupt(target, runs_of(1), out_of_reach(wishes), ConnectionLost)
    with pytest.raises(TargetError, match=r"another run is still going on: .*cyclic_timer_tests"):
        campaign_runner.run_campaign(target, "other", runs_of(1), tmp_path / "other", Watching())
    assert len(wishes.calls()) == 1
    (pid,) = Path(target.work_dir).rglob("cyclic_timer_tests.pid")
    for file in pid.parent.glob("*.pid"):
        os.killpg(int(file.read_text()), signal.SIGKILL)
    other = campaign_runner.run_campaign(target, "other", runs_of(1), tmp_path / "other", Watching())
    assert list(other.values()) == ["ok"]


@pytest.mark.parametrize("who", ["killed", "interrupted"])
def test_another_master_than_the_run_began_with(bare_target, tmp_path, wishes, measure, interrupt, who):
    wishes.will("sleep 6")
    runs = runs_of(1)
    interrupt(bare_target, runs, out_of_reach(wishes), ConnectionLost)
    if who == "killed":
        (pid,) = Path(bare_target.work_dir).glob("master/*/rosmaster.pid")
        os.killpg(int(pid.read_text()), signal.SIGKILL)
        assert measure(bare_target, runs) == ["failed"]
        assert record(tmp_path / "results", runs[0])["reason"].startswith("the ROS master died during the run")
        return
    interrupt(bare_target, runs, lambda *_, **__: os.kill(os.getpid(), signal.SIGINT), KeyboardInterrupt)
    assert not list(Path(bare_target.work_dir).glob("runs/*/*")), "given up with its master"


@pytest.mark.parametrize("wish", ["sleep 60", "ok"])
def test_a_run_whose_giving_up_was_cut_short_is_begun_anew(target, tmp_path, wishes, monkeypatch, measure, wish):
    wishes.will(wish)
    runs = runs_of(1)
    real = processes.wait

    def interrupted(*args, **more):
        wishes.await_calls()
        if wish == "ok":
            real(*args, **more)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(run_execution.processes, "wait", interrupted)
        # The last of its steps, the removal, does not happen.
        check = Link.check
        patch.setattr(Link, "check", lambda link, argv, **more: "" if argv[0] == "rm" else check(link, argv, **more))
        with pytest.raises(KeyboardInterrupt):
            measure(target, runs)
    assert list(Path(target.work_dir).rglob("given_up"))
    assert measure(target, runs) == ["ok"]
    assert len(wishes.calls()) == 2
    assert not list((tmp_path / "results").glob("*.old-*"))
    assert lost(tmp_path / "results") == [], "nothing but Ctrl-C ended it"


def test_a_failed_run_that_was_closed_is_repeated_and_not_read_again(target, tmp_path, wishes, measure, interrupt):
    wishes.will("fail")
    runs = runs_of(1)
    interrupt(target, runs, close_and_stop, Stop, module=run_execution.run_directory, name="close")
    assert measure(target, runs) == ["ok"]
    assert len(wishes.calls()) == 2
    assert lost(tmp_path / "results") == [f"{runs[0].name}.old-1: failed, then measured again"]


def test_what_a_killed_runner_left_of_a_closed_run_is_removed_before_the_next(
    target, wishes, monkeypatch, measure, interrupt
):
    runs = runs_of(2)
    interrupt(target, runs, close_and_stop, Stop, module=run_execution.run_directory, name="close")
    assert len(list(Path(target.work_dir).glob("runs/*/*"))) == 1
    left = []
    watching = Watching()
    monkeypatch.setattr(watching, "ended", lambda *_: left.extend(Path(target.work_dir).glob("runs/*/*")))
    assert measure(target, runs, watching) == ["ok", "ok"]
    assert not left, "nor does a run that is closed leave anything"
    assert not list(Path(target.work_dir).glob("runs/*"))


def test_a_target_that_restarts_again_and_again_is_given_up(target, measure, interrupt):
    attempts = []

    def restarts(prepared, *_, **__):
        attempts.append(prepared)
        raise TargetRebooted("the target was restarted")

    interrupt(target, runs_of(2), restarts, TargetRebooted, module=run_execution, name="measure")
    assert len(attempts) == len({id(prepared) for prepared in attempts}) == board.ATTEMPTS


def test_a_run_does_not_begin_without_a_master(target, wishes, interrupt):
    answers = [17]
    interrupt(
        target,
        runs_of(1),
        lambda _: answers.pop() if answers else None,
        TargetError,
        module=roscpp,
        name="ask_pid",
        match="the ROS master died",
    )
    assert wishes.calls() == []


def test_a_reboot_after_a_run_was_closed_costs_nothing(target, tmp_path, wishes, monkeypatch, measure):
    links = []
    real_enter, real_close = Link.__enter__, run_directory.close
    monkeypatch.setattr(Link, "__enter__", lambda self: (links.append(self), real_enter(self))[1])

    def close(*args):
        real_close(*args)
        if len(wishes.calls()) == 1:
            links[0].boot_id = "the boot before"
            links[0].drop()

    monkeypatch.setattr(run_execution.run_directory, "close", close)
    assert measure(target, runs_of(2)) == ["ok", "ok"]
    assert len(wishes.calls()) == 2
    assert not list((tmp_path / "results").glob("*.old-*"))


@pytest.mark.parametrize("error", [ConnectionLost, DeadlineExpired])
def test_nothing_is_done_on_a_boot_that_is_not_known(target, monkeypatch, error):
    with Link(target, lambda _: None) as link:
        link.boot_id = "another boot"
        link.drop()
        real, failed = Connection.check, []

        def check(self, argv, **more):
            if "boot_id" in argv[-1] and not failed:
                failed.append(error)
                raise error("x")
            return real(self, argv, **more)

        monkeypatch.setattr(Connection, "check", check)
        with pytest.raises(TargetRebooted):
            link.check(["true"])


def test_the_record_is_of_what_ran_and_not_of_what_is_there_now(
    target, tmp_path, suites_folder, wishes, measure, interrupt
):
    wishes.will("sleep 2")
    runs = runs_of(1)
    interrupt(target, runs, out_of_reach(wishes), ConnectionLost)
    (before,) = Path(target.work_dir).glob("suites/*")
    shutil.copy(suites_folder / "build.json", suites_folder / "of_a_newer_build.json")
    assert measure(target, runs) == ["ok"]
    assert len(list(Path(target.work_dir).glob("suites/*"))) == 2
    assert record(tmp_path / "results", runs[0])["programs"][0]["argv"][0].startswith(str(before))
