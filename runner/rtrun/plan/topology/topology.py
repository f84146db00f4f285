"""A topology: nodes with what each waits for, does and sends; the topics between them, and their threads.

A **node** is activated by one rule, does one piece of work, and then sends one message on each of its outputs: message
number n of each output belongs to activation n. A node with two rules is described as two that share an executor. An
**executor** is one thread, which runs the nodes that share it one activation at a time. A **process** has one executor
or several. A **topic** has one publisher and any number of subscribers.
"""

import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

Policy = Literal["0", "FIFO", "RR"]
Reliability = Literal["reliable", "best_effort"]

NODES_MAX = 256  #: nodes of a topology, each a program or a thread
# The most steps from node to node in a search for paths: some graphs of twenty nodes have too many paths to count.
_STEPS = 10_000


class Waits(StrEnum):
    """What activates a node: its period, each message that comes, or a new message on all of its inputs."""

    PERIOD = "period"
    ANY = "any"
    ALL = "all"


@dataclass(frozen=True, kw_only=True, slots=True)
class TopologyTopic:
    """A topic: `payload_bytes` of each message without its header, and how messages are delivered."""

    name: str
    payload_bytes: int = 0
    reliability: Reliability = "reliable"
    depth: int = 10


@dataclass(frozen=True, kw_only=True, slots=True)
class Executor:
    """A thread. Policy 0 is not real-time and has no priority; no CPUs: all of the target."""

    name: str
    process: str
    policy: Policy = "0"
    priority: int = 0
    cpus: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class TopologyNode:
    """A node. `busy_ns` is the least CPU time of its thread in an activation, in which `touched_bytes` are written.

    With a period it is activated at `offset_ns` + k * `period_ns` after the common start, and takes the newest message
    of each input. `deadline_ns` is the deadline of its response: from when the activation was due to its end.
    """

    name: str
    executor: str
    waits: Waits
    period_ns: int = 0
    offset_ns: int = 0
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    busy_ns: int = 0
    touched_bytes: int = 0
    deadline_ns: int | None = None

    @property
    def full_name(self) -> str:
        """As ROS has it, and the streams of a run."""
        return f"/{self.name}"


@dataclass(frozen=True, kw_only=True, slots=True)
class NamedPath:
    """A sequence of topics along which data flow, with the file's deadlines for these data."""

    topics: tuple[str, ...]
    reaction_ns: int | None = None
    age_ns: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class NodePath:
    """A path: `nodes[i]` publishes `topics[i]`, which `nodes[i + 1]` takes."""

    topics: tuple[str, ...]
    nodes: tuple[str, ...]

    @property
    def name(self) -> str:
        """The parameter `path` of its streams; a deadline names the path like this."""
        return ",".join(self.topics)

    @property
    def sink(self) -> str:
        """The node at its end."""
        return self.nodes[-1]


@dataclass(frozen=True, kw_only=True)
class Topology:
    """A graph that is known to be sound: each topic has exactly one publisher, and each cycle has a period.

    Nodes are in the order of the file, topics in that of their publishers. `paths` are the paths that the file names.
    """

    name: str
    nodes: tuple[TopologyNode, ...]
    executors: tuple[Executor, ...]
    topics: tuple[TopologyTopic, ...]
    paths: tuple[NamedPath, ...] = ()
    may_overload: bool = False

    @functools.cached_property
    def node(self) -> Mapping[str, TopologyNode]:
        """The nodes by name."""
        return {node.name: node for node in self.nodes}

    @functools.cached_property
    def topic(self) -> Mapping[str, TopologyTopic]:
        """The topics by name."""
        return {topic.name: topic for topic in self.topics}

    @functools.cached_property
    def executor(self) -> Mapping[str, Executor]:
        """The executors by name."""
        return {executor.name: executor for executor in self.executors}

    @functools.cached_property
    def publisher(self) -> Mapping[str, TopologyNode]:
        """The node that publishes, by topic."""
        return {topic: node for node in self.nodes for topic in node.outputs}

    @functools.cached_property
    def takers(self) -> Mapping[str, tuple[TopologyNode, ...]]:
        """The nodes that take a topic, by its name."""
        return {topic.name: tuple(node for node in self.nodes if topic.name in node.inputs) for topic in self.topics}

    @property
    def processes(self) -> tuple[str, ...]:
        """The names of the processes, in the order of their first node."""
        return tuple(dict.fromkeys(self.executor[node.executor].process for node in self.nodes))

    @property
    def sources(self) -> tuple[TopologyNode, ...]:
        """The nodes without inputs."""
        return tuple(node for node in self.nodes if not node.inputs)

    def is_sink(self, node: TopologyNode) -> bool:
        """Whether no node takes what it sends."""
        return not any(self.takers[topic] for topic in node.outputs)

    def paths_of(self, topics: tuple[str, ...]) -> tuple[NodePath, ...]:
        """The paths along these topics, one for each node that takes the last one. Raises ValueError for none."""
        for topic in topics:
            if topic not in self.topic:
                raise ValueError(f"no topic is called {topic}, there are {', '.join(self.topic)}")
        for before, after in itertools.pairwise(topics):
            if before not in self.publisher[after].inputs:
                via = self._between(before, after)
                hint = f"; what leads there is {','.join(via)}" if via else ""
                raise ValueError(f"{self.publisher[after].name}, which sends {after}, does not take {before}{hint}")
        nodes = tuple(self.publisher[topic].name for topic in topics)
        if not self.takers[topics[-1]]:
            raise ValueError(f"no node takes {topics[-1]}: a path ends with a node")
        return tuple(NodePath(topics=topics, nodes=(*nodes, last.name)) for last in self.takers[topics[-1]])

    def all_paths(self) -> tuple[NodePath, ...]:
        """Every path from a source to a sink without repeated nodes; of graphs with very many paths, some thousands."""
        before = {node.name: {self.publisher[topic].name for topic in node.inputs} for node in self.nodes}
        sinks = [node.name for node in self.nodes if self.is_sink(node)]
        begun = [NodePath(topics=(), nodes=(source.name,)) for source in reversed(self.sources)]
        found: list[NodePath] = []
        for _ in range(_STEPS):
            if not begun:
                break
            path = begun.pop()
            last = self.node[path.sink]
            if path.topics and last.name in sinks:
                found.append(path)
            # The nodes from which a sink can still be reached through nodes that are not in the path.
            leads = [name for name in sinks if name not in path.nodes]
            seen = {*leads, *path.nodes}
            for name in leads:
                leads += before[name] - seen
                seen |= before[name]
            begun += (
                NodePath(topics=(*path.topics, topic), nodes=(*path.nodes, taker.name))
                for topic in reversed(last.outputs)
                for taker in reversed(self.takers[topic])
                if taker.name in leads
            )
        return tuple(found)

    def _between(self, before: str, after: str) -> tuple[str, ...]:
        """The shortest way from one topic to another, both included; empty where there is none."""
        ways: list[tuple[str, ...]] = [(before,)]
        seen = {before}
        for way in ways:
            if way[-1] == after:
                return way
            onwards = dict.fromkeys(topic for node in self.takers[way[-1]] for topic in node.outputs)
            ways += [(*way, topic) for topic in onwards if topic not in seen]
            seen |= onwards.keys()
        return ()
