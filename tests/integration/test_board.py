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
from rtrun.flows.topology.tables import read_tables
from rtrun.plan.campaign import read_campaign
from rtrun.results import run_directory
from rtrun.results.reading import read_run
from rtrun.results.topology_record import read_topology_record
from rtrun.targets.config import connect, read_target
from rtrun.targets.connection import Connection
from rtrun.targets.errors import TargetError, TargetGone
from rtrun.targets.qemu import emulator as qemu
from rtrun.targets.qemu import qmp
from watching import Watching

# The time limit counts for the fixtures too: a cold board and the suites for it take up to twenty minutes, and each of
# the fourteen runs up to ninety seconds where three other workers share two cores with the emulator.
pytestmark = [pytest.mark.qemu, pytest.mark.ros, pytest.mark.timeout(2400)]
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


EVERY_SUITE = """
runs:
  - {suite: oneshot_timer_tests, repetitions: 50, policy: RR}
  - {suite: cyclic_timer_tests, repetitions: 50, frequency_hz: 50, policy: "0"}
  - {suite: communication_tests, repetitions: 50, frequency_hz: 50, subscribers: [1, 3], policy: FIFO}
  - {suite: cyclic_timer_tests, repetitions: 100, frequency_hz: 10, policy: RR, cpu: "1", irq_cpu: "0", nodes_hz: 20,
     condition: [cpu80, nodes]}
  - {suite: communication_tests, repetitions: 50, frequency_hz: 50, payload_bytes: 200, subscribers: 2, policy: FIFO,
     middleware: [roscpp, cyclonedds, fastdds, zeromq, tcp, futex]}
"""
# Threads that are the middleware's own, of each program.
OWN_THREADS = {"zeromq": {"ZMQbg/IO/0", "ZMQbg/Reaper"}, "cyclonedds": {"recv", "recvUC", "tev", "gc"}}


# A graph of nodes: a fork, a join, a shared thread, three processes.
GRAPH = """
schema: 1
name: small
common: {policy: FIFO, priority: 40}
nodes:
  lidar:   {period: 200ms, busy: 1ms, outputs: [/points]}
  detect:  {inputs: [/points], busy: 1ms, outputs: [/objects], cpu: 1}
  fuse:    {inputs: [/points, /objects], waits_for: all, outputs: [/state], executor: brain}
  control: {period: 100ms, inputs: [/state], outputs: [/cmd], executor: brain, process: brain}
  brake:   {inputs: [/cmd], process: brain}
paths:
  - {topics: [/points, /objects, /state, /cmd], reaction: 10s}
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The folder of EVERY_SUITE, and of GRAPH, measured on one boot of the board."""
    folder = tmp_path_factory.mktemp("measured")
    write_campaign(folder, EVERY_SUITE)
    (folder / "small.yml").write_text(GRAPH)
    of_graph = "schema: 1\nname: graph\ntopology: small.yml\nfor: 4s\nruns: [{middleware: [roscpp, cyclonedds]}]\n"
    (folder / "graph.yml").write_text(of_graph)
    with connect(read_target(TOP / "targets" / "qemu.yml"), TOP / "targets", folder / "console.log") as board:
        for file in ("campaign.yml", "graph.yml"):
            campaign, runs = read_campaign(folder / file)
            (folder / "results" / campaign.name).mkdir(parents=True)
            place, observer = folder / "results" / campaign.name, Watching()
            statuses = campaign_runner.run_campaign(board, campaign.name, runs, place, observer)
            assert set(statuses.values()) == {"ok"}, (statuses, observer.notes)
    return folder


def runs_of(measured):
    return read_campaign(measured / "campaign.yml")[1]


def read_record(measured, run):
    return json.loads((measured / "results" / "test" / run.name / "run.json").read_text())


def test_the_three_suites_on_the_board(measured, tmp_path):
    for run in runs_of(measured):
        folder = measured / "results" / "test" / run.name
        record = read_record(measured, run)
        assert record["status"] == "ok" and record["platform"] == "emulated"
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
            assert suite["complete"] is True and suite["counts"]["asked"] == run.parameters["repetitions"]
            policy = {"0": "OTHER"}.get(str(run.parameters["policy"]), run.parameters["policy"])
            assert policy in {thread["policy"] for thread in suite["in_effect"]["threads"]}
            assert suite["in_effect"]["mlockall"] is (run.parameters["policy"] != "0")
        for log in drawn:
            shutil.copy(log, tmp_path)
            subprocess.run(["gnuplot", log.name], cwd=tmp_path, check=True)
            assert (tmp_path / log.with_suffix(".jpg").name).read_bytes()[:2] == b"\xff\xd8"


def test_figures_of_a_run_with_three_subscribers(measured, capsys):
    run = runs_of(measured)[3]
    assert run.parameters["subscribers"] == 3
    assert rtrun.cli.main(["show", "--json", str(measured / "results" / "test" / run.name)]) == 0
    results = json.loads(capsys.readouterr().out)["results"]
    assert len(results) == 3
    for result in results:
        assert {"n", "min_us", "mean_us", "max_us", "missing", "out_of_order", "top", "lowest"} <= set(result)
        assert result["n"] + len(result["startup"]) + result["missing"] == 50


def test_messages_through_each_middleware_on_the_board(measured):
    runs = [run for run in runs_of(measured) if run.parameters.get("payload_bytes") == 200]
    assert [run.middleware for run in runs] == ["roscpp", "cyclonedds", "fastdds", "zeromq", "tcp", "futex"]
    for run in runs:
        folder, record = measured / "results" / "test" / run.name, read_record(measured, run)
        assert record["status"] == "ok"
        (sent,) = [json.loads(path.read_text()) for path in folder.glob("*-publisher.json")]
        received = [json.loads((folder / f"{output}.json").read_text()) for output in record["outputs"]]
        assert len(received) == 2
        for record in received:
            assert sent["counts"]["sent"] == record["counts"]["measured"] + record["counts"]["missing"] == 50
        for record in (sent, *received):
            assert record["middleware"] == run.middleware
            threads = record["in_effect"]["threads"]
            assert {(thread["policy"], thread["priority"]) for thread in threads} == {("FIFO", 95)}
            assert {thread["name"] for thread in threads} >= OWN_THREADS.get(run.middleware, set())


def test_a_graph_of_nodes_on_the_board(measured, capsys):
    for name in ("001-topology-small", "002-topology-small-cyclonedds"):
        folder = measured / "results" / "graph" / name
        record = read_topology_record(folder)
        assert {hop.topic for hop in record.hops} == {"/points", "/objects", "/state", "/cmd"}
        for hop in record.hops:
            assert hop.sent == hop.taken + hop.overwritten + hop.unused + sum(hop.lost.values()) > 5
            assert not hop.lost
        (path,) = record.paths
        assert path.reaction.max_ns == path.worst[-1].end_ns and path.nodes[-1] == "brake"
        for node in record.topology.nodes:
            table = read_tables(folder, record.topology).nodes[node.name]
            assert table.cpu_ns.min() >= node.busy_ns
        threads = [
            (thread["name"], thread["policy"], thread["priority"])
            for program in json.loads((folder / "run.json").read_text())["programs"]
            for thread in program["threads"]
        ]
        assert {("lidar", "FIFO", 40), ("brain", "FIFO", 40), ("brake", "FIFO", 40)} <= {*threads}
    assert rtrun.cli.main(["verdict", str(measured / "results" / "graph"), "--probability", "0.5"]) == 0
    assert "not a real-time statement" in capsys.readouterr().out


def test_the_report_says_emulated(measured, tmp_path, capsys):
    page = tmp_path / "report.html"
    assert rtrun.cli.main(["report", str(measured / "results" / "test"), "--output", str(page)]) == 0
    banner = "EMULATED: not a real-time statement"
    assert banner in capsys.readouterr().out and banner in page.read_text()
    assert "middleware=cyclonedds" in page.read_text()


def test_conditions_on_the_board_and_what_was_in_effect(measured):
    with_conditions = [run for run in runs_of(measured) if run.condition in ("cpu80", "nodes")]
    assert len(with_conditions) == 2
    for run in with_conditions:
        record = read_record(measured, run)
        in_effect = record["in_effect"]
        assert (in_effect["policy"], in_effect["priority"], in_effect["cpus"]) == (["RR"], [95], [1])
        assert in_effect["observations"] >= 1 and in_effect["sched_rt_runtime_us"] == [950000]
        rivals = {rival["name"] for rival in in_effect["rivals"]}
        assert "rosmaster" in rivals, "at the priority above the suite's"
        assert in_effect["loads"].keys() == record["requested"]["loads"].keys()
        loads = {"stress"} if run.condition == "cpu80" else {"listener0", "talker0"}
        # The kernel let interrupts be moved, and nobody moved them back: else it had ended, and the run were invalid.
        assert in_effect["loads"].keys() == loads | {"hold-irq_cpu"}


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


# More rows of the cyclic timer are on the disk than one block of 5 s at 10 Hz: the first block is complete.
# A npy has 128 bytes before its rows, a row three numbers of 8 bytes.
FIRST_BLOCK = f"find /var/lib/rt-tests/runs -name '*.npy.part' -size +{128 + 60 * 3 * 8}c"

INTERRUPTED = """
runs:
  - {suite: cyclic_timer_tests, frequency_hz: 10, repetitions: [10, 150], policy: RR}
  - {suite: communication_tests, frequency_hz: 20, repetitions: 60, subscribers: 2, policy: RR, trace: {above: 1us}}
exclude:
  - {trace: "off"}
"""


class Remembering:
    """A context manager that appends what it yields to a list."""

    def __init__(self, context, yielded):
        self.context, self.yielded = context, yielded

    def __enter__(self):
        self.yielded.append(self.context.__enter__())
        return self.yielded[-1]

    def __exit__(self, *words):
        return self.context.__exit__(*words)


@pytest.mark.slow
def test_a_reset_and_then_a_power_cut_in_the_middle_of_a_run(tmp_path, monkeypatch):
    """On one board, as each boot takes its time; the outliers are traced on the board that was reset."""
    _, runs = read_campaign(write_campaign(tmp_path, INTERRUPTED))
    machines = []
    boot = qemu.boot
    monkeypatch.setattr(qemu, "boot", lambda *words: Remembering(boot(*words), machines))
    config = read_target(TOP / "targets" / "qemu.yml")
    with connect(config, TOP / "targets", tmp_path / "console.log") as board:
        (machine,) = machines
        reset_in_the_second_run(board, machine, runs, tmp_path / "results")
        check_figures_after_the_clock_was_set(tmp_path / "results" / runs[0].name)
        check_what_was_cut_off(tmp_path / "results", runs[1])
        check_traces(tmp_path / "results" / runs[2].name)
        power_cut_in_the_second_run(board, machine, runs, tmp_path / "other")


def reset_in_the_second_run(board, machine, runs, results):
    years, resets = [], []

    def set_the_clock():
        connection = Connection(board.address)
        years.append(connection.check(["sh", "-c", "date -s '2031-01-01 00:00:00' && date +%Y"]))
        connection.close()

    def act(number):
        if number == 0:
            # The runner measures nothing with the clock that can be set. Once the timer runs it would be late by years.
            set_the_clock()
        if number == 1 and not resets:
            resets.append(when(machine, FIRST_BLOCK, lambda: qmp.execute(machine.monitor, "system_reset")))

    observer = Watching(act)
    statuses = campaign_runner.run_campaign(board, "test", runs, results, observer)
    resets[0].join()
    assert list(statuses.values()) == ["ok", "ok", "ok"], observer.ends  # the run that was cut off is repeated
    assert years[0].split()[-1] == "2031"
    assert any("the target was restarted" in note for note in observer.notes)
    connection = Connection(board.address)
    instances = connection.check(["ls", "/sys/kernel/tracing/instances"]).split()
    connection.close()
    assert instances == [], "what was set up to trace is taken down"


def check_figures_after_the_clock_was_set(folder):
    first = read_run(folder).results[0]
    assert first.figures.n + len(first.header.startup) == 10 and abs(first.figures.max_ns) < 60e9


def check_what_was_cut_off(results, run):
    assert run_directory.closing_record(results / run.name).status == "ok"
    (kept,) = results.glob("*.incomplete-1")
    assert kept.name == f"{run.name}.incomplete-1" and run_directory.closing_record(kept) is None
    rows = np.load(next(kept.glob("*.npy")))
    assert 1 < len(rows) < 150
    assert (np.diff(rows[:, 0]) > 0).all()
    assert not list(kept.glob("*.json"))


def check_traces(folder):
    covered = []
    for output in json.loads((folder / "run.json").read_text())["outputs"]:
        record = json.loads((folder / f"{output}.json").read_text())
        assert record["traces"]["above_limit"] == 60
        assert record["traces"]["files"] == [f"{output}-trace-{index}.txt" for index in range(16)]
        reception = np.load(folder / f"{output}.npy")[:, 1]
        for index, name in enumerate(record["traces"]["files"]):
            text = (folder / name).read_text()
            at_s = float(re.match(r"# .* ns at index \d+ above 1000 ns, at (\S+) s of ", text)[1])
            assert at_s == pytest.approx(reception[index] / 1e9, abs=1e-6)
            if elsewhere := re.search(r"^# in (.*)$", text, re.M):
                text = (folder / elsewhere[1]).read_text()
            stamps = [float(stamp) for stamp in re.findall(r" (\d+\.\d{6}): sched_switch: ", text)]
            assert at_s < max(stamps)
            covered.append(min(stamps) < at_s)
    # A starved emulated CPU may copy a trace so late that what it is about is overwritten, but not each time.
    assert any(covered)


def power_cut_in_the_second_run(board, machine, runs, results):
    def act(number):
        if number == 1:
            when(machine, FIRST_BLOCK, lambda: qmp.execute(machine.monitor, "quit"))

    with pytest.raises(TargetGone, match=r"the board in QEMU was switched off: QEMU ended \(exit status 0\)"):
        campaign_runner.run_campaign(board, "test", runs, results, Watching(act))
    assert campaign_runner.count_finished(results, runs) == 1, "what was finished is kept"


def qemus_of(console):
    done = subprocess.run(["pgrep", "-f", f"file:.*{console}"], capture_output=True, text=True, check=False)
    return done.stdout.split()


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
