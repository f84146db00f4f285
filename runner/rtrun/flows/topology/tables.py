"""Reads the tables of a topology's processes: a row for each activation of a node, and for each message at an input.

All of it comes from the target, and must be consistent: each message that a node took was sent.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtfiles.config import read_json
from rtfiles.errors import UsageError
from rtrun.kinds.rows import check_uptimes
from rtrun.kinds.values import Int64s
from rtrun.plan.topology.planning import WARM_UP_NS
from rtrun.plan.topology.rates import period_points
from rtrun.plan.topology.topology import Topology, TopologyNode
from rtrun.results.output import HostRecord
from rtrun.results.samples import read_rows

ACTIVATION = ("release_ns", "begin_ns", "done_ns", "end_ns", "cpu_ns")
"""The columns of a node's table; one for each input follows."""
RECEPTION = ("seq", "publication_ns", "reception_ns", "taken")
NONE = -1
"""Instead of the number of a message, or of an activation."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NodeTable:
    """The activations of a node in order, each column int64 of shape (n,), times of CLOCK_MONOTONIC.

    For each input, `taken` has the number of the message that an activation took: the number of the publisher's
    activation. Rows before `first` are the warm-up. `skipped` counts the points of its period that the node skipped
    while it was measured.
    """

    name: str
    release_ns: Int64s
    begin_ns: Int64s
    done_ns: Int64s
    end_ns: Int64s
    cpu_ns: Int64s
    taken: tuple[Int64s, ...]
    first: int
    skipped: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HopTable:
    """The messages of a topic that a node received, in the order of reception, each column int64 of shape (n,).

    `taken` is the first activation that took a message, `NONE` if no activation did. After `left_ns` the node received
    nothing any more.
    """

    topic: str
    publisher: str
    subscriber: str
    seq: Int64s
    publication_ns: Int64s
    reception_ns: Int64s
    taken: Int64s
    left_ns: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TopologyTables:
    """All tables of a run: nodes by name, hops in the order of their subscribers, and the json of each process.

    No period began at or after `until_ns`.
    """

    topology: Topology
    until_ns: int
    nodes: Mapping[str, NodeTable]
    hops: tuple[HopTable, ...]
    hosts: Mapping[str, HostRecord]


def host_name(process: str) -> str:
    """The name of a process's program and of its files, without their endings."""
    return f"process-{process}"


def table_names(node: TopologyNode) -> tuple[str, ...]:
    """The names of a node's tables, without ending: its own, and that of each input."""
    return (node.name, *(f"{node.name}-{number}" for number in range(len(node.inputs))))


def read_tables(folder: Path, topology: Topology) -> TopologyTables:
    """Read the tables that the processes of a topology left in a folder. Raises UsageError for impossible values."""
    hosts = {name: read_json(folder / f"{host_name(name)}.json", HostRecord) for name in topology.processes}
    times = {(host.start_ns, host.start_ns + host.measured_ns) for host in hosts.values()}
    if len(times) > 1:
        raise UsageError(f"{folder}: the processes began and ended at {len(times)} different times")
    ((_, until_ns),) = times
    nodes = {node.name: _read_node(folder, topology, node, hosts) for node in topology.nodes}
    hops = tuple(hop for node in topology.nodes for hop in _read_hops(folder, topology, node, nodes, hosts))
    return TopologyTables(topology=topology, until_ns=until_ns, nodes=nodes, hops=hops, hosts=hosts)


def _read_node(folder: Path, topology: Topology, node: TopologyNode, hosts: Mapping[str, HostRecord]) -> NodeTable:
    path, host = folder / f"{node.name}.npy", hosts[_process(topology, node)]
    rows = read_rows(path, (*ACTIVATION, *node.inputs))
    claim = next((claim for claim in host.nodes if claim.name == node.name), None)
    if claim is None or claim.activations != len(rows):
        number = "no activations" if claim is None else f"{claim.activations} activations"
        raise UsageError(f"{path}: {len(rows)} rows, the process tells of {number}")
    release, begin, done, end, cpu = (np.ascontiguousarray(rows[:, place]) for place in range(len(ACTIVATION)))
    check_uptimes(path, release, begin, done, end, cpu)
    if _is_backwards(release, begin, done, end):
        raise UsageError(f"{path}: an activation begins before it is due or before the one before has ended")
    first, skipped = int(np.searchsorted(release, host.start_ns + WARM_UP_NS)), 0
    if node.period_ns:
        points = period_points(node, host.measured_ns)
        is_on_grid = not ((release - host.start_ns - node.offset_ns) % node.period_ns).any()
        if not is_on_grid or len(rows) + claim.skipped != points:
            raise UsageError(
                f"{path}: {len(rows)} activations and {claim.skipped} skipped are not the {points} points of its period"
            )
        skipped = points - len(rows) - (period_points(node, WARM_UP_NS) - first)
    return NodeTable(
        name=node.name,
        release_ns=release,
        begin_ns=begin,
        done_ns=done,
        end_ns=end,
        cpu_ns=cpu,
        taken=tuple(np.ascontiguousarray(rows[:, len(ACTIVATION) + place]) for place in range(len(node.inputs))),
        first=first,
        skipped=skipped,
    )


def _is_backwards(release: Int64s, begin: Int64s, done: Int64s, end: Int64s) -> bool:
    within = bool(np.all(release <= begin) and np.all(begin <= done) and np.all(done <= end))
    return not within or bool(np.any(begin[1:] < end[:-1])) or bool(np.any(release[1:] < release[:-1]))


def _read_hops(
    folder: Path,
    topology: Topology,
    node: TopologyNode,
    nodes: Mapping[str, NodeTable],
    hosts: Mapping[str, HostRecord],
) -> Iterator[HopTable]:
    host, own = hosts[_process(topology, node)], nodes[node.name]
    left_ns = next((executor.left_ns for executor in host.executors if executor.name == node.executor), 0)
    for number, topic in enumerate(node.inputs):
        path = folder / f"{table_names(node)[number + 1]}.npy"
        rows = read_rows(path, RECEPTION)
        seq, publication, reception, taken = (np.ascontiguousarray(rows[:, place]) for place in range(len(RECEPTION)))
        check_uptimes(path, publication, reception)
        publisher = topology.publisher[topic].name
        sent = nodes[publisher].release_ns.size
        _check_range(path, "seq", seq, 0, sent)
        _check_range(path, "taken", taken, NONE, own.release_ns.size)
        _check_range(folder / f"{node.name}.npy", f"message of {topic}", own.taken[number], NONE, sent)
        if np.any(reception < publication):
            raise UsageError(f"{path}: a message came before it was published")
        if not np.isin(own.taken[number][own.taken[number] != NONE], seq).all():
            raise UsageError(f"{folder / node.name}.npy: takes a message of {topic} that never came")
        yield HopTable(
            topic=topic,
            publisher=publisher,
            subscriber=node.name,
            seq=seq,
            publication_ns=publication,
            reception_ns=reception,
            taken=taken,
            left_ns=left_ns,
        )


def _check_range(path: Path, what: str, values: Int64s, lowest: int, end: int) -> None:
    if values.size and not (lowest <= int(values.min()) and int(values.max()) < end):
        raise UsageError(f"{path}: {what}: {values.min()} to {values.max()}, must be from {lowest} to {end - 1}")


def _process(topology: Topology, node: TopologyNode) -> str:
    return topology.executor[node.executor].process
