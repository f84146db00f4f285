"""The kernel trace around outliers, over a real sshd and this machine's tracefs: set up, pulled, taken down."""

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from faulty import measure, record, runs_of

from rtrun.targets import deploy, processes
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection.kernel_trace import read_events
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros, pytest.mark.trace]

INSTANCE = Path("/sys/kernel/tracing/instances/rtrun")
SCRIPT = ON_TARGET / "trace.sh"


@pytest.fixture
def watching():
    return Watching()


@pytest.fixture
def target(ready_target):
    return ready_target


@pytest.mark.parametrize(("clock", "kernels"), [("raw", "mono_raw"), ("monotonic", "mono")])
def test_traces_come_with_the_run(target, tmp_path, watching, wishes, clock, kernels):
    wishes.will("traced 3 8")
    (run,) = runs = runs_of(1, trace={"above": "50us"}, clock=clock)
    assert measure(target, runs, tmp_path / "results", watching) == ["ok"]
    traces = sorted(name for name in record(tmp_path / "results", run)["files"] if "trace" in name)
    assert traces == ["cyclic_timer_tests_l10_fq100-trace-3.txt", "cyclic_timer_tests_l10_fq100-trace-8.txt"]
    # The instance was there while the suite ran, on the clock of the samples.
    assert f"[{kernels}]" in (tmp_path / "results" / run.name / traces[0]).read_text()
    assert not INSTANCE.exists()


def test_more_traces_than_a_suite_takes_are_not_pulled(target, tmp_path, watching, wishes):
    wishes.will("traced " + " ".join(map(str, range(40))))
    (run,) = runs = runs_of(1, break_trace_us=50)
    measure(target, runs, tmp_path / "results", watching)
    assert len([name for name in record(tmp_path / "results", run)["files"] if "trace" in name]) == 16


@pytest.mark.parametrize("wish", ["fail", "killed"])
def test_a_suite_that_fails_leaves_no_trace_set_up(target, tmp_path, watching, wishes, wish):
    wishes.will(wish)
    assert measure(target, runs_of(1, trace={"above": "50us"}), tmp_path / "results", watching) == ["failed"]
    assert not INSTANCE.exists()


@pytest.mark.parametrize("error", [KeyboardInterrupt, TargetError("no space left")])
def test_a_runner_that_gives_up_leaves_no_trace_set_up(target, tmp_path, watching, wishes, monkeypatch, error):
    seen = []

    def wait(*args, **kwargs):
        seen.append(INSTANCE.exists())
        raise error

    runs = runs_of(1, trace={"above": "50us"})
    with monkeypatch.context() as patch:
        patch.setattr(processes, "wait", wait)
        with pytest.raises(type(error) if isinstance(error, Exception) else error):
            measure(target, runs, tmp_path / "results", watching)
    assert seen == [True]
    assert INSTANCE.exists() is (error is not KeyboardInterrupt), "what goes on goes on with its trace"
    assert measure(target, runs, tmp_path / "results", watching) == ["ok"]
    assert not INSTANCE.exists()
    if error is not KeyboardInterrupt:
        assert len(wishes.calls()) == 1, "an error of ours is no reason to give up what measures"


def leave(script=SCRIPT):
    """Set up the trace as a runner did two minutes ago that had another directory and was killed."""
    subprocess.run([script, "up", "mono"], check=True)
    os.utime(INSTANCE, times=(time.time() - 120,) * 2)


def test_what_a_killed_runner_left_is_gone_with_the_next_campaign(target, tmp_path, watching, wishes):
    leave()
    measure(target, runs_of(1), tmp_path / "results", watching)
    assert not INSTANCE.exists()


def test_what_another_campaign_has_just_set_up_stays(target, tmp_path, watching, wishes):
    """Its suite has not opened it yet."""
    subprocess.run([SCRIPT, "up", "mono"], check=True)
    try:
        measure(target, runs_of(1), tmp_path / "results", watching)
        assert INSTANCE.exists()
    finally:
        subprocess.run([SCRIPT, "down"], check=True)
    assert not INSTANCE.exists()


@pytest.fixture(params=["OSNOISE_WORKLOAD", "NO_OSNOISE_WORKLOAD"])
def osnoise(request, tmp_path, monkeypatch):
    """osnoise's options, which not every kernel has: a file in their place, for the script and for the target's."""
    options = tmp_path / "options"
    options.write_text(f"NO_DEFAULTS {request.param} NO_PANIC_ON_STOP\n")
    scripts = tmp_path / "on_target"
    shutil.copytree(ON_TARGET, scripts)
    text = (scripts / "trace.sh").read_text()
    text = text.replace("$tracing/osnoise/options", str(options)).replace("/run/", f"{tmp_path}/")
    (scripts / "trace.sh").write_text(text)
    monkeypatch.setattr(deploy, "ON_TARGET", scripts)
    return options, request.param, scripts / "trace.sh"


def test_the_workload_of_osnoise_is_as_it_was(target, tmp_path, watching, wishes, osnoise):
    """After the run, and after a runner that was killed."""
    options, before, script = osnoise
    for was_killed in (False, True):
        leave(script)
        assert "NO_OSNOISE_WORKLOAD" in options.read_text().split()
        if not was_killed:
            subprocess.run([script, "down"], check=True)
        else:
            measure(target, runs_of(1), tmp_path / "results", watching)
        assert before in options.read_text().split() and not INSTANCE.exists()


def test_a_trace_in_use_stays(target):
    subprocess.run([SCRIPT, "up", "mono"], check=True)
    try:
        with (INSTANCE / "trace_marker").open("w") as marker:
            marker.write("of the run that goes on\n")
            marker.flush()
            subprocess.run([SCRIPT, "down"], check=True)
            subprocess.run([SCRIPT, "up", "mono"], check=True)
            assert "of the run that goes on" in (INSTANCE / "trace").read_text()
    finally:
        subprocess.run([SCRIPT, "down"], check=True)
    assert not INSTANCE.exists()


def test_every_event_of_the_list_is_recorded():
    events = read_events()
    subprocess.run([SCRIPT, "up", "mono_raw", *events], check=True)
    try:
        there = [INSTANCE / "events" / event / "enable" for event in events]
        known = [path for path in there if path.exists()]
        assert INSTANCE / "events/sched/sched_switch/enable" in known
        assert [path.read_text().strip() for path in known] == ["1"] * len(known)
        assert (INSTANCE / "events/sched/enable").read_text().strip() == "X", "events that nobody reads are recorded"
        assert (INSTANCE / "tracing_on").read_text().strip() == "1"
    finally:
        subprocess.run([SCRIPT, "down"], check=True)


def test_a_target_that_cannot_trace_says_so(target, tmp_path, watching, monkeypatch):
    script = (tmp_path / "trace.sh").absolute()
    script.write_text(SCRIPT.read_text().replace("/sys/kernel/tracing", str(tmp_path / "none")))
    done = subprocess.run(["sh", script, "up", "mono"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("no kernel trace: it needs CONFIG_FTRACE, tracefs on ")


def test_a_part_of_a_suite_that_was_killed_comes_as_samples(target, tmp_path, watching, wishes):
    wishes.will("part")
    (run,) = runs = runs_of(1)
    assert measure(target, runs, tmp_path / "results", watching) == ["failed"]
    assert "cyclic_timer_tests_l10_fq100.npy" in record(tmp_path / "results", run)["files"]
