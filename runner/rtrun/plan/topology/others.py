"""Independent nodes next to a topology: each is a separate process that shares no topic with the topology.

`rtrun influence` measures how much they disturb the topology.
"""

import re
from dataclasses import dataclass, replace
from enum import StrEnum

from rtrun.plan.topology.topology import Executor, Topology, TopologyNode, TopologyTopic, Waits

OTHER_NODES = "other_nodes"
"""The parameter of a run that names the nodes next to its topology; empty: none."""
_TEXT = re.compile(r"([1-9][0-9]?) (idle|busy|publishing)(?: on ([0-9]{1,4}))?", re.ASCII)


class OtherKind(StrEnum):
    """What such a node does."""

    IDLE = "idle"
    """It does nothing, but its middleware runs."""
    BUSY = "busy"
    """It takes 2 ms of CPU time every 10 ms."""
    PUBLISHING = "publishing"
    """It sends 10 kB every 10 ms on its own topic to a receiver, which is another process."""


IDLE_NS = 1_000_000_000
PERIOD_NS = 10_000_000
BUSY_NS = 2_000_000
PAYLOAD_BYTES = 10_000


@dataclass(frozen=True, kw_only=True, slots=True)
class OtherNodes:
    """A number of nodes of one kind; `cpu` is the CPU on which they run, None: any."""

    number: int
    kind: OtherKind
    cpu: int | None = None

    @property
    def text(self) -> str:
        """As `read_other_nodes` takes it."""
        return f"{self.number} {self.kind}" + ("" if self.cpu is None else f" on {self.cpu}")


def read_other_nodes(text: str) -> OtherNodes:
    """Read ``2 busy``, or ``4 idle on 1``. Raises ValueError."""
    match = _TEXT.fullmatch(text)
    if match is None:
        raise ValueError(f"{text[:40]!r}: takes a number and a kind, as 2 busy, or 4 idle on 1")
    return OtherNodes(number=int(match[1]), kind=OtherKind(match[2]), cpu=int(match[3]) if match[3] else None)


def beside(topology: Topology, others: OtherNodes) -> tuple[Topology, tuple[str, ...]]:
    """A topology extended by other nodes, and the names of these nodes.

    They have the policy and the priority of its first thread, so that neither precedes the other.
    """
    taken = {*topology.node, *topology.executor, *topology.processes}
    first = topology.executors[0]
    nodes: list[TopologyNode] = []
    topics: list[TopologyTopic] = []
    for number in range(1, others.number + 1):
        name = f"other{number}"
        while {name, f"{name}_taker"} & taken or f"/{name}" in topology.topic:
            name += "_"
        if others.kind is OtherKind.PUBLISHING:
            topics.append(TopologyTopic(name=f"/{name}", payload_bytes=PAYLOAD_BYTES))
            nodes.append(_periodic(name, PERIOD_NS, outputs=(f"/{name}",)))
            taker = f"{name}_taker"
            nodes.append(TopologyNode(name=taker, executor=taker, waits=Waits.ANY, inputs=(f"/{name}",)))
        elif others.kind is OtherKind.BUSY:
            nodes.append(_periodic(name, PERIOD_NS, busy_ns=BUSY_NS))
        else:
            nodes.append(_periodic(name, IDLE_NS))
    executors = tuple(
        Executor(
            name=node.name,
            process=node.name,
            policy=first.policy,
            priority=first.priority,
            cpus=() if others.cpu is None else (others.cpu,),
        )
        for node in nodes
    )
    both = replace(
        topology,
        nodes=(*topology.nodes, *nodes),
        executors=(*topology.executors, *executors),
        topics=(*topology.topics, *topics),
    )
    return both, tuple(node.name for node in nodes)


def _periodic(name: str, period_ns: int, *, busy_ns: int = 0, outputs: tuple[str, ...] = ()) -> TopologyNode:
    return TopologyNode(
        name=name, executor=name, waits=Waits.PERIOD, period_ns=period_ns, busy_ns=busy_ns, outputs=outputs
    )
