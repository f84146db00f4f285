"""Measured responses beside the bound of theory: which nodes have one, what it is, and what a larger one tells."""

import json

import pytest
from made_topology import made_topology, topology_of, write_topology_run
from plan.test_topology import nodes

from rtrun.judgement.response_bounds import response_bounds
from rtrun.judgement.study import study
from rtrun.judgement.topologies import measured_topologies
from rtrun.results.topology_record import NodeFigures, Spread

MS = 1_000_000
# On CPU 1 the worked example of Burns & Wellings in ms, 3 of 7, 3 of 12, 5 of 20: bounds of 3, 6 and 20.
LINES = (
    "fast:   {period: 7ms, policy: FIFO, priority: 90, cpu: 1}",
    "middle: {period: 12ms, policy: FIFO, priority: 80, cpu: 1}",
    "slow:   {period: 20ms, policy: FIFO, priority: 70, cpu: 1}",
    "plain:  {period: 20ms, cpu: 1}",
    "roams:  {period: 20ms, policy: RR, priority: 20, cpu: 1-2}",
    "other:  {period: 5ms, policy: FIFO, priority: 90, cpu: 3, outputs: [/x]}",
    "driven: {inputs: [/x], policy: FIFO, priority: 50, cpu: 3}",
    "below:  {period: 50ms, policy: FIFO, priority: 40, cpu: 3}",
)
COSTS_MS = {"fast": 3, "middle": 3, "slow": 5}


def figures(name, response_ns=MS, late_ns=0):
    return NodeFigures(
        node=name,
        activations=100,
        cpu=Spread(median_ns=1, max_ns=COSTS_MS.get(name, 1) * MS),
        response=Spread(median_ns=1, max_ns=response_ns),
        lateness=Spread(median_ns=0, max_ns=late_ns),
    )


def bounds(folder, *changed, lines=LINES, **record):
    """The bounds of a study of one run, whose figures are those above but for what is changed; by node."""
    topology = topology_of(folder, nodes(*lines))
    by_name = {node.name: figures(node.name) for node in topology.nodes} | {own.node: own for own in changed}
    found = made_topology(topology, nodes=list(by_name.values()))
    write_topology_run(folder / "results" / "001-topology-test-rcl", found, **record)
    (measured,) = measured_topologies(study(folder / "results"))
    return {bound.node: bound for bound in response_bounds(measured)}


def test_each_node_has_its_bound_or_is_told_why_not(tmp_path):
    found = bounds(tmp_path)
    assert {name: bound.bound_ns for name, bound in found.items() if bound.bound_ns} == {
        "fast": 3 * MS, "middle": 6 * MS, "slow": 20 * MS, "other": MS,
    }  # fmt: skip
    assert {name: bound.why_not for name, bound in found.items() if bound.why_not} == {
        "plain": "its thread has no real-time priority",
        "roams": "its thread may run on several CPUs",
        "below": "what may come before it has no period: driven",
    }
    assert not any(bound.broken for bound in found.values())


def test_how_late_threads_wake_is_in_the_bound_of_all_on_their_cpu(tmp_path):
    found = bounds(tmp_path, figures("fast", late_ns=MS // 2))
    assert {name: bound.bound_ns for name, bound in found.items() if name in COSTS_MS} == {
        "fast": 3 * MS + MS // 2, "middle": 6 * MS + MS // 2, "slow": 20 * MS + MS // 2,
    }  # fmt: skip
    assert found["other"].wakes_ns == 0, "of another CPU"


RIVAL = {"name": "irq/42-eth0", "policy": "FIFO", "priority": 95}


@pytest.mark.parametrize(
    ("late_ns", "record", "reason"),
    [
        (4 * MS, {}, "that nothing else takes the CPU: it began 4 ms late, of which the nodes explain 3 ms;"),
        (4 * MS, {"in_effect": {"rivals": [RIVAL]}}, "other threads of its priority or above: irq/42-eth0; the kernel"),
        (4 * MS, {"platform": "virtual"}, "the host of this virtual machine; the kernel and its interrupts"),
        (MS, {}, "that it does not wait in its work: it began in time"),
    ],
)
def test_a_response_above_its_bound_says_which_assumption_does_not_hold(tmp_path, late_ns, record, reason):
    found = bounds(tmp_path, figures("middle", response_ns=6 * MS + 1, late_ns=late_ns), **record)
    assert reason in found["middle"].broken
    assert not found["fast"].broken and not found["slow"].broken
    again = tmp_path / "at the bound"
    again.mkdir()
    assert not bounds(again, figures("middle", response_ns=6 * MS, late_ns=late_ns), **record)["middle"].broken


def test_one_priority_and_one_thread_count_as_coming_before_each_other(tmp_path):
    task = "period: 20ms, policy: FIFO, priority: 50, cpu: 1"
    found = bounds(tmp_path, lines=(f"a: {{{task}, executor: e}}", f"b: {{{task}, executor: e}}", f"c: {{{task}}}"))
    assert {name: bound.bound_ns for name, bound in found.items()} == dict.fromkeys("abc", 3 * MS)


def test_runs_that_are_alike_give_the_worst_of_each_and_their_copies_count_once(tmp_path):
    topology = topology_of(tmp_path, nodes(*LINES[:3]))
    results = tmp_path / "results"
    for number, response_ns in enumerate((5 * MS, 7 * MS), start=1):
        found = made_topology(topology, nodes=[figures("fast"), figures("middle", response_ns), figures("slow")])
        write_topology_run(results / f"00{number}-topology-test-rcl", found)
    other = write_topology_run(results / "003-topology-test-rcl-cpu80", made_topology(topology))
    record = json.loads((other / "run.json").read_text())
    (other / "run.json").write_text(json.dumps(record | {"condition": "cpu80"}))
    idle, loaded = measured_topologies(study(results))
    assert len(idle.records) == 2 and len(loaded.records) == 1
    assert {bound.node: bound.measured_ns for bound in response_bounds(idle)}["middle"] == 7 * MS
    assert idle.nodes[0].activations == 200
