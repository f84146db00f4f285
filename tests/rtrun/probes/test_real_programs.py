"""Unmodified programs of ROS 2 and ROS 1, observed: each message at both ends, and timers as the programs see them."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from probes import standin
from probes.planted import check_named
from probes.standin import find, observed, running, skip_without_trace

from ports import free_domain
from ros2 import wheels
from rtgen import suites as builder
from rtrun.cli import main
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.probes.libraries.description import events
from rtrun.probes.session import Batch, Began
from suites.test_ros2 import set_up

pytestmark = [pytest.mark.trace, pytest.mark.ros, pytest.mark.timeout(1200)]
COUNT = 2000
TALKER, NODE = (Path(__file__).with_name(f"{name}.py") for name in ("talker", "chain_node"))
LATCHED = Path(__file__).with_name("latched.cpp")
RELEASES = ["kilted", pytest.param("jazzy", marks=pytest.mark.ros2)]


def ros2_environment(distro, tmp_path):
    """Of programs on the wheels; the generated messages of Python among them."""
    prefix = wheels.installed(distro)
    own = {
        "ROS_DOMAIN_ID": str(free_domain()),
        "ROS_LOG_DIR": str(tmp_path / "log"),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": str(next(prefix.glob("lib/python3*/site-packages"))),
        # Else a Python of the wheels starts itself anew.
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }
    return set_up(prefix) | own


@pytest.fixture(scope="module")
def suites_of(tmp_path_factory):
    """The folder of the suites for a release of ROS 2, or for ROS 1."""
    built = {}

    def build(distro):
        if distro not in built:
            ros2 = {"ros2": wheels.installed(distro)} if distro else {}
            built[distro] = builder.build("host", tmp_path_factory.mktemp("suites"), **ros2)
        return built[distro]

    return build


def program(suites, name, middleware):
    (path,) = suites.glob(f"lib/*/{name}{'' if middleware == 'roscpp' else '_' + middleware}")
    return path


def await_libraries(link, pid):
    """Wait until a program that has only just begun has loaded no further one for a second."""
    before = None
    while before != (before := find(link, pid)[0].mapped):
        time.sleep(1)


def watched_exchange(here, listener, talker, environment, folder):
    """Everything that is seen while a program that is there already takes what another publishes that starts then."""
    results = []
    with running(*listener, env=environment, cwd=folder) as receiver:
        await_libraries(here, receiver.pid)
        stream = observed(here, receiver.pid)
        assert isinstance(next(stream), Began)
        with running(*talker, env=environment, cwd=folder) as sender:
            while sender.poll() is None:
                results.append(next(stream))
            assert sender.returncode == 0
        results += [next(stream), next(stream)]
        stream.close()
    return results, (receiver.pid, sender.pid)


def of_topic(results, topic, key, pids):
    """The messages of a topic that these processes published and took: pid and key, in the order of time."""
    hits = [hit for result in results if isinstance(result, Batch) for hit in result.hits if hit.pid in pids]
    assert not [gap for result in results if isinstance(result, Batch) for gap in result.gaps]
    return [
        [
            (hit.pid, *(hit.values[name] for name in key))
            for hit in hits
            if hit.event == event and hit.values["topic"] == topic
        ]
        for event in ("publish", "take")
    ]


@pytest.mark.parametrize("distro", RELEASES)
def test_rclpy(here, distro, tmp_path):
    environment = ros2_environment(distro, tmp_path)
    argv = [sys.executable, TALKER]
    results, pids = watched_exchange(here, [*argv, "listener"], [*argv, "talker", COUNT], environment, tmp_path)
    published, taken = of_topic(results, "/chatter", ["source_ns"], pids)
    assert len(published) == COUNT and [key for _, key in taken] == [key for _, key in published]
    assert {pid for pid, _ in taken} == {pids[0]} and {pid for pid, _ in published} == {pids[1]}
    # Threads that came after the beginning are told as well.
    programs = [observable.program for batch in results if isinstance(batch, Batch) for observable in batch.programs]
    names = {(program.pid, thread.name) for program in programs for thread in program.threads}
    assert {(pid, "dds.ev.0") for pid in pids} <= names
    # The topic's publisher and its timer have names, because the program started while it was observed.
    hits = [hit for result in results if isinstance(result, Batch) for hit in result.hits]
    assert "talker" in {hit.values["name"] for hit in hits if hit.event == "node_init"}
    assert "/chatter" in {hit.values["topic"] for hit in hits if hit.event == "publisher_init"}
    calls = [hit for hit in hits if hit.event == "timer_call" and hit.pid == pids[1]]
    # The second call shows the period of the first.
    assert {hit.values["period_ns"] for hit in calls[1:]} == {10**6} and {hit.values["clock"] for hit in calls} == {
        "ros"
    }
    # ROS time is CLOCK_REALTIME here.
    offset_ns = next(result.clocks[0].offset_ns for result in results if isinstance(result, Batch))
    late_ns = np.array(
        [hit.at_ns + offset_ns - hit.values["expected_ns"] for hit in calls if "expected_ns" in hit.values]
    )
    assert len(late_ns) > 0.9 * len(calls) and late_ns.min() > 0 and np.median(late_ns) < 5e6


@pytest.mark.parametrize("distro", RELEASES)
def test_a_path_through_rclpy(here, distro, tmp_path, monkeypatch):
    """Of each message that a node passes on it is known from which one it came, but for the first."""
    environment = ros2_environment(distro, tmp_path)
    argv = [sys.executable, TALKER]
    monkeypatch.setattr(standin, "EVENTS", events())
    results, pids = watched_exchange(here, [*argv, "relay"], [*argv, "talker", COUNT], environment, tmp_path)
    batches = [result for result in results if isinstance(result, Batch)]
    flows = FlowAccumulator(begin_ns=batches[0].begin_ns, paths=[("/chatter", "/again")])
    flows.observe([])
    for batch in batches:
        flows.feed([*(hit for hit in batch.hits if hit.pid in pids), *batch.gaps])
    (path,) = flows.paths.logs.values()
    assert len(path.rows) + path.unknown == COUNT and path.unknown <= 1
    ends = flows.topics.ends
    (taken,) = [end for key, end in ends.items() if key[:2] == ("subscriber", "/chatter")]
    published = ends["publisher", "/again", taken.label]
    # Each was published after it was taken, and before the next one was.
    taken_ns, published_ns = (end.times.read()[:, 0] for end in (taken, published))
    assert np.array_equal(np.searchsorted(taken_ns, published_ns), np.arange(1, COUNT + 1))
    assert path.rows.read()[:, 1].tolist() == published_ns.tolist()[path.unknown :]


@pytest.mark.parametrize(
    ("distro", "middleware"),
    [(None, "roscpp"), ("kilted", "rcl"), pytest.param("jazzy", "rcl", marks=pytest.mark.ros2)],
)
def test_programs_in_c(here, request, distro, middleware, suites_of, tmp_path):
    if distro:
        environment, key = ros2_environment(distro, tmp_path), ["source_ns"]
    else:
        port = request.getfixturevalue("ros_master")
        own = {
            "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
            "ROS_IP": "127.0.0.1",
            "ROS_LOG_DIR": str(tmp_path / "log"),
        }
        environment, key = os.environ | own, ["key0", "key1", "size"]
    options = ["-r", COUNT, "-f", 1000, "-l", 1000]
    suites = suites_of(distro)
    listener = [program(suites, "communication_tests_subscriber", middleware), *options]
    talker = [program(suites, "communication_tests_publisher", middleware), *options]
    talker += ["--subscribers", 1] if distro else ["-d", 2]
    results, pids = watched_exchange(here, listener, talker, environment, tmp_path)
    published, taken = of_topic(results, "/communication_tests", key, pids)
    assert len(published) == COUNT and {pid for pid, *_ in published} == {pids[1]}
    # An empty message may come before: with it the programs find one another.
    assert [row[1:] for row in taken] == [row[1:] for row in published] and {pid for pid, *_ in taken} == {pids[0]}
    if middleware == "roscpp":
        hits = [hit for result in results if isinstance(result, Batch) for hit in result.hits]
        # Other tests may run the same programs meanwhile.
        on_topic = [hit for hit in hits if hit.values.get("topic") == "/communication_tests" and hit.pid in pids]
        assert len([hit for hit in on_topic if hit.event == "callback_begin"]) == COUNT
        # Where the program publishes, not where a thread of roscpp sends it later.
        assert {hit.tid for hit in on_topic if hit.event == "publish"} == {pids[1]}


def test_a_latched_message_is_no_late_one(here, ros_master, tmp_path):
    """roscpp gives it to each subscriber that comes later: how late, is when the subscriber came."""
    node = tmp_path / "latched"
    libraries = subprocess.run(["pkg-config", "--libs", "roscpp"], check=True, capture_output=True, text=True).stdout
    subprocess.run(["c++", "-O1", "-o", node, LATCHED, *libraries.split()], check=True)
    own = {"ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}", "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(tmp_path)}
    environment, pids, batches = os.environ | own, [], []
    with running(node, "latched_publisher", env=environment, stdin=subprocess.PIPE) as publisher:
        assert publisher.stdout.readline() == "begins\n"
        stream = observed(here, publisher.pid)
        assert isinstance(next(stream), Began)
        publisher.stdin.write("\n")
        publisher.stdin.flush()
        batches += [next(stream), next(stream)]
        for _ in range(2):
            with running(node, "latched_subscriber", env=environment) as subscriber:
                pids.append(subscriber.pid)
                assert subscriber.stdout.readline() == "begins\n" and subscriber.stdout.readline() == "took\n"
                batches += [next(stream), next(stream)]
        stream.close()
    flows = FlowAccumulator(begin_ns=batches[0].begin_ns)
    flows.observe([])
    for batch in batches:
        flows.feed([*(hit for hit in batch.hits if hit.pid in (publisher.pid, *pids)), *batch.gaps])
    flows.finish()
    ends = [flows.topics.ends["subscriber", "/latched", f"process {pid}"] for pid in pids]
    assert [(len(end.times), end.historic, end.received, end.ambiguous) for end in ends] == [(1, 1, 0, 0)] * 2
    assert len(flows.topics.ends["publisher", "/latched", f"process {publisher.pid}"].times) == 1


@pytest.mark.parametrize("distro", RELEASES)
def test_a_timer_as_the_program_sees_it(here, distro, suites_of, tmp_path):
    """When each call was to be: what the probe read of rcl's own members is what rcl has told the program."""
    environment = ros2_environment(distro, tmp_path)
    cyclic = program(suites_of(distro), "cyclic_timer_tests", "rcl")
    with running(cyclic, "-r", 10**6, "-f", 500, env=environment, cwd=tmp_path) as other:
        find(here, other.pid)
        stream = observed(here, other.pid)
        results = [next(stream)]
        subprocess.run(
            [cyclic, "-r", "1000", "-f", "1000"], env=environment, cwd=tmp_path, check=True, capture_output=True
        )
        results += [next(stream) for _ in range(5)]
        stream.close()
    hits = [hit for result in results if isinstance(result, Batch) for hit in result.hits if hit.event == "timer_call"]
    hits = [hit for hit in hits if hit.pid != other.pid]
    (rows,) = [np.load(path) for path in tmp_path.glob("cyclic_timer_tests_l1000*.npy")]
    expected = [hit.values.get("expected_ns") for hit in hits if hit.values.get("period_ns") == 10**6]
    assert len(rows) >= 999
    # The second call shows the period, and when it was due.
    printed = rows[:, 1].tolist()
    assert set(printed) - set(expected) <= {printed[0]}


def test_a_slow_callback_of_the_same_thread_is_what_a_late_message_waited_for(tmp_path, capsys):
    """`rtrun why` names the node's timer for each message that came while it ran: the node says when that was."""
    skip_without_trace()
    environment = ros2_environment("kilted", tmp_path)
    target, results = tmp_path / "here.yml", tmp_path / "results"
    target.write_text("schema: 1\nname: here\nkind: local\n")
    node = [sys.executable, NODE, "slow", "/chatter", "/again", 0.03, 0.25]
    with (
        running(*node, env=environment, cwd=tmp_path) as slow,
        running(sys.executable, TALKER, "talker", 10**6, env=environment, cwd=tmp_path),
    ):
        assert "takes\n" in iter(slow.stdout.readline, "")
        call = ["observe", "--target", str(target), "--for", "4s", "--trace", "above=15ms", "--results", str(results)]
        assert main(call) == 0, capsys.readouterr()
        slow.kill()
        printed = slow.stdout.read()
    (folder,) = results.glob("*-messages-chatter-*chain_node*")
    capsys.readouterr()
    assert main(["why", str(folder), "--json"]) == 0
    name = r"timer 250 ms of chain_node\.py"
    check_named(json.loads(capsys.readouterr().out)["outliers"], printed, name)
    assert main(["why", str(folder), "--all"]) == 0
    pattern = rf"its thread was in a callback: {name}.*, which began .*, took ([\d.]+) ms"
    took = re.findall(pattern, capsys.readouterr().out)
    assert took and min(map(float, took)) >= 30
