"""Graphs of irobot-ros/ros2-performance: read its JSON into a topology, and report what has no counterpart.

There, every publisher of a node sends on its own timer, whatever has come in. Here, a node that sends takes the newest
of its inputs, so that outputs can be followed back to inputs. In both, all nodes of a file are one process.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from rtfiles.config import Config, Place, matching, read_json
from rtfiles.errors import UsageError
from rtfiles.output import listed
from rtrun.plan.quantities import SIZE_BYTES_MAX, size_text, time_text
from rtrun.plan.topology.topology import NODES_MAX, Executor, Reliability, Topology, TopologyNode, TopologyTopic, Waits

# Interfaces of its plugin packages, which may stand before the type; those of irobot_interfaces_plugin.
_TYPE = re.compile(
    r"(?:[a-z0-9_]+::)?stamped_?(?:([0-9]{1,9})(b|kb|mb)|([0-9]{0,9})_?(int64|int32|float32)|(vector))", re.ASCII
)
_UNITS = {"b": 1, "kb": 2**10, "mb": 2**20, "int64": 8, "int32": 4, "float32": 4}
_SHOWN = 4

Name = Annotated[
    str, matching(r"[A-Za-z][A-Za-z0-9_]{0,63}", "a name of at most 64 letters, digits and _, a letter first")
]
TopicText = Annotated[
    str,
    matching(
        r"(?=.{1,199}$)/?[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*){0,7}",
        "a name of at most 199 letters, digits, _ and /",
    ),
]
Default = Literal["default"]


class EndText(Config):
    """What publishers, subscribers, clients and servers of such a file have in common."""

    qos_depth: Annotated[int, Field(ge=1, le=10_000)] | None = None
    qos_history: Literal["system_default", "keep_last", "keep_all", "unknown"] = "keep_last"
    qos_reliability: Literal["system_default", "reliable", "best_effort", "unknown"] = "reliable"
    qos_durability: Literal["system_default", "transient_local", "volatile", "unknown"] = "volatile"
    qos_liveliness: Literal["system_default", "automatic", "manual_by_topic", "unknown"] = "system_default"
    qos_deadline: Default = "default"
    qos_lifespan: Default = "default"
    qos_liveliness_lease_duration: Default = "default"
    qos_avoid_ros_namespace_conventions: Literal["true", "false"] = "false"
    msg_pass_by: Literal["unique_ptr", "shared_ptr"] | None = None
    period_ms: Annotated[float, Field(ge=10**-3, le=10**7)] | None = None
    freq_hz: Annotated[float, Field(ge=10**-4, le=10**6)] | None = None

    @property
    def period_ns(self) -> int | None:
        """Its period, which the file has in whole microseconds; None: nothing sends it."""
        period_ms = 1000 / self.freq_hz if self.freq_hz else self.period_ms
        return int(period_ms * 1000) * 1000 if period_ms else None


class TopicEnd(EndText):
    """A publisher or a subscriber."""

    topic_name: TopicText
    msg_type: str
    msg_size: Annotated[int, Field(ge=0, le=SIZE_BYTES_MAX)] | None = None

    @property
    def topic(self) -> str:
        """The full name of its topic."""
        return f"/{self.topic_name.removeprefix('/')}"


class ServiceEnd(EndText):
    """A client or a server."""

    service_name: TopicText
    srv_type: str


class NodeText(Config):
    """A node of such a file."""

    node_name: Name
    node_namespace: str | None = None
    executor_id: Annotated[int, Field(ge=0, le=10**6)] = 0
    number: Annotated[int, Field(ge=1, le=NODES_MAX)] | None = None
    publishers: list[TopicEnd] = Field(default_factory=list)
    subscribers: list[TopicEnd] = Field(default_factory=list)
    clients: list[ServiceEnd] = Field(default_factory=list)
    servers: list[ServiceEnd] = Field(default_factory=list)


class GraphText(Config):
    """Such a file."""

    nodes: Annotated[list[NodeText], Field(min_length=1, max_length=NODES_MAX)]


@dataclass(frozen=True, kw_only=True, slots=True)
class OthersGraph:
    """A topology that was read but is not yet known to be sound, and what has no counterpart in it."""

    topology: Topology
    remarks: tuple[str, ...]


def read_graph(path: Path) -> OthersGraph:
    """Read a graph of ros2-performance. Raises UsageError with every mistake found, one a line."""
    graph, top = read_json(path, GraphText), Place(str(path))
    number = sum((text.number or 1) * max(1, len(_by_period(text))) for text in graph.nodes)
    if number > NODES_MAX:
        raise UsageError(f"{top / 'nodes'}: they stand for {number} nodes here, takes {NODES_MAX} or fewer")
    named = [
        (f"{text.node_name}_{copy}" if text.number else text.node_name, text, top / "nodes" / number)
        for number, text in enumerate(graph.nodes)
        for copy in range(1, (text.number or 1) + 1)
    ]
    errors = [*_wrong(named)]
    if errors:
        raise UsageError("\n".join(errors))
    name = re.sub(r"[^A-Za-z0-9_]", "_", path.stem)
    nodes = tuple(node for full, text, _ in named for node in _nodes(full, text))
    if twice := next((name for name, number in Counter(node.name for node in nodes).items() if number > 1), None):
        raise UsageError(f"{top / 'nodes'}: two nodes would be called {twice}: give each a name of its own")
    publishers = {end.topic: end for _, text, _ in named for end in text.publishers}
    topology = Topology(
        name=(name if name[:1].isalpha() else f"graph_{name}")[:64],
        nodes=nodes,
        executors=tuple(
            Executor(name=executor, process=name) for executor in dict.fromkeys(node.executor for node in nodes)
        ),
        topics=tuple(_topic(publishers[topic]) for node in nodes for topic in node.outputs),
    )
    return OthersGraph(topology=topology, remarks=tuple(_remarks([(full, text) for full, text, _ in named])))


def _wrong(named: list[tuple[str, NodeText, Place]]) -> Iterator[str]:
    types: dict[str, str] = {}
    for _, text, where in named:
        for key, ends in (("publishers", text.publishers), ("subscribers", text.subscribers)):
            for number, end in enumerate(ends):
                if _TYPE.fullmatch(end.msg_type) is None:
                    known = "stamped10b (kb, mb), stamped4_int32 (float32, int64) or stamped_vector with msg_size"
                    yield f"{where / key / number / 'msg_type'}: unknown type {end.msg_type[:60]!r}, takes {known}"
                elif _payload_bytes(end) > SIZE_BYTES_MAX:
                    most = size_text(SIZE_BYTES_MAX)
                    yield f"{where / key / number / 'msg_type'}: a message of {end.msg_type}: takes {most} at most"
                elif types.setdefault(end.topic, end.msg_type) != end.msg_type:
                    other = types[end.topic]
                    yield f"{where / key / number / 'msg_type'}: {end.topic} is {end.msg_type} here, {other} before"
                if key == "publishers" and not end.period_ns:
                    yield f"{where / key / number}: nothing would send it: give period_ms or freq_hz"
                if key == "publishers" and end.topic in (other.topic for other in ends[:number]):
                    yield f"{where / key / number}: {end.topic} stands there twice: a topic has one publisher"
    if all(not text.publishers and not text.subscribers for _, text, _ in named):
        yield f"{named[0][2]}: no node publishes or subscribes, and services have no counterpart: nothing is left"


def _nodes(name: str, text: NodeText) -> Iterator[TopologyNode]:
    """One node here for each period at which a node there sends; the first one takes its subscriptions."""
    executor = f"executor{text.executor_id}"
    inputs = tuple(dict.fromkeys(end.topic for end in text.subscribers))
    by_period = _by_period(text)
    for number, (period_ns, topics) in enumerate(sorted(by_period.items())):
        yield TopologyNode(
            name=name if not number else f"{name}_{time_text(period_ns)}",
            executor=executor,
            waits=Waits.PERIOD,
            period_ns=period_ns,
            inputs=() if number else inputs,
            outputs=tuple(topics),
        )
    if inputs and not by_period:
        yield TopologyNode(name=name, executor=executor, waits=Waits.ANY, inputs=inputs)


def _by_period(text: NodeText) -> dict[int, list[str]]:
    """The topics that a node of the file sends, by period."""
    by_period: dict[int, list[str]] = {}
    for end in text.publishers:
        by_period.setdefault(end.period_ns or 0, []).append(end.topic)
    return by_period


def _topic(end: TopicEnd) -> TopologyTopic:
    reliability: Reliability = "best_effort" if end.qos_reliability == "best_effort" else "reliable"
    return TopologyTopic(
        name=end.topic, payload_bytes=_payload_bytes(end), reliability=reliability, depth=end.qos_depth or 10
    )


def _payload_bytes(end: TopicEnd) -> int:
    """Bytes of the payload of a type, without the header that every message has there and here."""
    parts = _TYPE.fullmatch(end.msg_type)
    assert parts is not None
    number, unit, several, element, vector = parts.groups()
    if vector:
        return end.msg_size or 0
    return int(number) * _UNITS[unit] if unit else int(several or 1) * _UNITS[element]


def _remarks(named: list[tuple[str, NodeText]]) -> Iterator[str]:
    """What has no counterpart: each kind of thing once, with its count and places."""
    split = [
        f"{name} ({', '.join(dict.fromkeys(time_text(end.period_ns or 0) for end in text.publishers))})"
        for name, text in named
        if len({end.period_ns for end in text.publishers}) > 1
    ]
    if split:
        yield (
            "a node that sends at several periods is a node for each of them here, in one executor, of which that of "
            f"the shortest period takes the inputs: {listed(split, _SHOWN)}"
        )
    if any(text.publishers and text.subscribers for _, text in named):
        yield "a node that sends takes the newest of its inputs for it; there it sends whatever has come"
    if len({text.executor_id for _, text in named}) == 1 and len(named) > 1:
        yield f"all {len(named)} nodes share one executor, as nodes without executor_id do there"
    twice = [
        f"{name} {topic}"
        for name, text in named
        for topic, number in Counter(end.topic for end in text.subscribers).items()
        if number > 1
    ]
    if twice:
        yield f"left out, a node takes a topic once: further subscriptions of {listed(twice, _SHOWN)}"
    for key in ("clients", "servers"):
        services = [f"{name} {end.service_name}" for name, text in named for end in getattr(text, key)]
        if services:
            yield f"left out, services have no counterpart: {key}: {len(services)}: {listed(services, _SHOWN)}"
    if spaces := [name for name, text in named if text.node_namespace]:
        yield f"left out, nodes have no namespace here: node_namespace of {listed(spaces, _SHOWN)}"
    yield from _remarks_on_ends(named)


def _remarks_on_ends(named: list[tuple[str, NodeText]]) -> Iterator[str]:
    ends = [(name, end) for name, text in named for end in (*text.publishers, *text.subscribers)]
    for key, fine in _WITHOUT_COUNTERPART.items():
        values = [getattr(end, key) for _, end in ends]
        for value, number in Counter(value for value in values if value not in fine).items():
            at = [f"{name} {end.topic}" for name, end in ends if getattr(end, key) == value]
            yield f"left out, it has no counterpart: {key} {value}, {number} times: {listed(at, _SHOWN)}"
    publishers = {end.topic: end for _, text in named for end in text.publishers}
    differ = [
        f"{name} {end.topic}"
        for name, text in named
        for end in text.subscribers
        if (publisher := publishers.get(end.topic)) and _delivery(end) != _delivery(publisher)
    ]
    if differ:
        yield f"reliability and depth are those of the publisher; others at the subscribers {listed(differ, _SHOWN)}"
    sized = [f"{name} {end.topic}" for name, end in ends if end.msg_size and "vector" not in end.msg_type]
    if sized:
        yield f"msg_size is of vectors alone, the type has its own: {listed(sized, _SHOWN)}"


def _delivery(end: TopicEnd) -> tuple[Any, ...]:
    return end.qos_reliability == "best_effort", end.qos_depth or 10


_WITHOUT_COUNTERPART: dict[str, Iterable[object]] = {
    "msg_pass_by": (None,),
    "qos_history": ("keep_last", "system_default"),
    "qos_reliability": ("reliable", "best_effort", "system_default"),
    "qos_durability": ("volatile", "system_default"),
    "qos_liveliness": ("automatic", "system_default"),
    "qos_avoid_ros_namespace_conventions": ("false",),
}
"""Keys of both ends, and their values that change nothing."""
