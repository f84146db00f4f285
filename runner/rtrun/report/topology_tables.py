"""Tables of a report on the messages and nodes of topologies."""

from collections.abc import Sequence

from rtfiles.output import counted
from rtfiles.quantities import grouped, time
from rtrun.judgement.response_bounds import NodeBound, response_bounds
from rtrun.judgement.topologies import MeasuredTopology
from rtrun.report.tables import Table


def hop_table(measured: Sequence[MeasuredTopology]) -> Table:
    """A row for each topic at each node that receives it: what became of every message that was sent."""
    hops = [(topology.label, hop) for topology in measured for hop in topology.hops]
    lost = sum(sum(hop.lost.values()) for _, hop in hops)
    return Table(
        id="hops",
        title="Messages of topologies",
        columns=("topology", "topic", "from", "to", "sent", "taken", "overwritten", "unused", "lost", "latency max"),
        rows=[
            (
                label,
                hop.topic,
                hop.publisher,
                hop.subscriber,
                grouped(hop.sent),
                grouped(hop.taken),
                grouped(hop.overwritten),
                grouped(hop.unused),
                ", ".join(f"{number} {cause}" for cause, number in hop.lost.items() if number) or "0",
                time(hop.latency.max_ns),
            )
            for label, hop in hops
        ],
        outcome=f"{grouped(lost)} of {grouped(sum(hop.sent for _, hop in hops))} messages lost",
        numbers=range(4, 10),
        notes=(
            "overwritten: a newer one came before the node took it, as one does that takes the newest. unused: it was "
            "there when the run ended.",
        ),
    )


def bound_table(measured: Sequence[MeasuredTopology]) -> Table:
    """A row for each node with a period: the measured times next to the bounds of response-time analysis."""
    bounds = [(topology.label, bound) for topology in measured for bound in response_bounds(topology)]
    with_bound = [bound for _, bound in bounds if bound.bound_ns is not None]
    above = [bound for bound in with_bound if bound.broken]
    outcome = f"{len(above)} of {counted(len(with_bound), 'node')} above the bound" if with_bound else "no bound"
    return Table(
        id="response-bounds",
        title="Responses beside the bound of theory",
        columns=("topology", "node", "CPU", "period", "CPU time max", "wakes late by", "response max", "bound", "what"),
        rows=[_bound_row(label, bound) for label, bound in bounds],
        outcome=outcome,
        notes=(
            "The bound would hold if the longest CPU time of each node and the latest waking were the longest there "
            "can be. It covers nodes with a period that share one CPU and have a fixed priority; those of one "
            "priority, or of one thread, count as coming before each other. It does not cover chains of nodes, "
            "messages on their way, or what the file does not name.",
        ),
        how="response-bounds",
    )


def _bound_row(label: str, bound: NodeBound) -> tuple[str, ...]:
    if bound.bound_ns is None:
        what = f"no bound: {bound.why_not}"
    elif bound.broken:
        excess = time((bound.measured_ns or 0) - bound.bound_ns)
        what = f"ABOVE by {excess}: an assumption does not hold: {bound.broken}"
    else:
        what = f"{100 * (bound.measured_ns or 0) / bound.bound_ns:.3g} % of it"
    return (
        label,
        bound.node,
        "-" if bound.cpu is None else str(bound.cpu),
        time(bound.period_ns),
        time(bound.cost_ns),
        "-" if bound.bound_ns is None else time(bound.wakes_ns),
        time(bound.measured_ns),
        time(bound.bound_ns),
        what,
    )
