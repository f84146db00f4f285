"""How often each node of a topology is activated, how much CPU time that takes, and whether the CPUs have it."""

import graphlib
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from rtfiles.output import listed
from rtrun.plan.topology.topology import Executor, Topology, TopologyNode, Waits

RT_SHARE = 0.95
"""What real-time threads get of each CPU where nobody has changed sched_rt_runtime_us (sched(7))."""
NumberT = TypeVar("NumberT", int, float)
_ROUNDING = 1e-9
_UNIONS_MAX = 4096


def rates_hz(topology: Topology) -> Mapping[str, float]:
    """Activations a second of each node, by name, where nothing is lost and nothing is late.

    A node without a period follows those that send to it: with ``any`` the sum of them, with ``all`` the slowest one.
    """
    return _followed(topology, lambda node: 1e9 / node.period_ns)


def most_activations(topology: Topology, measure_ns: int) -> Mapping[str, int]:
    """The most activations that each node can have, by name, where periods begin for so long after the start."""
    return _followed(topology, lambda node: period_points(node, measure_ns))


def period_points(node: TopologyNode, measure_ns: int) -> int:
    """How often the period of a node begins for so long after the start."""
    return max(0, -((node.offset_ns - measure_ns) // node.period_ns))


def _followed(topology: Topology, of_period: Callable[[TopologyNode], NumberT]) -> dict[str, NumberT]:
    """A number of each node by name, where those without a period follow those that send to them."""
    before = {
        node.name: [] if node.waits is Waits.PERIOD else [topology.publisher[topic].name for topic in node.inputs]
        for node in topology.nodes
    }
    numbers: dict[str, NumberT] = {}
    for name in graphlib.TopologicalSorter(before).static_order():
        node, come = topology.node[name], [numbers[each] for each in before[name]]
        if node.waits is Waits.PERIOD:
            numbers[name] = of_period(node)
        else:
            numbers[name] = sum(come) if node.waits is Waits.ANY else min(come)
    return numbers


def shares(topology: Topology) -> Mapping[str, float]:
    """The share of one CPU that each node's busy time takes, by name; what middleware and kernel take comes on top."""
    rates = rates_hz(topology)
    return {node.name: rates[node.name] * node.busy_ns / 1e9 for node in topology.nodes}


@dataclass(frozen=True, kw_only=True, slots=True)
class CpuDemand:
    """What executors that may run on the same CPUs ask of them together; no CPUs: any of the target."""

    cpus: tuple[int, ...]
    executors: tuple[Executor, ...]
    share: float
    """In CPUs."""


def demands(topology: Topology) -> tuple[CpuDemand, ...]:
    """What is asked of each set of CPUs that executors name, those of one CPU first, those of any CPU last."""
    of_executor = _executor_shares(topology)
    by_cpus: dict[tuple[int, ...], list[Executor]] = {}
    for executor in topology.executors:
        by_cpus.setdefault(executor.cpus, []).append(executor)
    ordered = sorted(by_cpus.items(), key=lambda each: (not each[0], len(each[0]), each[0]))
    return tuple(
        CpuDemand(cpus=cpus, executors=tuple(group), share=sum(of_executor[each.name] for each in group))
        for cpus, group in ordered
    )


def overloads(topology: Topology) -> Iterator[str]:
    """What cannot fit: threads that are asked for more than a CPU, CPUs that are asked for more than they have.

    A set of CPUs has too little where the executors that may run nowhere else ask for more. Executors move between
    their CPUs as they like, so what is reported here cannot fit, wherever the kernel runs them.
    """
    of_node, of_executor = shares(topology), _executor_shares(topology)
    for executor in topology.executors:
        if of_executor[executor.name] > 1:
            nodes = [node for node in topology.nodes if node.executor == executor.name]
            yield f"executor {executor.name}: one thread is asked for {_asked(nodes, of_node)}"
    told: list[set[int]] = []
    for cpus in _unions({frozenset(executor.cpus) for executor in topology.executors if executor.cpus}):
        bound = {each.name for each in topology.executors if each.cpus and cpus.issuperset(each.cpus)}
        asked = sum(of_executor[name] for name in bound)
        # Of a set within it, or of its only thread, it has been said.
        if asked > len(cpus) + _ROUNDING and not any(each <= cpus for each in told):
            told.append({*cpus})
            nodes = [node for node in topology.nodes if node.executor in bound]
            if len(bound) > 1:
                yield f"CPU{'s' * (len(cpus) > 1)} {cpus_text(cpus)}: asked for {_asked(nodes, of_node)}"


def _executor_shares(topology: Topology) -> dict[str, float]:
    of_node = shares(topology)
    return {
        executor.name: sum(of_node[node.name] for node in topology.nodes if node.executor == executor.name)
        for executor in topology.executors
    }


def _unions(sets: set[frozenset[int]]) -> Iterator[frozenset[int]]:
    """The sets, and the unions of those of them that overlap in a chain, the smallest first.

    0-1 and 1-2 together may be too small where neither is. Of more than some thousand unions some are left out.
    """
    found, new = set(sets), set(sets)
    while new and len(found) < _UNIONS_MAX:
        new = {one | two for one, two in itertools.product(new, sets) if one & two} - found
        found |= new
    yield from sorted(found, key=lambda cpus: (len(cpus), sorted(cpus)))


def _asked(nodes: Sequence[TopologyNode], of_node: Mapping[str, float]) -> str:
    """The CPU time that nodes ask for, the greediest of them first."""
    busy = sorted((node for node in nodes if of_node[node.name]), key=lambda node: -of_node[node.name])
    total = sum(of_node[node.name] for node in busy)
    parts = [f"{node.name} {100 * of_node[node.name]:.3g} %" for node in busy]
    return f"{100 * total:.4g} % of a CPU: {listed(parts, 6)}"


def cpus_text(cpus: Iterable[int]) -> str:
    """CPUs as the kernel lists them, ``0-1,4``."""
    runs: list[list[int]] = []
    for cpu in sorted(cpus):
        if runs and cpu == runs[-1][-1] + 1:
            runs[-1].append(cpu)
        else:
            runs.append([cpu])
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)
