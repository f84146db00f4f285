"""The text for one process of a topology: lines of words separated by one blank, which C++ reads without a parser.

docs/topology.md has the form. Everything in it was checked when the topology file was read.
"""

from collections.abc import Iterator

from rtrun.plan.topology.planning import TopologyPlan
from rtrun.plan.topology.rates import cpus_text, most_activations

FORM = 1


def process_text(plan: TopologyPlan, process: str) -> str:
    """The text for a process of a topology by its name."""
    return "".join(f"{line}\n" for line in _lines(plan, process))


def _lines(plan: TopologyPlan, process: str) -> Iterator[str]:
    topology = plan.topology
    executors = [executor for executor in topology.executors if executor.process == process]
    executor_numbers = {executor.name: number for number, executor in enumerate(executors)}
    nodes = [node for node in topology.nodes if node.executor in executor_numbers]
    topics = list(dict.fromkeys(topic for node in nodes for topic in (*node.inputs, *node.outputs)))
    topic_numbers = {topic: number for number, topic in enumerate(topics)}
    rows = most_activations(topology, plan.measure_ns)
    yield f"topology {FORM}"
    yield f"process {process} {len(topology.processes)}"
    yield f"measure {plan.measure_ns}"
    for name in topics:
        topic = topology.topic[name]
        yield f"topic {topic_numbers[name]} {name} {topic.payload_bytes} {topic.reliability} {topic.depth}"
    for executor in executors:
        number, cpus = executor_numbers[executor.name], cpus_text(executor.cpus) or "-"
        yield f"executor {number} {executor.name} {executor.policy} {executor.priority} {cpus}"
    for number, node in enumerate(nodes):
        yield (
            f"node {number} {node.name} {executor_numbers[node.executor]} {node.waits} {node.period_ns} "
            f"{node.offset_ns} {node.busy_ns} {node.touched_bytes} {rows[node.name]}"
        )
        for name in node.inputs:
            yield f"in {number} {topic_numbers[name]} {rows[topology.publisher[name].name]}"
        for name in node.outputs:
            takers = topology.takers[name]
            processes = {topology.executor[taker.executor].process for taker in takers}
            yield f"out {number} {topic_numbers[name]} {len(takers)} {len(processes)}"
    yield "end"
