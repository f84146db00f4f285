"""A topology in plain text: the graph, its nodes, and the CPU time they need, before anything was measured."""

from collections.abc import Iterator, Sequence

from rtfiles.output import counted, listed, screen_width
from rtfiles.quantities import time
from rtrun.plan.observation import StreamDeadline
from rtrun.plan.quantities import size_text
from rtrun.plan.topology.planning import TopologyPlan
from rtrun.plan.topology.rates import RT_SHARE, cpus_text, demands, rates_hz, shares
from rtrun.plan.topology.topology import Executor, Topology, TopologyNode, Waits
from rtrun.report.tables import Table

_INDENT = "    "
_SHOWN = 12


def topology_lines(plan: TopologyPlan, remarks: Sequence[str] = ()) -> Iterator[str]:
    """The lines; `remarks` name what in another tool's file has no counterpart here."""
    topology = plan.topology
    yield (
        f"topology {topology.name}: {counted(len(topology.nodes), 'node')} in "
        f"{counted(len(topology.executors), 'thread')} of {_processes(topology)}, "
        f"{counted(len(topology.topics), 'topic')}"
    )
    yield from (f"- {remark}" for remark in remarks)
    yield ""
    yield from drawing(topology)
    yield ""
    columns = ("node", "activated", "busy", "CPU", "thread", "sends")
    yield from (
        line.plain for line in Table(columns=columns, rows=[*_rows(topology)], numbers=[3]).lines(screen_width())
    )
    yield ""
    yield from _paths(plan)
    yield from _demand_lines(topology)


def _processes(topology: Topology) -> str:
    number = len(topology.processes)
    return f"{number} process{'es' * (number != 1)}"


def drawing(topology: Topology) -> Iterator[str]:
    """The graph: each line follows messages from node to node, up to a node that was drawn before; each arrow once."""
    started: set[str] = set()
    for node in (*topology.sources, *topology.nodes):
        for topic in node.outputs:
            for taker in topology.takers[topic]:
                if (arrow := f"{node.name} {topic} {taker.name}") not in started:
                    started.add(arrow)
                    yield from _folded(_way(topology, node, topic, taker, started))
        if not any(topology.takers[topic] for topic in node.outputs) and not node.inputs and node.name not in started:
            started.add(node.name)
            yield node.name


def _way(topology: Topology, node: TopologyNode, topic: str, taker: TopologyNode, started: set[str]) -> Iterator[str]:
    """A node, then arrows and nodes in turn."""
    yield node.name
    while True:
        yield f"─{topic}→ {taker.name}"
        onwards = (
            (next_topic, next_taker, arrow)
            for next_topic in taker.outputs
            for next_taker in topology.takers[next_topic]
            if (arrow := f"{taker.name} {next_topic} {next_taker.name}") not in started
        )
        # A node that was drawn already continues there: a line that reaches it ends with its name.
        step = next(onwards, None)
        if step is None:
            return
        topic, taker, arrow = step[0], step[1], step[2]
        started.add(arrow)


def _folded(words: Iterator[str]) -> Iterator[str]:
    """Words in lines of limited width; lines after the first are indented."""
    line, width = next(words), screen_width()
    for word in words:
        if len(line) + 1 + len(word) > width:
            yield line
            line = _INDENT + word
        else:
            line = f"{line} {word}"
    yield line


def _rows(topology: Topology) -> Iterator[tuple[str, ...]]:
    rates, of_node = rates_hz(topology), shares(topology)
    for node in topology.nodes:
        busy = ", ".join(
            [
                *([time(node.busy_ns)] if node.busy_ns else []),
                *([f"touches {size_text(node.touched_bytes)}"] if node.touched_bytes else []),
            ]
        )
        yield (
            node.name,
            _activated(node, rates[node.name]),
            busy or "-",
            f"{100 * of_node[node.name]:.3g} %",
            _thread(topology.executor[node.executor], is_shared=_is_shared(topology, node)),
            ", ".join(_sent(topology, topic) for topic in node.outputs) or "-",
        )


def _activated(node: TopologyNode, rate_hz: float) -> str:
    """What activates a node, in words."""
    if node.waits is Waits.PERIOD:
        newest = f", newest of {listed(node.inputs, 3)}" if node.inputs else ""
        return f"every {time(node.period_ns)}{f' from {time(node.offset_ns)}' if node.offset_ns else ''}{newest}"
    together = " and " if node.waits is Waits.ALL else " or "
    return f"on {together.join(node.inputs)}, {rate_hz:.4g}/s"


def _is_shared(topology: Topology, node: TopologyNode) -> bool:
    executor = topology.executor[node.executor]
    alone = sum(other.executor == node.executor for other in topology.nodes) == 1
    return not (alone and executor.name == executor.process == node.name)


def _thread(executor: Executor, *, is_shared: bool) -> str:
    named = f"{executor.process}/{executor.name}, " if is_shared else ""
    policy = "no policy" if executor.policy == "0" else f"{executor.policy} {executor.priority}"
    return f"{named}{policy}{f', CPU {cpus_text(executor.cpus)}' if executor.cpus else ''}"


def _sent(topology: Topology, name: str) -> str:
    topic = topology.topic[name]
    notes = [
        *([size_text(topic.payload_bytes)] if topic.payload_bytes else []),
        *(["best effort"] if topic.reliability == "best_effort" else []),
        *(["nobody takes it"] if not topology.takers[name] else []),
    ]
    return f"{name} ({', '.join(notes)})" if notes else name


def _paths(plan: TopologyPlan) -> Iterator[str]:
    """The paths with their deadlines; then deadlines that belong to no path."""
    number = len(plan.topology.all_paths())
    if not plan.paths:
        yield "no path is measured: no source leads to a sink; name one under paths"
    of_paths = [deadline for deadline in plan.deadlines if deadline.stream.is_of_paths]
    for path in plan.paths[:_SHOWN]:
        own = [
            f"{deadline.kind.replace('path', 'reaction')} {time(deadline.deadline_ns)}"
            for deadline in of_paths
            if deadline.name == path.name
        ]
        deadlines = f": {', '.join(own)}" if own else ""
        yield f"path {' > '.join(path.nodes)}{deadlines}"
    if len(plan.paths) > _SHOWN:
        yield f"and {len(plan.paths) - _SHOWN} more paths"
    if not plan.topology.paths and not of_paths and number > len(plan.paths) > 0:
        yield f"these are the longest of {number} found from source to sink; name others under paths"
    others: list[StreamDeadline] = [deadline for deadline in plan.deadlines if deadline not in of_paths]
    if others:
        yield f"deadlines: {', '.join(f'{stream.kind} {stream.name} {time(stream.deadline_ns)}' for stream in others)}"


def _demand_lines(topology: Topology) -> Iterator[str]:
    for demand in demands(topology):
        names = listed([executor.name for executor in demand.executors], _SHOWN)
        plural = "s" if len(demand.cpus) > 1 else ""
        where = f"CPU{plural} {cpus_text(demand.cpus)}" if demand.cpus else "any CPU"
        yield f"{where}: {100 * demand.share:.3g} % of a CPU asked for: {names}"
        real_time = sum(
            shares(topology)[node.name]
            for executor in demand.executors
            if executor.policy != "0"
            for node in topology.nodes
            if node.executor == executor.name
        )
        if demand.cpus and real_time > RT_SHARE * len(demand.cpus):
            yield (
                f"- that is above {100 * RT_SHARE:g} % for real-time threads, which the kernel stops for the rest of "
                "each second then, unless sched_rt_runtime_us is -1"
            )
    yield "what middleware and kernel take comes on top"
    if touching := [node.name for node in topology.nodes if node.touched_bytes]:
        yield f"so does what touching memory takes beyond busy, which is not known yet: {listed(touching, _SHOWN)}"
