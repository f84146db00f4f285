"""Where the time of late reactions went: each is cut into what the nodes and messages of its path took.

The parts add up to the reaction. Late reactions are those above the deadline. Without a deadline, or if no reaction is
above it, the highest hundredth is compared with the others in the same way.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtrun.flows.topology.chains import Spans, origins, reactions
from rtrun.flows.topology.tables import NONE, HopTable, NodeTable, TopologyTables
from rtrun.kinds.lateness import are_late
from rtrun.kinds.values import Int64s
from rtrun.plan.topology.topology import NodePath, Waits

HIGHEST = 0.01


@dataclass(frozen=True, kw_only=True, slots=True)
class PathPart:
    """How long a part of a path's reactions took on average, in late reactions and in the others, in ns."""

    what: str
    late_ns: float
    otherwise_ns: float
    """0 if all are late."""

    @property
    def extra_ns(self) -> float:
        """By how much this part made reactions late."""
        return self.late_ns - self.otherwise_ns


@dataclass(frozen=True, kw_only=True, slots=True)
class LatePath:
    """The late reactions of a path: their number, that of all, the limit, and their parts, the largest extra time
    first."""

    path: NodePath
    late: int
    reactions: int
    limit_ns: int
    parts: tuple[PathPart, ...]

    @property
    def extra_ns(self) -> float:
        """How much longer late reactions took than the others, on average."""
        return sum(part.extra_ns for part in self.parts)

    def share(self, part: PathPart) -> float:
        """The share of a part in all the extra time of late reactions."""
        return part.extra_ns / sum(max(any_part.extra_ns, 0.0) for any_part in self.parts)


def late_path(tables: TopologyTables, path: NodePath, deadline_ns: int | None) -> LatePath | None:
    """Where the time of the late reactions of a path went; None if there were no reactions."""
    path_origins = origins(tables, path)
    spans = reactions(tables, path, path_origins[0])
    lengths = spans.end_ns - spans.begin_ns
    if not lengths.size:
        return None
    limit_ns = deadline_ns or 0
    if not limit_ns or not are_late(lengths, limit_ns).any():
        limit_ns = int(np.quantile(lengths, 1 - HIGHEST))
    is_late = are_late(lengths, limit_ns)
    if not is_late.any():
        is_late = lengths >= lengths.max()
    parts: dict[str, Int64s] = {}
    for what, took in _parts(tables, path, path_origins, spans):
        if took.any():
            parts[what] = parts[what] + took if what in parts else took
    path_parts = (
        PathPart(
            what=what,
            late_ns=float(took[is_late].mean()),
            otherwise_ns=0.0 if is_late.all() else float(took[~is_late].mean()),
        )
        for what, took in parts.items()
    )
    return LatePath(
        path=path,
        late=int(np.count_nonzero(is_late)),
        reactions=lengths.size,
        limit_ns=limit_ns,
        parts=tuple(sorted(path_parts, key=lambda part: -part.extra_ns)),
    )


def _parts(
    tables: TopologyTables, path: NodePath, path_origins: Sequence[Int64s], spans: Spans
) -> Iterator[tuple[str, Int64s]]:
    """What each part of the reactions took, int64 of shape (reactions,), in the order of the path."""
    rows = [activations[spans.activation] for activations in path_origins]
    source = tables.nodes[path.nodes[0]]
    yield f"{source.name} is overtaken by its next activation", source.release_ns[rows[0]] - spans.begin_ns
    ready = source.release_ns[rows[0]]
    hops: Mapping[tuple[str, str], HopTable] = {(hop.topic, hop.subscriber): hop for hop in tables.hops}
    for place, name in enumerate(path.nodes):
        node, own = tables.nodes[name], rows[place]
        due = np.maximum(node.release_ns[own], ready)
        reason = "its period" if tables.topology.node[name].waits is Waits.PERIOD else "its other inputs"
        yield f"{name} waits for {reason}", due - ready
        yield from _wait_for_thread(tables, node, due, node.begin_ns[own], f"{name} waits for a CPU")
        took = node.done_ns[own] - node.begin_ns[own]
        ran = np.minimum(node.cpu_ns[own], took)
        yield f"{name} works", ran
        yield f"{name} does not run, though it has work", took - ran
        if place == len(path.topics):
            yield f"{name} ends", node.end_ns[own] - node.done_ns[own]
            return
        topic = path.topics[place]
        hop = hops[topic, path.nodes[place + 1]]
        came = _first_rows(hop, own)
        yield f"{name} publishes", hop.publication_ns[came] - node.done_ns[own]
        ready = hop.reception_ns[came]
        taker = tables.nodes[path.nodes[place + 1]]
        on_its_way = f"{topic} is on its way to {taker.name}"
        # The taker's thread receives while it runs no node.
        yield from _wait_for_thread(tables, taker, hop.publication_ns[came], ready, on_its_way)


def _wait_for_thread(
    tables: TopologyTables, node: NodeTable, due: Int64s, begin: Int64s, otherwise: str
) -> Iterator[tuple[str, Int64s]]:
    """How long each activation of a node waited for its thread: for each node that the thread ran meanwhile, and
    `otherwise`."""
    executor, left = tables.topology.node[node.name].executor, begin - due
    for other in tables.topology.nodes:
        if other.executor != executor or other.name == node.name:
            continue
        table = tables.nodes[other.name]
        took = _overlap(table.begin_ns, table.end_ns, due, begin)
        left = left - took
        yield f"{node.name} waits for {other.name}, which has its thread", took
    own = _overlap(node.begin_ns, node.end_ns, due, begin)
    yield f"{node.name} waits for its own last activation", own
    yield otherwise, left - own


def _overlap(begins: Int64s, ends: Int64s, from_ns: Int64s, until_ns: Int64s) -> Int64s:
    """How much of each period from `from_ns` to `until_ns` is covered by spans that follow one another."""
    covered = np.concatenate(([0], np.cumsum(ends - begins)))

    def before(at_ns: Int64s) -> Int64s:
        place = np.searchsorted(begins, at_ns, "right")
        last = np.maximum(place - 1, 0)
        beyond = np.where(place > 0, np.maximum(ends[last] - at_ns, 0), 0) if begins.size else np.zeros_like(at_ns)
        return np.asarray(covered[place] - beyond)

    return before(until_ns) - before(from_ns)


def _first_rows(hop: HopTable, seq: Int64s) -> Int64s:
    """The row of a hop's table in which each of these messages first came."""
    numbers, rows = np.unique(hop.seq, return_index=True)
    assert NONE not in seq
    return rows[np.searchsorted(numbers, seq)]
