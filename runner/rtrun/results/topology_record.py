"""topology.json in the run directory of a topology: its graph, and what became of each node, hop and path."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, TypeAdapter

from rtfiles import atomic
from rtfiles.config import Config, read_json
from rtrun.kinds.limits import Count, TimeNs
from rtrun.plan.topology.topology import Topology

FILE = "topology.json"


class Spread(Config):
    """The distribution of times; None where there are none."""

    median_ns: TimeNs | None
    max_ns: TimeNs | None


class NodeFigures(Config):
    """What became of a node while it was measured."""

    node: str
    activations: Count
    overruns: Count = 0
    """Points of its period that it skipped because the activation before was not over."""
    cpu: Spread
    """CPU time of its thread in an activation, including publishing."""
    response: Spread
    """From the time an activation was due to its end."""
    lateness: Spread
    """From the time an activation was due to its begin."""


class HopFigures(Config):
    """What became of the messages of a topic at a node that receives it.

    sent = taken + overwritten + unused + the sum of `lost`, which is by cause.
    """

    topic: str
    publisher: str
    subscriber: str
    sent: Count
    taken: Count
    overwritten: Count = 0
    """Replaced by a newer one before the node took it, for a node that takes the newest."""
    unused: Count = 0
    """Waiting when the run ended."""
    lost: dict[str, Count] = Field(default_factory=dict)
    latency: Spread
    """From publication to reception."""


class CycleStep(Config):
    """A node's part in a cycle: times from the release of the source, and how its message went on to the next node."""

    node: str
    release_ns: TimeNs
    begin_ns: TimeNs
    done_ns: TimeNs
    """When the work was done and nothing published yet."""
    end_ns: TimeNs
    publication_ns: TimeNs | None = None
    """Both are None for the last node."""
    reception_ns: TimeNs | None = None


class PathFigures(Config):
    """What came along a path, and the cycle with the longest reaction: from an input to the output that it caused."""

    topics: list[str]
    nodes: list[str]
    reaction: Spread
    age: Spread
    worst: list[CycleStep]


def _topology(value: object) -> object:
    # Its lists are tuples, which a strict model does not accept from JSON.
    return TypeAdapter(Topology).validate_python(value, strict=False)


class TopologyRecord(Config):
    """topology.json."""

    schema_number: Literal[1] = Field(alias="schema")
    topology: Annotated[Topology, BeforeValidator(_topology)]
    nodes: list[NodeFigures]
    hops: list[HopFigures]
    paths: list[PathFigures]


def write_topology(folder: Path, record: TopologyRecord) -> None:
    """Write topology.json into the run directory of a topology."""
    atomic.write_text(folder / FILE, record.model_dump_json(by_alias=True, indent=1) + "\n")


def read_topology_record(folder: Path) -> TopologyRecord | None:
    """Read topology.json of a run directory; None where it has none. Raises UsageError for a damaged file."""
    path = folder / FILE
    return read_json(path, TopologyRecord) if path.is_file() else None
