"""Graphs of nodes, really run: each path is a run, and nothing that was sent is uncounted."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from ports import free_domain, free_port
from ros2 import wheels
from rtfiles.errors import UsageError
from rtgen import suites as builder
from rtrun.cli import main
from rtrun.flows.topology.chains import ages, origins
from rtrun.flows.topology.fates import fates
from rtrun.flows.topology.tables import read_tables
from rtrun.plan.topology.node_text import process_text
from rtrun.plan.topology.planning import WARM_UP_NS, TopologyPlan
from rtrun.plan.topology.rates import period_points
from rtrun.plan.topology.reading import read_topology
from rtrun.results.topology_record import read_topology_record

from .conftest import end, launch, wait_until

# Each asks the machine for most of a CPU.
pytestmark = [pytest.mark.ros, pytest.mark.xdist_group("topology")]

RTRUN = [sys.executable, "-c", "import sys; from rtrun.cli import main; sys.exit(main(sys.argv[1:]))"]
# Each rule by which a node is activated, a shared thread and a shared process, a fork and a join, too small a queue,
# too short a period.
GRAPH = """
schema: 1
name: braking
common: {policy: FIFO, priority: 30}
nodes:
  lidar:   {period: 20ms, busy: 1ms, outputs: [/points], priority: 20}
  imu:     {period: 5ms, offset: 1ms, outputs: [/imu]}
  detect:  {inputs: [/points], busy: 2ms, touches: 1MB, outputs: [/objects], cpu: 0}
  fuse:    {inputs: [/objects, /imu], waits_for: all, outputs: [/state], executor: brain}
  control: {period: 10ms, inputs: [/state], busy: 100us, outputs: [/cmd], deadline: 900ms, executor: brain}
  brake:   {inputs: [/cmd], process: brain}
  slow:    {inputs: [/imu], busy: 12ms, policy: 0}
  over:    {period: 100ms, busy: 130ms, policy: 0, executor: slow, deadline: 60s}
topics:
  /points: {payload: 20kB}
  /imu: {depth: 2, reliability: best_effort}
paths:
  - {topics: [/points, /objects, /state, /cmd], reaction: 900ms, age: 900ms}
  - {topics: [/imu, /state, /cmd], age: 900ms}
may_overload: true
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "braking.yml").write_text(GRAPH)
    return tmp_path


def write(place, suites, *middlewares, target=""):
    # A domain of ROS 2 and of DDS that nobody else on this machine uses meanwhile.
    (place / "campaign.yml").write_text(
        f"schema: 1\nname: braking\ntopology: braking.yml\nfor: 1500ms\ncommon: {{domain_id: {free_domain()}}}\n"
        f"runs: [{{middleware: [{', '.join(middlewares)}]}}]\n"
    )
    (place / "target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {suites}\n{target or f'ros_master_port: {free_port()}'}\n"
    )
    return ["run", "campaign.yml", "--target", "target.yml"]


def records(place):
    return {path.parent.name: json.loads(path.read_text()) for path in place.glob("results/*/*/run.json")}


def check(folder, middleware):
    """Tables, figures and streams of a run tell the same, every message has one fate; the periods that one skipped."""
    streams = [path for path in folder.parent.glob(f"{folder.name}-*") if path.is_dir()]
    record = read_topology_record(folder)
    tables = read_tables(folder, record.topology)
    for node, figures in zip(record.topology.nodes, record.nodes, strict=True):
        table = tables.nodes[node.name]
        assert figures.activations == table.release_ns.size - table.first > 0
        assert table.cpu_ns.min() >= node.busy_ns
        if node.period_ns:
            due = table.release_ns - tables.hosts[record.topology.executor[node.executor].process].start_ns
            assert ((due - node.offset_ns) % node.period_ns == 0).all() and (np.diff(due) > 0).all()
            # Each point of its grid that was measured has an activation, or was skipped.
            measured = period_points(node, 2 * 10**9) - period_points(node, WARM_UP_NS)
            assert figures.activations + figures.overruns == measured
    for hop, figures in zip(tables.hops, record.hops, strict=True):
        of_hop = fates(tables, hop)
        # Counted another way: by the set of numbers that came, and what took them.
        publisher = tables.nodes[hop.publisher]
        sent = set(range(publisher.first, publisher.release_ns.size))
        came = set(hop.seq.tolist()) & sent
        input_ = record.topology.node[hop.subscriber].inputs.index(hop.topic)
        taken = set(tables.nodes[hop.subscriber].taken[input_].tolist()) & came
        assert (figures.sent, figures.taken) == (len(sent), len(taken))
        assert sum(figures.lost.values()) == len(sent - came)
        assert figures.sent == figures.taken + figures.overwritten + figures.unused + sum(figures.lost.values())
        if record.topology.topic[hop.topic].reliability == "reliable":
            assert not figures.lost, (middleware, figures)
        assert of_hop.duplicates == 0
    (over,) = (node for node in record.nodes if node.node == "over")
    assert over.overruns >= 2, "of 15 periods of 100 ms it is done with one in 130 ms"
    (lossy,) = (hop for hop in record.hops if hop.subscriber == "slow")
    assert lossy.lost, "a node that takes twice its time loses nothing of a queue of two"
    (join,) = (hop for hop in record.hops if (hop.subscriber, hop.topic) == ("fuse", "/imu"))
    assert join.overwritten >= join.taken
    suites = {path: json.loads((path / "run.json").read_text()) for path in streams}
    assert all(run["parameters"]["middleware"] == middleware for run in suites.values())
    assert sum(run["suite"] == "observed_messages" for run in suites.values()) == len(record.hops)
    for number, path in enumerate(record.paths):
        of_path = {
            run["suite"]: np.load(folder / f"{folder.name}.npy")
            for folder, run in suites.items()
            if run["parameters"].get("path") == ",".join(path.topics)
        }
        reaction, age = (
            of_path[f"observed_{name}"][:, 1] - of_path[f"observed_{name}"][:, 0] for name in ("paths", "ages")
        )
        assert (path.reaction.max_ns, path.age.max_ns) == (reaction.max(), age.max())
        # No output is older than the answer to what came next.
        assert path.worst[-1].end_ns == reaction.max() and path.worst[0].release_ns >= 0
        for before, after in zip(path.worst, path.worst[1:], strict=False):
            assert before.done_ns <= before.publication_ns <= before.reception_ns <= after.begin_ns, number
    return over.overruns


@pytest.mark.root
def test_through_roscpp_and_cyclone(suites, place, capsys):
    assert main(write(place, suites, "roscpp", "cyclonedds")) == 0, capsys.readouterr()
    found, overruns = records(place), []
    assert {record["status"] for record in found.values()} == {"ok"}
    for name, middleware in (("001-topology-braking", "roscpp"), ("002-topology-braking-cyclonedds", "cyclonedds")):
        overruns.append(check(place / "results/braking" / name, middleware))
        threads = {
            thread["name"]: (thread["policy"], thread["priority"], thread["cpus"])
            for program in found[name]["programs"]
            for thread in program["threads"]
        }
        assert threads["lidar"][:2] == ("FIFO", 20) and threads["brain"][:2] == ("FIFO", 30)
        assert threads["slow"][:2] == ("OTHER", 0) and threads["detect"] == ("FIFO", 30, [0])
    deadlines = Counter(record["suite"] for record in found.values() if record.get("deadline_ns") == 900_000_000)
    assert deadlines == {"observed_ages": 4, "observed_paths": 2, "observed_responses": 2}
    question = ["results/braking", "--probability", "0.5", "--confidence", "0.9"]
    assert main(["gate", *question, "--platform", "virtual"]) in (0, 1)
    printed = capsys.readouterr().out
    assert printed.count("/points,/objects,/state,/cmd") >= 4 and "response of /control" in printed
    # What was due and never done is a miss, however long the deadline is.
    assert main(["verdict", "results/braking", "--json", *question[1:]]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    verdicts = [group["verdict"] for group in groups if group["group"].startswith("response of /over")]
    assert [verdict["absent"] for verdict in verdicts] == overruns and [verdict["n"] for verdict in verdicts] == [
        15,
        15,
    ]
    assert main(["report", "results/braking", "--probability", "0.5", "--output", "report.html"]) == 0
    # A process that says less than all of its periods is not believed.
    damaged = Path(shutil.copytree("results/braking/001-topology-braking", "damaged"))
    process_record = damaged / "process-slow.json"
    process_record.write_text(
        re.sub(r'"skipped": *([0-9]+)', lambda match: f'"skipped": {int(match[1]) + 1}', process_record.read_text())
    )
    with pytest.raises(UsageError, match=r"over\.npy: \d+ activations and \d+ skipped are not the 20 points"):
        read_tables(damaged, read_topology_record(damaged).topology)


@pytest.fixture(scope="module")
def on_ros2(tmp_path_factory):
    prefix = wheels.installed("kilted")
    return prefix, builder.build("host", tmp_path_factory.mktemp("suites"), ros2=prefix)


@pytest.mark.root
def test_through_rcl(on_ros2, place, capsys):
    prefix, suites = on_ros2
    words = write(place, suites, "rcl", target=f"ros_setup: {prefix}/setup.sh")
    assert main(words) == 0, capsys.readouterr()
    assert {record["status"] for record in records(place).values()} == {"ok"}
    check(place / "results/braking/001-topology-braking-rcl", "rcl")


@pytest.mark.root
def test_a_node_that_dies_ends_the_run_with_its_name(suites, place):
    """The others are ended, nothing of them is left, and the run is measured again by the next call."""
    words = write(place, suites, "cyclonedds").copy()
    text = (place / "campaign.yml").read_text().replace("1500ms", "60s")
    (place / "campaign.yml").write_text(text)
    with subprocess.Popen([*RTRUN, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as runner:
        wait_for("*/*/ready.detect", place, runner)
        time.sleep(2)
        started = hosts(place)
        assert len(started) == 5
        os.kill(started["process-detect"], signal.SIGKILL)
        printed, _ = runner.communicate(timeout=90)
    assert runner.returncode == 3, printed
    (record,) = records(place).values()
    assert record["status"] == "failed"
    assert record["reason"].startswith("process-detect ended while process-lidar was running"), record["reason"]
    assert hosts(place) == {}


LAUNCHED = """
schema: 1
name: launched
nodes:
  lidar:   {period: 50ms, busy: 1ms, outputs: [/points], process: sensing}
  detect:  {inputs: [/points], busy: 5ms, outputs: [/objects], process: sensing}
  control: {period: 10ms, inputs: [/objects], busy: 100us, outputs: [/cmd]}
  brake:   {inputs: [/cmd], process: control}
topics: {/points: {payload: 20kB}}
"""


def test_the_launch_file_hosts_the_graph_beside_it(bench):
    graph = bench.folder / "graph.yml"
    graph.write_text(LAUNCHED)
    topology = read_topology(graph).topology
    for process in topology.processes:
        text = process_text(TopologyPlan(topology=topology, for_s=5, paths=()), process)
        assert (bench.suites / f"share/topology_tests/launch/{process}.topology").read_text() == text
    printed = launch(bench, "topology_tests", "topology_tests", f"folder:={bench.folder}")
    assert printed.count("process has finished cleanly") == 2, printed
    tables = read_tables(bench.folder, topology)
    assert all(fates(tables, hop).taken > 10 for hop in tables.hops)
    (path,) = topology.all_paths()
    assert ages(tables, path, origins(tables, path)[0]).end_ns.size > 10


def test_a_program_that_ros_ends_is_not_whole(bench):
    """Another one takes its name: the master ends the first, which would publish to nobody until its time is over."""
    graph = bench.folder / "graph.yml"
    graph.write_text(LAUNCHED[: LAUNCHED.index("  control:")] + "topics: {/points: {payload: 20kB}}\n")
    plan = TopologyPlan(topology=read_topology(graph).topology, for_s=30, paths=())
    (bench.folder / "sensing.topology").write_text(process_text(plan, "sensing"))
    programs = []
    for folder in ("first", "second"):
        (bench.folder / folder).mkdir()
        programs.append(bench.start("topology_node", "sensing.topology", "--out-dir", folder, "__name:=sensing"))
        wait_until(lambda folder=folder: any((bench.folder / folder).glob("ready.*")), programs[-1])
    ended = end(programs[0])
    programs[1].kill()
    (record,) = (bench.folder / "first").glob("process-*.json")
    written = json.loads(record.read_text())
    assert (ended.status, written["complete"], written["incomplete_reason"]) == (1, False, "ended by ROS"), ended


def hosts(place):
    """The processes of nodes that run, by the name of their program."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            words = (path / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if words[0].endswith(b"topology_node_cyclonedds") and str(place).encode() in words[1]:
            found[Path(words[1].decode()).stem] = int(path.name)
    return found


@pytest.mark.slow
def test_influence_is_measured_in_turn_and_told_of_each_path(suites, place, capsys):
    (place / "braking.yml").write_text(CHAIN.replace("300ms, offset: 100ms, busy: 20ms", "1s"))
    write(place, suites, "roscpp")
    words = ["influence", "braking.yml", "--of", "other_nodes", "--target", "target.yml", "--middleware", "roscpp"]
    words += ["--kinds", "busy", "--nodes", "2", "--cpu", "1", "--for", "1s", "--repeats", "3", "--json"]
    assert main(words) == 0
    first = json.loads(capsys.readouterr().out)
    measured = {name: record for name, record in records(place).items() if record["suite"] == "topology"}
    assert Counter(record["parameters"]["other_nodes"] for record in measured.values()) == {"": 3, "2 busy on 1": 3}
    # Of the other nodes nothing is kept, and nothing is measured again.
    assert not any("other1" in name for name in records(place))
    assert main(words) == 0
    assert {name: record for name, record in records(place).items() if record["suite"] == "topology"} == measured
    assert json.loads(capsys.readouterr().out) == first
    rows = first["influence"]["rows"]
    assert [row["beside it"] for row in rows] == ["nothing", "2 busy on 1"] * 2
    assert all(row["mean"] != "-" for row in rows)


# The last node has the CPU of the second one for 20 ms, above all of its threads, three times a second.
CHAIN = """
schema: 1
name: chain
common: {policy: FIFO, priority: 10}
nodes:
  sensor:      {period: 5ms, outputs: [/scan], cpu: 0}
  filter:      {inputs: [/scan], outputs: [/objects], cpu: 1}
  control:     {inputs: [/objects], cpu: 0}
  planted_hog: {period: 300ms, offset: 100ms, busy: 20ms, cpu: 1, priority: 50}
paths:
  - {topics: [/scan, /objects], reaction: 8ms}
"""


@pytest.mark.trace
@pytest.mark.xdist_group("trace")
def test_a_path_agrees_with_what_is_observed_of_it_and_both_tell_why_it_was_late(on_ros2, place, capsys):
    prefix, suites = on_ros2
    (place / "braking.yml").write_text(CHAIN)
    words = write(place, suites, "rcl", target=f"ros_setup: {prefix}/setup.sh")
    (place / "campaign.yml").write_text((place / "campaign.yml").read_text().replace("1500ms", "20s"))
    with subprocess.Popen([*RTRUN, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as runner:
        wait_for("*/*/ready.planted_hog", place, runner)
        time.sleep(1)
        observing = ["--path", "/scan,/objects", "--trace", "above=8ms", "--results", "observed"]
        assert main(["observe", "--target", "target.yml", "--for", "5s", *observing]) == 0, capsys.readouterr()
        printed, _ = runner.communicate(timeout=120)
    assert runner.returncode == 0, printed
    run = place / "results/braking/001-topology-chain-rcl"
    tables = read_tables(run, read_topology_record(run).topology)
    scan, objects = tables.hops
    (observed,) = place.glob("observed/*-paths-*")
    rows = np.load(observed / f"{observed.name}.npy")
    assert len(rows) > 100, "beside other work the probes rest at times"
    # Each message was seen between the stamp that it carries and its reception, and each result with its own cause.
    begun, ended = (
        np.searchsorted(hop.publication_ns, times, "right") - 1
        for hop, times in zip((scan, objects), rows.T, strict=True)
    )
    assert (rows[:, 0] <= scan.reception_ns[begun]).all() and (rows[:, 1] <= objects.reception_ns[ended]).all()
    assert (tables.nodes["filter"].taken[0][objects.seq[ended]] == scan.seq[begun]).all()
    capsys.readouterr()
    assert main(["why", str(observed)]) == 0
    first = capsys.readouterr().out.partition("\n")[0]
    assert "thread of higher priority planted_hog" in first, first
    # The nodes themselves tell which of them it was.
    assert main(["why", str(run)]) == 0
    first = capsys.readouterr().out.partition("\n")[0]
    (stream,) = place.glob("results/braking/001-*-paths-*")
    assert main(["why", str(stream)]) == 0
    assert capsys.readouterr().out.partition("\n")[0] == first, "a stream is of its run"
    assert re.match(r"(filter|/scan is on its way to filter)\b.* of what made /scan,/objects -> control late", first), (
        first
    )


def wait_for(pattern, place, runner):
    """Wait for a file of a run on the target."""
    deadline = time.monotonic() + 60
    while not list(place.glob(f"state/rt-tests/runs/{pattern}")):
        assert time.monotonic() < deadline and runner.poll() is None, runner.communicate()
        time.sleep(0.1)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("topology 1", "topology 2"), ":1: takes an integer from 1 to 1, got '2'"),
        (("node 0 a 0", "node 1 a 0"), ":6: takes an integer from 0 to 0, got '1'"),
        (("node 0 a 0", "node 0 a 1"), "takes an integer from 0 to 0, got '1'"),
        (("period 1000000 0", "never 1000000 0"), "takes period|any|all, got 'never'"),
        (("executor 0 a 0 0 -", "executor 0 a 0 0"), "ends too early"),
        (("end\n", ""), "its last line is not 'end': it is not whole"),
        (("end", "sleep 1\nend"), "begins with 'sleep', which no line does"),
        (("reliable 10", "reliable 10 10"), "has a word too many: '10'"),
    ],
)
def test_a_text_that_is_wrong_is_refused_by_its_line(suites, tmp_path, change, reason):
    text = (
        "topology 1\nprocess a 1\nmeasure 1000000\ntopic 0 /t 0 reliable 10\nexecutor 0 a 0 0 -\n"
        "node 0 a 0 period 1000000 0 0 0 1\nout 0 0 0 0\nend\n"
    )
    (tmp_path / "a.topology").write_text(text.replace(*change))
    (program,) = suites.glob("lib/*/topology_node_cyclonedds")
    done = subprocess.run(
        [program, tmp_path / "a.topology", "--out-dir", tmp_path],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert reason in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.topology"]
