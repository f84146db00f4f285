"""Conditions on a target behind a real sshd, with real loads; the suite is one that goes wrong on request."""

import gzip
import os
import re
import signal
import threading
import time
from pathlib import Path

import pytest
from faulty import measure, record

from rtrun.execution import preparation
from rtrun.plan.campaign import Campaign, plan
from rtrun.results.reading import read_run
from rtrun.targets.errors import TargetError
from rtrun.validity.observations import OUTPUT_BYTES
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros]


@pytest.fixture
def target(ready_target):
    return ready_target


def measure_one(target, tmp_path, **values):
    """Run a campaign of one run and return its run.json."""
    entry = {"suite": "cyclic_timer_tests", "repetitions": 10, "frequency_hz": 10} | values
    (run,) = runs = plan(Campaign(schema=1, name="test", runs=[entry]), "test")
    measure(target, runs, tmp_path / "results")
    return record(tmp_path / "results", run)


def session_of(target, name):
    """The processes in the session of a program of the run that is under way: pid to command."""
    workers = {}
    for file in Path(target.work_dir, "runs").rglob(f"{name}.pid"):
        leader = file.read_text().strip()
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                head, _, tail = stat.read_text().rpartition(")")
            except OSError:
                continue
            if tail.split()[3] == leader:
                workers[int(stat.parent.name)] = head.partition("(")[2]
    return workers


def when(condition, then):
    """Do something, in a thread, as soon as a condition gives something."""

    def wait():
        deadline = time.monotonic() + 60
        while not (value := condition()):
            if time.monotonic() > deadline:
                return
            time.sleep(0.05)
        then(value)

    threading.Thread(target=wait, daemon=True).start()


def test_a_load_runs_with_the_suite_and_ends_with_it(target, tmp_path, wishes):
    wishes.will("sleep 8")
    found = measure_one(target, tmp_path, condition="cpu80")
    assert (found["status"], found["reason"]) == ("ok", None)
    assert found["condition"] == "cpu80"
    assert found["requested"]["loads"] == {"stress": 1 + len(os.sched_getaffinity(0))}
    assert found["in_effect"]["loads"]["stress"] >= found["requested"]["loads"]["stress"]
    assert found["in_effect"]["policy"] == ["OTHER"] and found["in_effect"]["observations"] >= 2
    assert found["in_effect"]["busy_percent"] > 60
    second = Path("/proc/2/comm")
    # A container with pids of its own sees no threads of the kernel.
    if second.exists() and second.read_text() == "kthreadd\n":
        assert {"name": "migration/0", "policy": "FIFO", "priority": 99} in found["in_effect"]["rivals"]
    assert {"stress.stdout", "sampler.stdout"} <= set(found["files"])
    assert not list(Path(target.work_dir, "runs").rglob("*.pid")), "nothing stays"
    assert not [stat for stat in Path("/proc").glob("[0-9]*/environ") if runs_in(stat, target)]


def runs_in(environ, target):
    try:
        return str(target.work_dir) in str((environ.parent / "cwd").readlink())
    except OSError:
        return False


def beside_the_suite(target, name):
    """What gives the processes of a program once the suite runs beside it."""

    def find():
        is_there = "cyclic_timer_te" in session_of(target, "cyclic_timer_tests").values()
        return session_of(target, name) if is_there else {}

    return find


def kill(command, count=None):
    """What kills so many processes of this command; "": of any."""

    def kill_them(processes):
        for pid in [pid for pid, name in processes.items() if command in ("", name)][:count]:
            os.kill(pid, signal.SIGKILL)

    return kill_them


def test_what_dies_in_the_middle_makes_its_run_invalid(target, tmp_path, wishes):
    """A load, one of its workers, the sampler: each in a run of its own."""
    dying = [
        ("stress", kill("stress-ng"), "condition cpu80: stress ended in the middle of the run, with exit status 137"),
        ("stress", kill("stress-ng-cpu", 1), "condition cpu80: stress "),
        ("sampler", kill(""), "sampler ended in the middle of the run, killed from outside"),
    ]
    entry = {"suite": "cyclic_timer_tests", "repetitions": 10, "frequency_hz": [10, 9, 8], "condition": "cpu80"}
    runs = plan(Campaign(schema=1, name="test", runs=[entry]), "test")
    wishes.will("sleep 3", "sleep 6", "sleep 3")
    watching = Watching(lambda number: when(beside_the_suite(target, dying[number][0]), dying[number][1]))
    statuses = measure(target, runs, tmp_path / "results", watching)
    assert statuses == ["invalid"] * 3
    for run, (_, _, reason) in zip(runs, dying, strict=True):
        assert reason in record(tmp_path / "results", run)["reason"]


# Prints what it would see in two days, but at once.
OBSERVES_MUCH = """#!/usr/bin/env python3
import pathlib, signal
print("at 100.00 0.50 - - cpu  1 2 3 4 5 6 7 8 0 0", "counts", "thread cyclic_timer_tests 7 0 0 0-1 cyclic", sep="\\n")
print("load stress 65 0-1", "end 100.00", sep="\\n")
for at in range(102, 172_800, 2):
    print(f"at {{at}}.00 0.50 - - cpu  1 2 3 4 5 6 7 8 0 0\\ncounts interrupts=7 {{'x=1 ' * 50}}".rstrip())
print(flush=True, end="")
pathlib.Path({done!r}).touch()
signal.pause()
"""


@pytest.mark.parametrize(
    ("repetitions", "frequency_hz", "status", "looks"),
    [(172_800, 1, "ok", 86_350), (10, 10, "invalid", 30_000)],
)
def test_what_is_observed_may_be_as_large_as_the_run_is_long(
    target, suites_folder, tmp_path, wishes, repetitions, frequency_hz, status, looks
):
    """Two days of observations; beside a short run they are taken as far as they are believable, and read."""
    sampler = suites_folder / "lib" / "rt_tests_sampler" / "rt_tests_sampler"
    sampler.parent.mkdir()
    sampler.write_text(OBSERVES_MUCH.format(done=str(tmp_path / "done")))
    sampler.chmod(0o755)
    wishes.will(f"await {tmp_path / 'done'}")
    found = measure_one(target, tmp_path, repetitions=repetitions, frequency_hz=frequency_hz, condition="memory")
    size = found["files"]["sampler.stdout"]["size_bytes"]
    assert size > OUTPUT_BYTES
    assert found["status"] == status and found["in_effect"]["observations"] >= looks
    if status == "ok":
        assert (found["reason"], found["refused"]) == (None, {})
    else:
        (reason,) = found["refused"].values()
        assert reason.endswith(f"at most {size} were expected: the rest was not taken")
        assert found["reason"] == f"nobody saw what was in effect to the end: {reason}"


def test_a_run_without_sampler(target, tmp_path, wishes):
    wishes.will("sleep 2")
    found = measure_one(target, tmp_path, sampler="none")
    assert (found["status"], found["reason"], found["settings"]["sampler"]) == ("ok", None, "none")
    assert found["run"].endswith("-samplernone"), "told from one with it"
    assert "sampler.stdout" not in found["files"] and found["in_effect"]["observations"] == 0


def test_what_the_target_lacks_is_said_before_anything_is_measured(target, tmp_path, wishes, monkeypatch):
    monkeypatch.setattr(preparation.conditions, "needs", lambda *_: {"no-such-tool", "governor=warp", "sh"})
    with pytest.raises(TargetError, match="the target lacks the cpufreq governor warp, no-such-tool, which this"):
        measure_one(target, tmp_path, condition="cpu80")
    assert wishes.calls() == []


def test_a_load_that_does_not_start_is_an_error_of_the_target(target, tmp_path, wishes):
    with pytest.raises(TargetError, match=r"condition cpu80: stress does not run: .*taskset"):
        measure_one(target, tmp_path, condition="cpu80", load_cpu="900")
    assert wishes.calls() == []


@pytest.mark.root
def test_a_policy_that_is_not_in_effect_makes_the_run_invalid(target, tmp_path, wishes):
    wishes.will("no policy")
    found = measure_one(target, tmp_path, policy="RR")
    assert found["status"] == "invalid"
    assert "asked for RR 95, in effect was OTHER 0" in found["reason"]
    assert (found["requested"]["policy"], found["in_effect"]["policy"]) == ("RR", ["OTHER"])


@pytest.mark.root
def test_cyclictest_is_a_suite_of_its_own(target, tmp_path):
    entry = {"suite": "cyclictest", "policy": "RR", "priority": 80, "repetitions": 4000, "threads": 2}
    (run,) = runs = plan(Campaign(schema=1, name="test", runs=[entry]), "test")
    measure(target, runs, tmp_path / "results")
    found = record(tmp_path / "results", run)
    assert (found["status"], found["reason"]) == ("ok", None)
    assert "--interval=1000" in found["programs"][0]["argv"] and "--policy=rr" in found["programs"][0]["argv"]
    assert "RR" in found["in_effect"]["policy"] and 80 in found["in_effect"]["priority"]
    printed = (tmp_path / "results" / run.name / "cyclictest.stdout").read_text()
    # cyclictest counts a value above its histogram apart: how many there are is up to how busy the machine is.
    counted = [re.search(rf"# {what}: (.*)", printed)[1].split() for what in ("Total", "Histogram Overflows")]
    totals = [int(within) + int(above) for within, above in zip(*counted, strict=True)]
    results = read_run(tmp_path / "results" / run.name).results
    assert [(result.header.suite, result.figures.n) for result in results] == [
        ("cyclictest", total) for total in totals
    ]
    assert len(totals) == 2 and min(totals) > 1000


@pytest.mark.root
def test_hwlatdetect_where_the_kernel_has_no_such_tracer(target, tmp_path, monkeypatch):
    monkeypatch.setattr(preparation.inspection, "read_kernel_config", lambda _: gzip.compress(b"CONFIG_FTRACE=y\n"))
    (run,) = runs = plan(Campaign(schema=1, name="test", runs=[{"suite": "hwlatdetect", "duration_s": 3}]), "test")
    assert run.expected_s == 3
    with pytest.raises(TargetError, match="the target lacks CONFIG_HWLAT_TRACER in its kernel"):
        measure(target, runs, tmp_path / "results")


def test_every_other_load_keeps_its_workers_and_the_cpus_that_it_was_given(target, tmp_path, wishes):
    wishes.will(*["sleep 4"] * 5)
    entry = {"suite": "cyclic_timer_tests", "repetitions": 10, "frequency_hz": 10}
    loads = [{"condition": ["memory", "io", "network", "irq"]}, {"condition": "hackbench", "load_cpu": "1"}]
    runs = plan(Campaign(schema=1, name="test", runs=[entry | load for load in loads]), "test")
    measure(target, runs, tmp_path / "results")
    records = [record(tmp_path / "results", run) for run in runs]
    assert [(found["status"], found["reason"]) for found in records] == [("ok", None)] * 5
    for found in records[:-1]:
        assert found["in_effect"]["loads"]["stress"] >= found["requested"]["loads"]["stress"] > 1
    hackbench = records[-1]
    assert hackbench["requested"]["load_cpus"] == hackbench["in_effect"]["load_cpus"] == [1]
    assert hackbench["in_effect"]["loads"]["hackbench"] >= 41
