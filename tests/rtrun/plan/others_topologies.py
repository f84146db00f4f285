"""`make test-topologies DIR=`: the graphs of irobot-ros/ros2-performance, irobot_benchmark/topology, are read whole."""

import json
import os
from collections import Counter
from pathlib import Path

import pytest
from plan.test_topology import CAMPAIGN, RUNS, arrows, drawn, write

from rtrun.plan.campaign import read_campaign
from rtrun.plan.topology.node_text import process_text
from rtrun.plan.topology.reading import read_topology

FOLDER = Path(os.environ["TOPOLOGIES"])


@pytest.mark.parametrize("name", ["cedar", "mont_blanc", "sierra_nevada", "white_mountain"])
def test_every_publisher_and_subscription_of_the_file_stands_in_the_topology_once(tmp_path, name):
    path = FOLDER / f"{name}.json"
    theirs = json.loads(path.read_text())["nodes"]
    topology = read_topology(path).topology
    sent = Counter(f"/{end['topic_name']}" for node in theirs for end in node.get("publishers", []))
    assert Counter(topic for node in topology.nodes for topic in node.outputs) == sent
    taken = Counter(
        (node["node_name"], f"/{end['topic_name']}") for node in theirs for end in node.get("subscribers", [])
    )
    assert Counter((node.name, topic) for node in topology.nodes for topic in node.inputs) == taken
    assert len(topology.executors) == len({node.get("executor_id", 0) for node in theirs})
    assert drawn(topology) == arrows(topology)
    _, runs = read_campaign(write(tmp_path, CAMPAIGN.format(path) + RUNS, "campaign.yml"))
    lines = process_text(runs[0].subject, name).splitlines()
    assert sum(line.startswith("node ") for line in lines) == len(topology.nodes)
    assert sum(line.startswith("in ") for line in lines) == sum(taken.values())
