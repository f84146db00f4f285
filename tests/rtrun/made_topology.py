"""A run of a topology as the runner leaves it, with made-up figures of no machine, for tests of their readers."""

from itertools import pairwise
from pathlib import Path
from typing import Any

from written import write_record

from rtrun.plan.topology.rates import rates_hz
from rtrun.plan.topology.reading import read_topology
from rtrun.plan.topology.topology import Topology
from rtrun.results.topology_record import (
    CycleStep,
    HopFigures,
    NodeFigures,
    PathFigures,
    Spread,
    TopologyRecord,
    write_topology,
)

SECONDS = 10
HOP_NS = 60_000
# Of a node: what it works beside its busy time, and waits before it begins.
WORK_NS, LATE_NS = 40_000, 25_000


def made_topology(topology: Topology, **changed: Any) -> TopologyRecord:
    """Figures of each node, hop and path, the longest twice as long as the median; `changed` replaces parts."""
    rates = rates_hz(topology)
    hops = [
        (topic, node, taker) for node in topology.nodes for topic in node.outputs for taker in topology.takers[topic]
    ]
    paths = [path for named in topology.paths for path in topology.paths_of(named.topics)] or topology.all_paths()[:8]
    parts: dict[str, Any] = {
        "nodes": [
            NodeFigures(
                node=node.name,
                activations=round(SECONDS * rates[node.name]),
                cpu=spread(node.busy_ns + WORK_NS),
                response=spread(node.busy_ns + WORK_NS + LATE_NS),
                lateness=spread(LATE_NS),
            )
            for node in topology.nodes
        ],
        "hops": [
            HopFigures(
                topic=topic,
                publisher=node.name,
                subscriber=taker.name,
                sent=(sent := round(SECONDS * rates[node.name])),
                taken=(taken := min(sent, round(SECONDS * rates[taker.name]))),
                overwritten=sent - taken,
                latency=spread(HOP_NS),
            )
            for topic, node, taker in hops
        ],
        "paths": [
            PathFigures(
                topics=list(path.topics),
                nodes=list(path.nodes),
                worst=(worst := cycle(topology, path.nodes)),
                reaction=Spread(median_ns=worst[-1].end_ns // 2, max_ns=worst[-1].end_ns),
                age=Spread(median_ns=worst[-1].end_ns // 3, max_ns=worst[-1].end_ns // 2),
            )
            for path in paths
        ],
    }
    return TopologyRecord(schema=1, topology=topology, **(parts | changed))


def spread(median_ns: int) -> Spread:
    """A time, and twice as much as the longest."""
    return Spread(median_ns=median_ns, max_ns=2 * median_ns)


def cycle(topology: Topology, nodes: tuple[str, ...]) -> list[CycleStep]:
    """A cycle in which each node waits for its period, its thread, its work, and its message."""
    steps, at = [], 0
    for name, following in [*pairwise(nodes), (nodes[-1], "")]:
        node = topology.node[name]
        release = -(-at // node.period_ns) * node.period_ns if node.period_ns and at else at
        begin = release + LATE_NS
        done = begin + node.busy_ns + WORK_NS
        published, received = (done + 5_000, done + 5_000 + HOP_NS) if following else (None, None)
        steps.append(
            CycleStep(
                node=name,
                release_ns=release,
                begin_ns=begin,
                done_ns=done,
                end_ns=done + 10_000,
                publication_ns=published,
                reception_ns=received,
            )
        )
        at = received or done
    return steps


def write_topology_run(folder: Path, record: TopologyRecord, **changed: Any) -> Path:
    """Close a run directory of a topology beside which no stream stands."""
    folder.mkdir(parents=True)
    write_topology(folder, record)
    parameters = {"topology": record.topology.name, "middleware": "rcl"}
    write_record(folder, "topology", [], parameters, **changed)
    return folder


def topology_of(folder: Path, text: str, name: str = "graph.yml") -> Topology:
    """The topology in a file with this text."""
    (folder / name).write_text(text)
    return read_topology(folder / name).topology
