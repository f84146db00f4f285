"""What became of the messages and nodes of topologies: tables of a report."""

from collections.abc import Sequence

from rtfiles.output import counted
from rtfiles.quantities import grouped, time
from rtrun.judgement.response_bounds import NodeBound, response_bounds
from rtrun.judgement.topologies import MeasuredTopology
from rtrun.report.tables import Table


def hop_table(measured: Sequence[MeasuredTopology]) -> Table:
    """A row for each topic at each node that receives it: what became of every message that was sent."""
    hops = [(of.label, hop) for of in measured for hop in of.hops]
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
    bounds = [(of.label, each) for of in measured for each in response_bounds(of)]
    with_bound = [each for _, each in bounds if each.bound_ns is not None]
    above = [each for each in with_bound if each.broken]
    outcome = f"{len(above)} of {counted(len(with_bound), 'node')} above the bound" if with_bound else "no bound"
    return Table(
        id="response-bounds",
        title="Responses beside the bound of theory",
        columns=("topology", "node", "CPU", "period", "CPU time max", "wakes late by", "response max", "bound", "what"),
        rows=[_bound_row(label, each) for label, each in bounds],
        outcome=outcome,
        notes=(
            "The bound would hold if the longest CPU time of each node and the latest waking were the longest there "
            "can be. It covers nodes with a period that share one CPU and have a fixed priority; those of one "
            "priority, or of one thread, count as coming before each other. It does not cover chains of nodes, "
            "messages on their way, or what the file does not name.",
        ),
        how="response-bounds",
    )


def _bound_row(label: str, each: NodeBound) -> tuple[str, ...]:
    if each.bound_ns is None:
        what = f"no bound: {each.why_not}"
    elif each.broken:
        excess = time((each.measured_ns or 0) - each.bound_ns)
        what = f"ABOVE by {excess}: an assumption does not hold: {each.broken}"
    else:
        what = f"{100 * (each.measured_ns or 0) / each.bound_ns:.3g} % of it"
    return (
        label,
        each.node,
        "-" if each.cpu is None else str(each.cpu),
        time(each.period_ns),
        time(each.cost_ns),
        "-" if each.bound_ns is None else time(each.wakes_ns),
        time(each.measured_ns),
        time(each.bound_ns),
        what,
    )
