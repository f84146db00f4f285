"""What `rtrun observe --list` says of the graph: asked of a real master, and of a real ROS 2, with nothing placed."""

import os
import subprocess
import sys
import time

import pytest
from probes.standin import SCRIPTS, find, running
from probes.test_real_programs import TALKER, ros2_environment

from rtrun.cli import main
from rtrun.commands._link import linked
from rtrun.execution.ros_graph import read_graph
from rtrun.targets.config import read_target

pytestmark = [pytest.mark.ros, pytest.mark.timeout(600)]


@pytest.fixture
def here(tmp_path):
    """This machine, of `kind: local`. Skips where environments of other programs cannot be read."""
    if os.geteuid():
        pytest.skip("it takes root")
    path = tmp_path / "here.yml"
    path.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/work\n")
    with linked(read_target(path), tmp_path) as link:
        yield link


def test_of_ros_1(here, suites, ros_master, tmp_path):
    environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}", "ROS_IP": "127.0.0.1"}
    folder = suites / "lib" / "communication_tests"
    options = ["-r", 60_000, "-f", 100, "--out-dir", tmp_path, "/communication_tests:=/listed"]
    subscriber = [folder / "communication_tests_subscriber", *options, "--idle-timeout", 60]
    publisher = [folder / "communication_tests_publisher", *options, "-d", 1]
    with running(*subscriber, env=environment) as subscribing, running(*publisher, env=environment) as publishing:
        found = find(here, subscribing.pid, publishing.pid)
        deadline = time.monotonic() + 60
        while set(map(bool, (graph := read_graph(here, SCRIPTS, found)).topics.get("/listed", ()))) != {True}:
            assert time.monotonic() < deadline, graph
            time.sleep(0.2)
        # Of a node that was killed the master still knows.
        publishing.kill()
        publishing.wait()
        later = read_graph(here, SCRIPTS, found)
    publishers, subscribers = graph.topics["/listed"]
    pids = {node.name: node.pid for node in graph.nodes}
    assert ([pids[name] for name in publishers], [pids[name] for name in subscribers]) == (
        [publishing.pid],
        [subscribing.pid],
    )
    assert "/rosout" not in graph.topics and not [name for node in graph.nodes for name in node.serves]
    assert [node.pid for node in later.nodes if node.name in publishers] == [None]


def test_of_ros_2(here, tmp_path, capsys):
    """A relay between two topics, as the command prints it."""
    environment = ros2_environment("kilted", tmp_path)
    with running(sys.executable, TALKER, "relay", env=environment, cwd=tmp_path) as relay:
        find(here, relay.pid)
        wanted = {"node /relay", "topic /again: /relay to nobody", "topic /chatter: nobody to /relay"}
        deadline, lines = time.monotonic() + 60, []
        # A node that came up a moment ago on a busy machine may not be seen at once.
        while not wanted <= set(lines):
            assert time.monotonic() < deadline, lines
            assert main(["observe", "--target", str(tmp_path / "here.yml"), "--list"]) == 0
            lines = capsys.readouterr().out.splitlines()
        assert not [line for line in lines if "_rtrun_list" in line or "get_parameters" in line]


def test_a_master_that_does_not_answer_is_said(here, suites, tmp_path):
    environment = os.environ | {"ROS_MASTER_URI": "http://127.0.0.1:1", "ROS_LOG_DIR": str(tmp_path)}
    program = suites / "lib" / "communication_tests" / "communication_tests_subscriber"
    with running(
        program, "-r", 10, "-f", 10, "--out-dir", tmp_path, env=environment, stderr=subprocess.DEVNULL
    ) as subscribing:
        graph = read_graph(here, SCRIPTS, find(here, subscribing.pid))
    assert graph.nodes == ()
    assert graph.remarks[0].startswith("the ROS master http://127.0.0.1:1 does not answer on the target")
