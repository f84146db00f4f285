"""The picture of a topology: every arrow in it, nothing over anything else, and a cycle that adds up."""

import random
import re
from itertools import combinations, pairwise

import pytest
from made_topology import made_topology, topology_of, write_topology_run
from plan.test_topology import BRAKING, nodes

from rtrun.cli import main
from rtrun.judgement.topologies import MeasuredTopology
from rtrun.report.plots.graph import drawn_topology
from rtrun.report.plots.layout import layered


def measured(record):
    return MeasuredTopology(
        label="x", run="001", shown=record, nodes=tuple(record.nodes), hops=tuple(record.hops), records=()
    )


def random_graph(draw, size):
    """Nodes with periods, which may stand in circles, and nodes that others activate."""
    lines = []
    for number in range(size):
        taken = draw.sample(range(size), draw.randint(0, min(3, size)))
        is_driven = number and draw.random() < 0.3
        inputs = sorted({f"/t{draw.randrange(number)}"}) if is_driven else [f"/t{topic}" for topic in taken]
        period = "" if is_driven else f"period: {draw.choice([5, 10, 20])}ms, "
        lines.append(f"n{number}: {{{period}inputs: [{', '.join(inputs)}], outputs: [/t{number}], busy: 10us}}")
    return nodes(*lines)


def boxes(drawn):
    """The rectangles of nodes, and those that texts of arrows take, as far as is known of fonts."""
    for node in drawn.nodes:
        yield node.x, node.y, node.x + node.width, node.y + node.height
    for text in (arrow.text for arrow in drawn.arrows if arrow.text):
        half = 6.6 * max(len(line) for line, _ in text.lines) / 2
        top = text.y - 12
        yield text.x - half, top, text.x + half, top + 15 * len(text.lines)


def test_nothing_stands_over_anything_else_and_each_arrow_leads_from_node_to_node(tmp_path):
    draw, with_text, arrows = random.Random(3), 0, 0
    for size in (1, 2, 5, 9, 14, 20):
        record = made_topology(topology_of(tmp_path, random_graph(draw, size)))
        drawn = drawn_topology(measured(record))
        for box, other in combinations(boxes(drawn), 2):
            apart = box[2] <= other[0] or other[2] <= box[0] or box[3] <= other[1] or other[3] <= box[1]
            assert apart, (box, other)
        assert len(drawn.arrows) == len({(hop.publisher, hop.subscriber) for hop in record.hops})
        corners = {(node.x, node.y): node for node in drawn.nodes}
        assert len(corners) == len(record.nodes)
        for arrow in drawn.arrows:
            ends = [
                tuple(map(float, re.findall(r"[\d.-]+", arrow.line)[place])) for place in (slice(0, 2), slice(-2, None))
            ]
            for x, y in ends:
                touched = [
                    node for node in drawn.nodes
                    if node.x <= x <= node.x + node.width + 1 and node.y - 9 <= y <= node.y + node.height + 9
                ]  # fmt: skip
                assert touched, "an arrow begins and ends at a node"
        with_text += sum(arrow.text is not None for arrow in drawn.arrows)
        arrows += len(drawn.arrows)
    assert with_text > 0.6 * arrows


def test_arrows_go_down_but_for_those_that_close_a_circle():
    ways = [("a", "b"), ("b", "c"), ("a", "c"), ("c", "a"), ("c", "d")]
    layout = layered(dict.fromkeys("abcd", 50.0), ways)
    assert layout.layer == {"a": 0, "b": 1, "c": 2, "d": 3}
    assert [number for number, _ in layout.bends["a", "c"]] == [1]
    assert [number for number, _ in layout.bends["c", "a"]] == [1]


def test_the_path_that_matters_is_marked_and_its_cycle_has_no_gap(tmp_path):
    record = made_topology(topology_of(tmp_path, BRAKING))
    drawn = drawn_topology(measured(record))
    assert {node.text.lines[0][0] for node in drawn.nodes if node.style} == {
        "lidar",
        "detect",
        "fuse",
        "control",
        "brake",
    }
    assert sum(arrow.style == "critical" for arrow in drawn.arrows) == 4 == len(drawn.arrows) - 1
    assert [row.name for row in drawn.timeline] == ["lidar", "detect", "fuse", "control", "brake"]
    assert [row.bars[0][0] for row in drawn.timeline] == ["wait", "way", "way", "way", "way"]
    assert "idle" in [kind for kind, _, _ in drawn.timeline[3].bars], "it waited for its period"
    for row in drawn.timeline:
        for (_, left, width), (_, following, _) in pairwise(row.bars):
            assert left + width == pytest.approx(following), "what follows begins where the part before it ends"
    assert sum(drawn.timeline[-1].bars[-1][1:]) == pytest.approx(100)
    assert drawn.ticks[0] == (0.0, "0 us") and 3 <= len(drawn.ticks) <= 6


def test_the_report_of_a_run_has_its_graph_its_messages_and_its_bounds(tmp_path, capsys):
    record = made_topology(topology_of(tmp_path, BRAKING))
    lost = [hop.model_copy(update={"lost": {"<b>queue full": 3}, "sent": hop.sent + 3}) for hop in record.hops]
    write_topology_run(tmp_path / "results" / "001-topology-braking-rcl", record)
    write_topology_run(tmp_path / "results" / "002-topology-braking-rcl-r2", record.model_copy(update={"hops": lost}))
    assert main(["report", str(tmp_path / "results"), "--output", str(tmp_path / "a.html")]) == 0
    page = (tmp_path / "a.html").read_text()
    assert page.count("<svg style=") == 1 and "<b>queue" not in page
    assert main(["report", str(tmp_path / "results"), "--output", str(tmp_path / "a.md")]) == 0
    text = (tmp_path / "a.md").read_text().replace("\\", "")
    assert "15 of 5 215 messages lost" in text
    assert re.search(r"\| /imu \| imu \| fuse \| 2 003 \| 400 \| 1 600 \| 0 \| 3 <b>queue full \| 120 us \|", text)
