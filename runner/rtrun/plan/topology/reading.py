"""A topology file, read once into a `Topology` that is known to be sound."""

import graphlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from rtfiles.config import Config, Place, matching, parse, read_yaml_with_place
from rtfiles.errors import UsageError
from rtfiles.output import listed
from rtfiles.wording import did_you_mean, unknown
from rtrun.kinds.limits import MEASURING_PRIORITY_MAX
from rtrun.plan.conditions import cpu_set
from rtrun.plan.observation import read_path
from rtrun.plan.quantities import read_size_bytes, read_time_ns
from rtrun.plan.suites import options
from rtrun.plan.topology.rates import overloads
from rtrun.plan.topology.ros2_performance import read_graph
from rtrun.plan.topology.topology import (
    NODES_MAX,
    Executor,
    NamedPath,
    Policy,
    Reliability,
    Topology,
    TopologyNode,
    TopologyTopic,
    Waits,
)

OTHERS_SUFFIX = ".json"
"""The ending of files of irobot-ros/ros2-performance."""


def _cpus(value: object) -> tuple[int, ...]:
    try:
        return tuple(sorted(cpu_set(str(value))))
    except ValueError as error:
        raise ValueError(f"{str(value)[:40]!r} is no list of CPUs like 0-1,4: {error}") from None


def _policy(value: object) -> object:
    # A bare 0 of YAML is a number.
    return str(value) if value == 0 and not isinstance(value, bool) else value


Name = Annotated[
    str, matching(r"[A-Za-z][A-Za-z0-9_]{0,63}", "a name of at most 64 letters, digits and _, a letter first")
]
TopicName = Annotated[
    str,
    matching(
        r"(?=.{1,200}$)(/[A-Za-z][A-Za-z0-9_]*){1,8}",
        "the full name of a topic, of at most 200 characters, which begins with /, as /scan",
    ),
]
Time = Annotated[int, BeforeValidator(read_time_ns)]
Size = Annotated[int, BeforeValidator(read_size_bytes)]
Cpus = Annotated[tuple[int, ...], BeforeValidator(_cpus)]
Priority = Annotated[int, Field(ge=1, le=MEASURING_PRIORITY_MAX)]
Topics = Annotated[tuple[TopicName, ...], Field(strict=False)]


class ThreadEntry(Config):
    """What a file says about the thread that a node runs in; None: nothing."""

    policy: Annotated[Policy | None, BeforeValidator(_policy)] = None
    priority: Priority | None = None
    cpu: Cpus | None = None


class NodeEntry(ThreadEntry):
    """A node as a file has it."""

    period: Time | None = None
    offset: Time | None = None
    inputs: Topics = ()
    waits_for: Literal["any", "all"] | None = None
    busy: Time | None = None
    touches: Size | None = None
    outputs: Topics = ()
    deadline: Time | None = None
    executor: Name | None = None
    process: Name | None = None


class TopicEntry(Config):
    """What a file says about a topic; None: nothing."""

    payload: Size | None = None
    reliability: Reliability | None = None
    depth: Annotated[int, Field(ge=1, le=10_000)] | None = None


class CommonEntry(ThreadEntry, TopicEntry):
    """Defaults for the threads of nodes and for topics."""


class PathEntry(Config):
    """A path as a file has it, with its deadlines."""

    topics: Annotated[tuple[str, ...], BeforeValidator(lambda value: read_path(",".join(map(str, value))))]
    reaction: Time | None = None
    age: Time | None = None


class TopologyEntry(Config):
    """A topology file."""

    schema_: Literal[1] = Field(alias="schema")
    name: Name
    common: CommonEntry = Field(default_factory=CommonEntry)
    nodes: Annotated[dict[Name, NodeEntry], Field(min_length=1, max_length=NODES_MAX)]
    topics: dict[TopicName, TopicEntry] = Field(default_factory=dict)
    paths: Annotated[list[PathEntry], Field(max_length=NODES_MAX)] = Field(default_factory=list)
    may_overload: bool = False
    """Whether to measure it even though it asks for more CPU time than there is."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TopologyFile:
    """The topology that was read; `remarks` list what has no counterpart here in a file of ros2-performance."""

    topology: Topology
    remarks: tuple[str, ...] = ()


def read_topology(path: Path) -> TopologyFile:
    """Read a topology file, or, where it ends in .json, one of irobot-ros/ros2-performance.

    Raises UsageError with every mistake found, one a line.
    """
    if path.suffix == OTHERS_SUFFIX:
        graph = read_graph(path)
        return TopologyFile(topology=sound(graph.topology, Place(str(path))), remarks=graph.remarks)
    data, top = read_yaml_with_place(path)
    entry = parse(data, TopologyEntry, top)
    errors = [*_mistakes(entry, top)]
    if errors:
        raise UsageError("\n".join(errors))
    return TopologyFile(topology=sound(_topology(entry), top))


def sound(topology: Topology, top: Place) -> Topology:
    """Return a topology in which everything can run. Raises UsageError that says what cannot, one a line."""
    errors = [*_unfit(topology, top)]
    if not errors and not topology.may_overload:
        errors = [f"{top}: {text}; may_overload: true measures it all the same" for text in overloads(topology)]
    if errors:
        raise UsageError("\n".join(errors))
    return topology


def _topology(entry: TopologyEntry) -> Topology:
    executors = {}
    for name, node in entry.nodes.items():
        executor = _executor(name, node, entry.common)
        # Any one of the nodes that share an executor may name its process; everything else is the same in all.
        if executor.name not in executors or node.process:
            executors[executor.name] = executor
    nodes = tuple(_node(name, node) for name, node in entry.nodes.items())
    topics = [topic for node in nodes for topic in node.outputs]
    return Topology(
        name=entry.name,
        nodes=nodes,
        executors=tuple(executors.values()),
        topics=tuple(_topic(name, entry.topics.get(name, TopicEntry()), entry.common) for name in topics),
        paths=tuple(NamedPath(topics=path.topics, reaction_ns=path.reaction, age_ns=path.age) for path in entry.paths),
        may_overload=entry.may_overload,
    )


def _executor(name: str, node: NodeEntry, common: ThreadEntry) -> Executor:
    policy = node.policy or common.policy or "0"
    default = int(options()["priority"].default or 0)
    return Executor(
        name=node.executor or name,
        process=node.process or node.executor or name,
        policy=policy,
        priority=0 if policy == "0" else node.priority or common.priority or default,
        cpus=node.cpu if node.cpu is not None else common.cpu or (),
    )


def _node(name: str, node: NodeEntry) -> TopologyNode:
    return TopologyNode(
        name=name,
        executor=node.executor or name,
        waits=Waits.PERIOD if node.period else Waits(node.waits_for or "any"),
        period_ns=node.period or 0,
        offset_ns=node.offset or 0,
        inputs=node.inputs,
        outputs=node.outputs,
        busy_ns=node.busy or 0,
        touched_bytes=node.touches or 0,
        deadline_ns=node.deadline,
    )


def _topic(name: str, topic: TopicEntry, common: CommonEntry) -> TopologyTopic:
    given = common.model_dump(include=set(TopicEntry.model_fields), exclude_none=True)
    given |= topic.model_dump(exclude_none=True)
    return TopologyTopic(
        name=name,
        payload_bytes=given.get("payload", 0),
        reliability=given.get("reliability", "reliable"),
        depth=given.get("depth", 10),
    )


def _mistakes(entry: TopologyEntry, top: Place) -> Iterator[str]:
    """Mistakes of single nodes and topics, and settings on which nodes of one thread disagree."""
    published = {topic for node in entry.nodes.values() for topic in node.outputs}
    for name, node in entry.nodes.items():
        yield from _mistakes_of_node(node, entry.common, top / "nodes" / name)
    for topic in entry.topics:
        if topic not in published:
            yield f"{top / 'topics' / topic}: {unknown('topic', topic, known=sorted(published), label='published')}"
    names = [path.topics for path in entry.paths]
    for number, topics in enumerate(names):
        if topics in names[:number]:
            yield f"{top / 'paths' / number}: the same topics stand in paths.{names.index(topics)}: give them once"
    yield from _disagreements(entry, top / "nodes")


def _mistakes_of_node(node: NodeEntry, common: ThreadEntry, where: Place) -> Iterator[str]:
    if node.period is None and not node.inputs:
        yield f"{where}: nothing activates it: give a period, inputs, or both"
    if node.waits_for and (node.period or not node.inputs):
        instead = "with a period it takes the newest of its inputs" if node.period else "it has no inputs"
        yield f"{where / 'waits_for'}: leave it out: {instead}"
    if node.offset and (node.period is None or node.offset >= node.period):
        yield f"{where / 'offset'}: is the part of a period by which it starts later: less than the period"
    if node.priority and (node.policy or common.policy or "0") == "0":
        yield f"{where / 'priority'}: takes policy FIFO or RR: without one there is no priority"
    for key, topics in (("inputs", node.inputs), ("outputs", node.outputs)):
        for number, topic in enumerate(topics):
            if topic in topics[:number]:
                yield f"{where / key / number}: {topic} stands there twice, give it once"


def _disagreements(entry: TopologyEntry, where: Place) -> Iterator[str]:
    """Conflicting settings for nodes of one thread."""
    first: dict[str, tuple[str, Executor]] = {}
    processes: dict[str, str] = {}
    for name, node in entry.nodes.items():
        executor = _executor(name, node, entry.common)
        other, known = first.setdefault(executor.name, (name, executor))
        for key, earlier, later in (
            ("policy", known.policy, executor.policy),
            ("priority", known.priority, executor.priority),
            ("cpu", known.cpus, executor.cpus),
        ):
            if earlier != later:
                place = where / name / (key if getattr(node, key) is not None else "executor")
                yield f"{place}: {name} and {other} share executor {executor.name}, which is one thread: one {key}"
        if node.process and processes.setdefault(executor.name, node.process) != node.process:
            yield (
                f"{where / name / 'process'}: executor {executor.name} is of process {processes[executor.name]} already"
            )


def _unfit(topology: Topology, top: Place) -> Iterator[str]:
    """Mistakes of the graph as a whole: topics with two publishers or none, cycles, paths that do not exist."""
    publishers: dict[str, str] = {}
    for node in topology.nodes:
        for number, topic in enumerate(node.outputs):
            if publishers.setdefault(topic, node.name) != node.name:
                where = top / "nodes" / node.name / "outputs" / number
                yield f"{where}: {topic} is published by {publishers[topic]} already: a topic has one publisher"
    for node in topology.nodes:
        for number, topic in enumerate(node.inputs):
            if topic not in publishers:
                known = sorted(publishers)
                others = f"{did_you_mean([topic], known)} published: {listed(known, 20)}" if known else " nor anything"
                yield f"{top / 'nodes' / node.name / 'inputs' / number}: no node publishes {topic},{others}"
    if cycle := _cycle_without_period(topology, publishers):
        way = " -> ".join((*cycle, cycle[0]))
        yield (
            f"{top / 'nodes' / cycle[0]}: {way} is a cycle in which no node has a period: none would begin, or "
            "a message go round for ever; give one of them a period"
        )
        return
    for number, path in enumerate(topology.paths):
        try:
            topology.paths_of(path.topics)
        except (ValueError, KeyError) as error:
            yield f"{top / 'paths' / number / 'topics'}: {error}"


def _cycle_without_period(topology: Topology, publishers: Mapping[str, str]) -> Sequence[str]:
    """Nodes that activate one another in a circle; empty: there is no circle."""
    activated = [node for node in topology.nodes if node.waits is not Waits.PERIOD]
    names = {node.name for node in activated}
    before = {
        node.name: [publishers[topic] for topic in node.inputs if publishers.get(topic) in names] for node in activated
    }
    try:
        graphlib.TopologicalSorter(before).prepare()
    except graphlib.CycleError as error:
        return list(error.args[1][:-1])
    return ()
