"""The main job: the real suites on the real board in QEMU, over SSH, under a real ROS master, with the real runner."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import rtgen.cli
import rtrun.cli
from rtrun.execution import campaign_runner
from rtrun.plan.campaign import read_campaign
from rtrun.results import run_directory
from rtrun.results.reading import read_run
from rtrun.target import qemu, qmp
from rtrun.target.config import connect, read_target
from rtrun.target.errors import TargetError, TargetGone
from rtrun.target.ssh import Connection
from watching import Watching

# The time limit counts for the fixture too: a cold board and the suites for it take some minutes.
pytestmark = [pytest.mark.qemu, pytest.mark.ros, pytest.mark.timeout(900)]
TOP = Path(__file__).parents[2]


@pytest.fixture(scope="module", autouse=True)
def built():
    """The board image and the suites for it, from the cache or made now."""
    folder = Path.cwd()
    os.chdir(TOP)
    try:
        assert rtgen.cli.main(["board", "build", "--machine", "qemu-armv7"]) == 0
        assert rtgen.cli.main(["suites", "build", "--machine", "qemu-armv7"]) == 0
    finally:
        os.chdir(folder)


def write_campaign(folder, text):
    path = folder / "campaign.yml"
    path.write_text("schema: 1\nname: test\n" + text)
    return path


ALL_SUITES = """
common: {repetitions: 50, policy: RR}
runs:
  - {suite: oneshot_timer_tests}
  - {suite: cyclic_timer_tests, frequency_hz: 50, policy: "0"}
  - {suite: communication_tests, frequency_hz: 50, subscribers: [1, 3], policy: FIFO}
"""


def test_the_three_suites_on_the_board(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    campaign = write_campaign(tmp_path, ALL_SUITES)
    assert rtrun.cli.main(["run", str(campaign), "--target", str(TOP / "targets" / "qemu.yml")]) == 0
    out = capsys.readouterr().out
    assert "EMULATED: not a real-time statement" in out
    _, runs = read_campaign(campaign)
    for run in runs:
        folder = tmp_path / "results" / "test" / run.name
        record = json.loads((folder / "run.json").read_text())
        assert record["status"] == "ok" and record["emulated"] is True
        assert record["target"]["preempt_rt"] is True and "PREEMPT_RT" in record["target"]["kernel_version"]
        assert set(record["files"]) == {path.name for path in folder.iterdir()} - {"run.json"}
        assert {"target.json", "console.log"} <= set(record["files"])
        logs = sorted(folder.glob("*.log"))
        outputs = record["outputs"]
        expected = 3 if run.suite == "oneshot_timer_tests" else len(outputs)
        drawn = [log for log in logs if log.name != "console.log"]
        assert len(drawn) == expected
        for output in outputs:
            suite = json.loads((folder / f"{output}.json").read_text())
            assert suite["complete"] is True and suite["counts"]["asked"] == 50
            policy = {"0": "OTHER"}.get(str(run.parameters["policy"]), run.parameters["policy"])
            assert policy in {thread["policy"] for thread in suite["in_effect"]["threads"]}
            assert suite["in_effect"]["mlockall"] is (run.parameters["policy"] != "0")
        for log in drawn:
            work = tmp_path / "drawing"
            work.mkdir(exist_ok=True)
            shutil.copy(log, work)
            subprocess.run(["gnuplot", log.name], cwd=work, check=True)
            assert (work / log.with_suffix(".jpg").name).read_bytes()[:2] == b"\xff\xd8"
    assert rtrun.cli.main(["show", "--json", str(tmp_path / "results" / "test" / runs[3].name)]) == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert len(results) == 3
    for result in results:
        assert {"n", "min_us", "mean_us", "max_us", "missing", "out_of_order", "top", "lowest"} <= set(result)
        assert result["n"] + len(result["startup"]) + result["missing"] == 50


CONDITIONS = """
common: {repetitions: 60, frequency_hz: 10}
runs:
  - {suite: cyclic_timer_tests, policy: RR, cpu: "1", irq_cpu: "0", condition: [cpu80, nodes], nodes_hz: 20}
"""


def test_conditions_on_the_board_and_what_was_in_effect(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    campaign = write_campaign(tmp_path, CONDITIONS)
    status = rtrun.cli.main(["run", str(campaign), "--target", str(TOP / "targets" / "qemu.yml")])
    assert status == 0, capsys.readouterr().out
    _, runs = read_campaign(campaign)
    for run in runs:
        record = json.loads((tmp_path / "results" / "test" / run.name / "run.json").read_text())
        found = record["in_effect"]
        assert (found["policy"], found["priority"], found["cpus"]) == (["RR"], [95], [1])
        assert found["looks"] >= 2 and found["sched_rt_runtime_us"] == [950000]
        assert "rosmaster" in {rival["name"] for rival in found["rivals"]}, "at the priority above the suite's"
        assert found["loads"].keys() == record["requested"]["loads"].keys()
        loads = {"stress"} if run.condition == "cpu80" else {"listener0", "talker0"}
        # The kernel let interrupts be moved, and nobody moved them back: else it had ended, and the run were invalid.
        assert found["loads"].keys() == loads | {"hold-irq_cpu"}


def measure(tmp_path, act, results):
    """Run a campaign of three runs on a booted board; `act(machine, number)` is called when a run begins."""
    campaign = write_campaign(
        tmp_path,
        "runs: [{suite: cyclic_timer_tests, frequency_hz: 10, repetitions: [10, 100, 11], policy: RR}]\n",
    )
    _, runs = read_campaign(campaign)
    config = read_target(TOP / "targets" / "qemu.yml")
    machines = []
    real = qemu.boot

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(qemu, "boot", lambda *words: Remembering(real(*words), machines))
        observer = Watching(lambda number: act(machines[0], number))
        with connect(config, TOP / "targets", tmp_path / "console.log") as switched_on:
            try:
                return runs, observer, campaign_runner.run_campaign(switched_on, "test", runs, results, observer)
            except TargetGone as error:
                return runs, observer, error


def when(machine, script, then):
    """Do something, in a thread, once a shell script on the board prints something."""

    def wait():
        deadline = time.monotonic() + 240
        connection = None
        while time.monotonic() < deadline:
            try:
                connection = connection or Connection(machine.address)
                if connection.run(["sh", "-c", script]).stdout:
                    connection.close()
                    then()
                    return
            except TargetError:
                connection = None
            time.sleep(0.2)

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


# The second run measures; its folder is named after what was asked for.
SECOND_RUNS = "cat /var/lib/rt-tests/runs/*/*_l100_*/cyclic_timer_tests.pid 2>/dev/null"


class Remembering:
    """A context manager that tells what it yielded."""

    def __init__(self, context, seen):
        self.context, self.seen = context, seen

    def __enter__(self):
        self.seen.append(self.context.__enter__())
        return self.seen[-1]

    def __exit__(self, *words):
        return self.context.__exit__(*words)


def test_a_reset_and_then_a_power_cut_in_the_middle_of_a_run(tmp_path):
    results = tmp_path / "results"

    def reset_in_the_second(machine, number):
        if number == 0:
            # The suites and the runner measure nothing with the clock that can be set.
            timers_of_the_clock.append(threading.Timer(1.5, jump_a_year, (machine.address,)))
            timers_of_the_clock[0].start()
        if number == 1 and not resets:
            resets.append(when(machine, SECOND_RUNS, lambda: qmp.execute(machine.monitor, "system_reset")))

    resets, timers_of_the_clock, jumps = [], [], []

    def jump_a_year(address):
        connection = Connection(address)
        jumps.append(connection.check(["sh", "-c", "date -s '2031-01-01 00:00:00' && date +%Y"]))
        connection.close()

    runs, observer, statuses = measure(tmp_path, reset_in_the_second, results)
    assert list(statuses.values()) == ["ok", "ok", "ok"], "the run that was cut off is repeated"
    assert jumps[0].split()[-1] == "2031"
    (first,) = read_run(results / runs[0].name).results[:1]
    assert first.figures.n + len(first.header.startup) == 10 and abs(first.figures.max_ns) < 60e9
    assert any("the target was restarted" in note for note in observer.notes)
    assert run_directory.closing_record(results / runs[1].name).status == "ok"
    kept = results / f"{runs[1].name}.incomplete-1"
    assert kept.is_dir() and run_directory.closing_record(kept) is None

    def quit_in_the_second(machine, number):
        if number == 1:
            when(machine, SECOND_RUNS, lambda: qmp.execute(machine.monitor, "quit"))

    runs, observer, error = measure(tmp_path, quit_in_the_second, tmp_path / "other")
    assert isinstance(error, TargetGone)
    assert "the emulated board was switched off: QEMU ended (exit status 0)" in str(error)
    assert campaign_runner.count_finished(tmp_path / "other", runs) == 1, "what was finished is kept"


def qemus_of(console):
    found = subprocess.run(["pgrep", "-f", f"file:.*{console}"], capture_output=True, text=True, check=False)
    return found.stdout.split()


def test_a_killed_runner_leaves_no_emulator_behind(tmp_path):
    campaign = write_campaign(tmp_path, "runs: [{suite: oneshot_timer_tests, repetitions: 10}]\n")
    results = tmp_path / "results"
    argv = [sys.executable, "-m", "rtrun.cli", "run", campaign, "--target", TOP / "targets" / "qemu.yml"]
    argv += ["--results", results]
    runner = subprocess.Popen(argv, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    console = results / "console.log"
    while not qemus_of(console):
        assert runner.poll() is None
        time.sleep(0.1)
    (emulator,) = qemus_of(console)
    runner.send_signal(signal.SIGKILL)
    runner.wait()
    deadline = time.monotonic() + 20
    while Path(f"/proc/{emulator}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.05)


OUTLIERS_AND_BLOCKS = """
runs:
  - {suite: communication_tests, frequency_hz: 20, repetitions: 60, subscribers: 2, policy: RR, trace_threshold_us: 1}
  - {suite: cyclic_timer_tests, frequency_hz: 10, repetitions: 150, policy: RR}
"""


# Rows of a run stand on the board's disk: of two blocks, so that the first is there for good.
FIRST_BLOCK = "find /var/lib/rt-tests/runs -name '*.npy.part' -size +600c"


def test_traces_of_outliers_and_the_blocks_of_a_run_cut_off(tmp_path, monkeypatch):
    campaign = write_campaign(tmp_path, OUTLIERS_AND_BLOCKS)
    _, runs = read_campaign(campaign)
    results = tmp_path / "results"
    machines, resets = [], []
    real = qemu.boot
    monkeypatch.setattr(qemu, "boot", lambda *words: Remembering(real(*words), machines))

    def act(number):
        if number == 1 and not resets:
            machine = machines[0]
            resets.append(when(machine, FIRST_BLOCK, lambda: qmp.execute(machine.monitor, "system_reset")))

    config = read_target(TOP / "targets" / "qemu.yml")
    with connect(config, TOP / "targets", tmp_path / "console.log") as switched_on:
        statuses = campaign_runner.run_campaign(switched_on, "test", runs, results, Watching(act))
        connection = Connection(switched_on.address)
        instances = connection.check(["ls", "/sys/kernel/tracing/instances"]).split()
        connection.close()
    assert list(statuses.values()) == ["ok", "ok"]
    assert instances == [], "what was set up to trace is taken down"

    covered = []
    for output in json.loads((results / runs[0].name / "run.json").read_text())["outputs"]:
        record = json.loads((results / runs[0].name / f"{output}.json").read_text())
        assert record["traces"]["above_limit"] == 60
        assert record["traces"]["files"] == [f"{output}-trace-{index}.txt" for index in range(16)]
        reception = np.load(results / runs[0].name / f"{output}.npy")[:, 1]
        for index, name in enumerate(record["traces"]["files"]):
            text = (results / runs[0].name / name).read_text()
            at_s = float(re.match(r"# .* ns at index \d+ above 1000 ns, at (\S+) s of ", text)[1])
            assert at_s == pytest.approx(reception[index] / 1e9, abs=1e-6)
            if elsewhere := re.search(r"^# in (.*)$", text, re.M):
                text = (results / runs[0].name / elsewhere[1]).read_text()
            stamps = [float(stamp) for stamp in re.findall(r" (\d+\.\d{6}): sched_switch: ", text)]
            assert at_s < max(stamps)
            covered.append(min(stamps) < at_s)
    # A starved emulated CPU may copy a trace so late that what it is about is overwritten, but not each time.
    assert any(covered)

    resets[0].join()
    (kept,) = results.glob("*.incomplete-1")
    assert kept.name == f"{runs[1].name}.incomplete-1"
    rows = np.load(next(kept.glob("*.npy")))
    assert 1 < len(rows) < 150
    assert (np.diff(rows[:, 0]) > 0).all()
    assert not list(kept.glob("*.json"))
