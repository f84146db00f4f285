"""The streams of a topology: what was measured of each node, hop and path, in the form that an observation has."""

from collections.abc import Iterator, Mapping

import numpy as np

from rtfiles.quantities import time
from rtrun.flows.topology.chains import Spans, ages, origins, reactions, unanswered
from rtrun.flows.topology.fates import HopFates, fates
from rtrun.flows.topology.tables import NONE, HopTable, NodeTable, TopologyTables
from rtrun.flows.values import Stream
from rtrun.kinds.age import STREAM as AGE
from rtrun.kinds.callback import STREAM as CALLBACK
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.messages import STREAM as MESSAGES
from rtrun.kinds.path import STREAM as PATH
from rtrun.kinds.response import STREAM as RESPONSE
from rtrun.kinds.timer import STREAM as TIMER
from rtrun.kinds.values import Int64s
from rtrun.plan.topology.planning import TopologyPlan
from rtrun.plan.topology.topology import NodePath


def topology_streams(tables: TopologyTables, plan: TopologyPlan) -> Iterator[Stream]:
    """Paths first, then hops, periods and nodes; all without the warm-up."""
    for path in plan.paths:
        path_origins = origins(tables, path)
        answered = reactions(tables, path, path_origins[0])
        never = unanswered(tables, path, answered) if answered.end_ns.size else 0
        yield _path(PATH, path, answered, lost=never)
        yield _path(AGE, path, ages(tables, path, path_origins[0]))
    for hop in tables.hops:
        if hop.subscriber in plan.others:
            continue
        yield _messages(tables, hop, fates(tables, hop))
    for node in tables.topology.nodes:
        if node.name in plan.others:
            continue
        table, name = tables.nodes[node.name], node.full_name
        if node.period_ns:
            yield _timer(table, name, node.period_ns)
        release, begin, end = (column[table.first :] for column in (table.release_ns, table.begin_ns, table.end_ns))
        # A skipped point of the node's period was due, and never done.
        yield _spans(RESPONSE, {"node": name}, release, end, lost=table.skipped)
        yield _spans(CALLBACK, {"node": name, "callback": node.name}, begin, end)


def _path(kind: StreamKind, path: NodePath, spans: Spans, *, lost: int = 0) -> Stream:
    identity = {"path": path.name, "sink": f"/{path.sink}"}
    return _spans(kind, identity, spans.begin_ns, spans.end_ns, lost=lost)


def _spans(kind: StreamKind, identity: Mapping[str, str], begin_ns: Int64s, end_ns: Int64s, *, lost: int = 0) -> Stream:
    columns = {"begin_ns": begin_ns, "end_ns": end_ns}
    return Stream(kind=kind, identity=identity, columns=columns, counts={"measured": end_ns.size, "lost": lost})


def _timer(table: NodeTable, name: str, period_ns: int) -> Stream:
    due, begin = table.release_ns[table.first :], table.begin_ns[table.first :]
    return Stream(
        kind=TIMER,
        identity={"node": name, "timer": f"timer {time(period_ns)}"},
        columns={"timestamp_ns": begin, "expected_ns": due, "real_ns": begin},
        counts={"measured": due.size, "skipped": table.skipped},
        period_ns=period_ns,
    )


def _messages(tables: TopologyTables, hop: HopTable, of_hop: HopFates) -> Stream:
    publisher, subscriber = tables.nodes[hop.publisher], tables.nodes[hop.subscriber]
    rows = of_hop.rows
    taken = hop.taken[rows]
    end = np.full(rows.size, NOT_SEEN_NS)
    end[taken != NONE] = subscriber.end_ns[taken[taken != NONE]]
    return Stream(
        kind=MESSAGES,
        identity={"topic": hop.topic, "publisher": f"/{hop.publisher}", "subscriber": f"/{hop.subscriber}"},
        columns={
            "publication_ns": hop.publication_ns[rows],
            "reception_ns": hop.reception_ns[rows],
            "seq": hop.seq[rows] - publisher.first,
            "callback_end_ns": end,
        },
        counts={
            "lost": of_hop.sent - rows.size,
            "duplicate": of_hop.duplicates,
            "out_of_order": of_hop.out_of_order,
        },
    )
