"""What nodes beside a topology add to its paths: from runs in which it was planted."""

import numpy as np
import pytest
from written import write_output, write_record

from rtrun.analysis.comparison.layers import LATE
from rtrun.judgement.influence import influences
from rtrun.judgement.study import study
from rtrun.plan.question import THESIS
from rtrun.plan.topology.others import BUSY_NS, beside, read_other_nodes
from rtrun.plan.topology.topology import Executor, Topology, TopologyNode, TopologyTopic, Waits
from rtrun.report.influence import table

US = 1000
DEADLINE_NS = 300 * US
ADDED_NS = {"": 0, "1 idle": 0, "4 busy on 1": 50 * US}
SHARED = {"path": "/a,/b", "sink": "/c", "topology": "t", "middleware": "rcl"}


def write(root, *, in_turn=True):
    """Five runs of each in turn: reactions of two paths take 200 us on the average, and what is planted."""
    draw = np.random.default_rng(1)
    order = [others for _ in range(5) for others in ADDED_NS]
    for minute, others in enumerate(order if in_turn else sorted(order)):
        for sink in ("/c", "/d"):
            name = f"{minute:03}-{others.replace(' ', '-')}{sink.replace('/', '-')}"
            folder = root / name
            folder.mkdir(parents=True)
            begin = np.arange(2000) * 1_000_000
            # It grows slowly: a drift that does not come from the nodes.
            took = draw.gamma(20, 10 * US, 2000).astype(np.int64) + ADDED_NS[others] + minute * 300
            parameters = SHARED | {"sink": sink, "other_nodes": others}
            rows = np.column_stack((begin, begin + took))
            write_output(folder, name, "observed_paths", rows, requested=parameters, asked=2000, measured=2000, logs=[])
            write_record(
                folder,
                "observed_paths",
                [name],
                parameters,
                subject="attached",
                deadline_ns=DEADLINE_NS,
                start_time=f"2026-11-21T10:{minute:02}:00Z",
                end_time=f"2026-11-21T10:{minute:02}:30Z",
            )
    return root


def test_what_was_planted_is_found_with_its_interval(tmp_path):
    found = influences(study(write(tmp_path / "runs"), THESIS, bounds=False))
    assert sorted((influence.other_nodes, str(influence.beside.parameters["sink"])) for influence in found) == [
        ("1 idle", "/c"),
        ("1 idle", "/d"),
        ("4 busy on 1", "/c"),
        ("4 busy on 1", "/d"),
    ]
    for influence in found:
        assert influence.alone.parameters["sink"] == influence.beside.parameters["sink"]
        added = {part.figure: part for part in influence.attribution.added}
        assert [*added] == ["mean", "median", "p99.9", LATE]
        planted = ADDED_NS[influence.other_nodes]
        for figure in ("mean", "median"):
            assert added[figure].low < planted < added[figure].high
            assert added[figure].high - added[figure].low < 20 * US
        assert (added[LATE].low > 0) == (planted > 0)
    shown = table(found, 0.95)
    assert "2 of 4 comparisons show that other nodes add to the median; most is" in shown.outcome
    assert "of 4 busy on 1" in shown.outcome
    alone, *others = shown.rows[:3]
    assert alone[:3] == ("reaction /a,/b -> /c through rcl", "nothing", "10000")
    assert {row[1] for row in others} == {"1 idle", "4 busy on 1"}


def test_runs_that_were_not_in_turn_say_nothing(tmp_path):
    found = influences(study(write(tmp_path / "runs", in_turn=False), THESIS, bounds=False))
    assert not any(influence.attribution.added for influence in found)
    assert "not measured in turn" in table(found, 0.95).notes[-1]


@pytest.mark.parametrize("text", ["busy", "0 busy", "100 busy", "2 lazy", "2 busy on x", "2  busy", "2 busy on 1 "])
def test_what_is_no_number_and_kind_is_refused(text):
    with pytest.raises(ValueError, match="takes a number and a kind, as 2 busy, or 4 idle on 1"):
        read_other_nodes(text)


def test_nodes_beside_a_topology_take_and_send_nothing_of_it():
    node = TopologyNode(name="other1", executor="x", waits=Waits.PERIOD, period_ns=1000, outputs=("/other2",))
    executor = Executor(name="x", process="x", policy="FIFO", priority=7, cpus=(0,))
    alone = Topology(name="t", nodes=(node,), executors=(executor,), topics=(TopologyTopic(name="/other2"),))
    for kind, number in (("idle", 2), ("busy", 2), ("publishing", 4)):
        both, others = beside(alone, read_other_nodes(f"2 {kind} on 1"))
        assert len(others) == number and not set(others) & {"other1"}
        assert both.nodes[0] == node and len(both.processes) == number + 1
        added = [other for other in both.nodes if other.name in others]
        assert {topic for other in added for topic in other.outputs}.isdisjoint(node.outputs)
        assert all(topic in both.publisher for other in added for topic in other.inputs)
        assert {other.busy_ns for other in added} == {BUSY_NS if kind == "busy" else 0}
        for executor in both.executors[1:]:
            assert (executor.policy, executor.priority, executor.cpus) == ("FIFO", 7, (1,))
