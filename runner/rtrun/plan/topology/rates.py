"""How often each node of a topology is activated, how much CPU time that takes, and whether the CPUs have it."""

import graphlib
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from rtfiles.output import listed
from rtrun.plan.topology.topology import Executor, Topology, TopologyNode, Waits

RT_SHARE = 0.95
"""The share of each CPU that real-time threads get by default: sched_rt_runtime_us (sched(7))."""
NumberT = TypeVar("NumberT", int, float)
_ROUNDING = 1e-9
_UNIONS_MAX = 4096  #: sets of CPUs whose load is added up


def rates_hz(topology: Topology) -> Mapping[str, float]:
    """Activations per second of each node, by name, if nothing is lost and nothing is late.

    A node without a period follows its senders: with ``any`` their sum, with ``all`` the slowest one.
    """
    return _followed(topology, lambda node: 1e9 / node.period_ns)


def most_activations(topology: Topology, measure_ns: int) -> Mapping[str, int]:
    """The most activations that each node can have, by name, if periods begin until `measure_ns` after the start."""
    return _followed(topology, lambda node: period_points(node, measure_ns))


def period_points(node: TopologyNode, measure_ns: int) -> int:
    """How many times the period of a node begins until `measure_ns` after the start."""
    return max(0, -((node.offset_ns - measure_ns) // node.period_ns))


def _followed(topology: Topology, of_period: Callable[[TopologyNode], NumberT]) -> dict[str, NumberT]:
    """A number for each node, by name; nodes without a period follow their senders."""
    before = {
        node.name: [] if node.waits is Waits.PERIOD else [topology.publisher[topic].name for topic in node.inputs]
        for node in topology.nodes
    }
    numbers: dict[str, NumberT] = {}
    for name in graphlib.TopologicalSorter(before).static_order():
        node, come = topology.node[name], [numbers[sender] for sender in before[name]]
        if node.waits is Waits.PERIOD:
            numbers[name] = of_period(node)
        else:
            numbers[name] = sum(come) if node.waits is Waits.ANY else min(come)
    return numbers


def shares(topology: Topology) -> Mapping[str, float]:
    """The share of one CPU that each node's busy time takes, by name. Middleware and kernel take more in addition."""
    rates = rates_hz(topology)
    return {node.name: rates[node.name] * node.busy_ns / 1e9 for node in topology.nodes}


@dataclass(frozen=True, kw_only=True, slots=True)
class CpuDemand:
    """The total demand of executors that may run on the same CPUs; no CPUs: any of the target."""

    cpus: tuple[int, ...]
    executors: tuple[Executor, ...]
    share: float
    """In CPUs."""


def demands(topology: Topology) -> tuple[CpuDemand, ...]:
    """The demand on each set of CPUs that executors name; single CPUs come first, "any CPU" comes last."""
    of_executor = _executor_shares(topology)
    by_cpus: dict[tuple[int, ...], list[Executor]] = {}
    for executor in topology.executors:
        by_cpus.setdefault(executor.cpus, []).append(executor)
    ordered = sorted(by_cpus.items(), key=lambda item: (not item[0], len(item[0]), item[0]))
    return tuple(
        CpuDemand(cpus=cpus, executors=tuple(group), share=sum(of_executor[executor.name] for executor in group))
        for cpus, group in ordered
    )


def overloads(topology: Topology) -> Iterator[str]:
    """Overloads: threads that need more than one CPU, and sets of CPUs that are too small.

    A set of CPUs is too small if the executors that may run nowhere else need more. This assumes that executors move
    freely between their CPUs, so what is reported cannot fit, wherever the kernel runs them.
    """
    of_node, of_executor = shares(topology), _executor_shares(topology)
    for executor in topology.executors:
        if of_executor[executor.name] > 1:
            nodes = [node for node in topology.nodes if node.executor == executor.name]
            yield f"executor {executor.name}: one thread is asked for {_asked(nodes, of_node)}"
    reported: list[set[int]] = []
    for cpus in _unions({frozenset(executor.cpus) for executor in topology.executors if executor.cpus}):
        bound = {executor.name for executor in topology.executors if executor.cpus and cpus.issuperset(executor.cpus)}
        asked = sum(of_executor[name] for name in bound)
        # Skip it if a set within it, or its only thread, was reported already.
        if asked > len(cpus) + _ROUNDING and not any(earlier <= cpus for earlier in reported):
            reported.append({*cpus})
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
    """The sets, and the unions of sets that overlap in a chain, the smallest first.

    0-1 and 1-2 together may be too small although neither is alone. If there are more than some thousand unions, some
    are left out.
    """
    found, new = set(sets), set(sets)
    while new and len(found) < _UNIONS_MAX:
        new = {first | second for first, second in itertools.product(new, sets) if first & second} - found
        found |= new
    yield from sorted(found, key=lambda cpus: (len(cpus), sorted(cpus)))


def _asked(nodes: Sequence[TopologyNode], of_node: Mapping[str, float]) -> str:
    """The CPU time that nodes ask for, the highest first."""
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
