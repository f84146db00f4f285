"""Paths through a topology: from which activation of the source an activation of the sink results.

An activation at the end of a path took a message that an activation of the node before published, and so on. Reaction
and age are those of Feiertag, Richter, Nordlander and Jonsson, "A compositional framework for end-to-end path delay
calculation of automotive systems under different path semantics", CRTS 2008: first to first and last to last, from
the release of the source to the end of the sink.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rtrun.flows.topology.tables import NONE, HopTable, NodeTable, TopologyTables
from rtrun.kinds.values import Int64s
from rtrun.plan.topology.topology import NodePath


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Spans:
    """From when to when, int64 (n,) each; `activation`, int64 (n,), is that of the sink at each end."""

    begin_ns: Int64s
    end_ns: Int64s
    activation: Int64s


def origins(tables: TopologyTables, path: NodePath) -> tuple[Int64s, ...]:
    """For each node of a path, from source to sink: the activations from which those of the sink result.

    Each is int64 of shape (activations of the sink,); NONE where a node had taken nothing of the path.
    """
    rows = np.arange(tables.nodes[path.sink].release_ns.size)
    found = [rows]
    for topic, name in zip(reversed(path.topics), reversed(path.nodes[1:]), strict=True):
        taken = tables.nodes[name].taken[tables.topology.node[name].inputs.index(topic)]
        # Index NONE reads the last element, but `where` keeps NONE in such rows.
        rows = np.where(rows == NONE, NONE, taken[rows]) if taken.size else np.full(rows.size, NONE)
        found.append(rows)
    return tuple(reversed(found))


def ages(tables: TopologyTables, path: NodePath, origin: Int64s) -> Spans:
    """The age of the data at the end of each activation of the sink; `origin` is theirs at the source."""
    source, sink = tables.nodes[path.nodes[0]], tables.nodes[path.sink]
    rows = np.flatnonzero(origin != NONE)
    rows = rows[(rows >= sink.first) & (origin[rows] >= source.first)]
    return Spans(begin_ns=source.release_ns[origin[rows]], end_ns=sink.end_ns[rows], activation=rows)


def reactions(tables: TopologyTables, path: NodePath, origin: Int64s) -> Spans:
    """From each activation of the source to the first activation of the sink with its data, or with later data.

    Activations to which the sink had not reacted when the run ended are left out: see `unanswered`.
    """
    source, sink = tables.nodes[path.nodes[0]], tables.nodes[path.sink]
    # The latest data at the sink: older data may overtake newer ones through a queue.
    known = np.maximum.accumulate(origin) if origin.size else origin
    begun = np.arange(source.first, source.release_ns.size)
    first = np.searchsorted(known, begun)
    is_answered = first < known.size
    begun, first = begun[is_answered], first[is_answered]
    return Spans(begin_ns=source.release_ns[begun], end_ns=sink.end_ns[first], activation=first)


def unanswered(tables: TopologyTables, path: NodePath, answered: Spans) -> int:
    """The number of activations of the source to which the sink never reacted, though the run lasted long enough.

    Long enough is twice the longest measured reaction; for later activations no reaction could be seen. `answered` are
    the reactions, at least one.
    """
    source = tables.nodes[path.nodes[0]]
    enough_ns = 2 * int((answered.end_ns - answered.begin_ns).max())
    # A reaction to an activation also answers those before it, so only the last ones are unanswered.
    without = source.release_ns[source.first + answered.begin_ns.size :]
    return int(np.count_nonzero(without < tables.until_ns - enough_ns))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stage:
    """A node's part in a chain along a path: its activation, and the times of the message that it sent on.

    The last node sent none: its times are None.
    """

    node: NodeTable
    row: int
    publication_ns: int | None = None
    reception_ns: int | None = None


def stages(
    tables: TopologyTables, path: NodePath, path_origins: tuple[Int64s, ...], activation: int
) -> tuple[Stage, ...]:
    """The chain from which an activation of the sink results, node by node.

    `path_origins` are the origins of all activations.
    """
    hops: Mapping[tuple[str, str], HopTable] = {(hop.topic, hop.subscriber): hop for hop in tables.hops}
    chain = []
    for place, name in enumerate(path.nodes):
        row = int(path_origins[place][activation])
        publication_ns = reception_ns = None
        if place < len(path.topics):
            hop = hops[path.topics[place], path.nodes[place + 1]]
            came = int(np.flatnonzero(hop.seq == row)[0])
            publication_ns, reception_ns = int(hop.publication_ns[came]), int(hop.reception_ns[came])
        chain.append(Stage(node=tables.nodes[name], row=row, publication_ns=publication_ns, reception_ns=reception_ns))
    return tuple(chain)
