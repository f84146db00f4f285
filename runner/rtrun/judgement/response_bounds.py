"""Measured responses of periodic nodes, the bound of response-time analysis, and what it means to exceed that."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from rtfiles.output import listed
from rtfiles.quantities import time
from rtrun.analysis.response_time import PeriodicTask, response_bound
from rtrun.judgement.topologies import MeasuredTopology
from rtrun.plan.topology.topology import Executor, Topology, TopologyNode, Waits
from rtrun.results.record import RunRecord
from rtrun.results.topology_record import NodeFigures
from rtrun.targets.inspection.platform import Platform

_NAMED = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class NodeBound:
    """A node with its measured worst response and the bound on it, ns.

    The bound holds if the measured maxima are the true ones: the CPU time of each node, and `wakes_ns`, the lateness of
    the first node of this CPU, before which no other runs. `why_not` says why there is no bound. If a response is above
    the bound, `broken` names the assumption that was seen not to hold.
    """

    node: str
    cpu: int | None
    period_ns: int
    cost_ns: int | None
    measured_ns: int | None
    wakes_ns: int = 0
    bound_ns: int | None = None
    why_not: str = ""
    broken: str = ""


def response_bounds(measured: MeasuredTopology) -> tuple[NodeBound, ...]:
    """A bound for each node with a period, or why there is none."""
    return tuple(_bound(measured, node) for node in measured.shown.topology.nodes if node.waits is Waits.PERIOD)


def _bound(measured: MeasuredTopology, node: TopologyNode) -> NodeBound:
    topology, figures = measured.shown.topology, {found.node: found for found in measured.nodes}
    executor, own = topology.executor[node.executor], figures.get(node.name)
    known = NodeBound(
        node=node.name,
        cpu=executor.cpus[0] if len(executor.cpus) == 1 else None,
        period_ns=node.period_ns,
        cost_ns=own.cpu.max_ns if own else None,
        measured_ns=own.response.max_ns if own else None,
        wakes_ns=_wakes_ns(topology, executor, figures),
    )
    before = [*_before(topology, node)]
    if why_not := _why_not(known, executor, before):
        return replace(known, why_not=why_not)
    costs = {name: found.cpu.max_ns or 0 for name, found in figures.items()}
    task, *others = (
        # The nodes that run before are known, so it does not matter how much higher their priority is.
        PeriodicTask(
            name=timed.name,
            period_ns=timed.period_ns,
            cost_ns=costs.get(timed.name, 0),
            priority=executor.priority,
            jitter_ns=known.wakes_ns,
        )
        for timed in (node, *before)
    )
    bound_ns = response_bound(task, others)
    if bound_ns is None:
        return replace(known, why_not="it and what comes before it ask for all of the CPU, or nearly")
    assert own is not None
    is_broken = (known.measured_ns or 0) > bound_ns
    return replace(known, bound_ns=bound_ns, broken=_broken(own, bound_ns, measured.records) if is_broken else "")


def _before(topology: Topology, node: TopologyNode) -> Iterator[TopologyNode]:
    """The other nodes that may run before a node on its CPU: those of its priority or above, also of its own thread."""
    own = topology.executor[node.executor]
    for other in topology.nodes:
        executor = topology.executor[other.executor]
        meets = not executor.cpus or not set(own.cpus).isdisjoint(executor.cpus)
        if other is not node and executor.policy != "0" and executor.priority >= own.priority and meets:
            yield other


def _why_not(known: NodeBound, executor: Executor, before: Sequence[TopologyNode]) -> str:
    if executor.policy == "0":
        return "its thread has no real-time priority"
    if known.cpu is None:
        return "its thread may run on several CPUs"
    if not known.cost_ns or known.measured_ns is None:
        return "it was not seen to run"
    if others := [other.name for other in before if other.waits is not Waits.PERIOD]:
        return f"what may come before it has no period: {listed(others, _NAMED)}"
    return ""


def _wakes_ns(topology: Topology, executor: Executor, figures: Mapping[str, NodeFigures]) -> int:
    """How late a thread of these CPUs is woken at worst: the lateness of a node before which no other runs."""
    alone = (
        node
        for node in topology.nodes
        if node.waits is Waits.PERIOD
        and topology.executor[node.executor].policy != "0"
        and topology.executor[node.executor].cpus == executor.cpus
        and next(_before(topology, node), None) is None
    )
    return max((figures[node.name].lateness.max_ns or 0 for node in alone if node.name in figures), default=0)


def _broken(own: NodeFigures, bound_ns: int, records: Sequence[RunRecord]) -> str:
    """Which assumption does not hold, as far as it was seen."""
    explained_ns = max(0, bound_ns - (own.cpu.max_ns or 0))
    late_ns = own.lateness.max_ns or 0
    if late_ns > explained_ns:
        rivals = dict.fromkeys(rival.name for record in records for rival in record.in_effect.rivals)
        others = [f"other threads of its priority or above: {listed(rivals, _NAMED)}"] if rivals else []
        if any(record.platform is Platform.VIRTUAL for record in records):
            others.append("the host of this virtual machine")
        others.append("the kernel and its interrupts")
        return (
            f"that nothing else takes the CPU: it began {time(late_ns)} late, of which the nodes explain "
            f"{time(explained_ns)}; seen beside them, or never seen: {'; '.join(others)}"
        )
    return (
        "that it does not wait in its work: it began in time, and took longer than its CPU time and that of the nodes "
        "before it; it waits for a lock or a page, or its messages for the middleware"
    )
