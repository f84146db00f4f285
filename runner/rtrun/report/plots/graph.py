"""The picture of a topology: its graph with latencies on the arrows, and a timeline of the worst cycle."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rtfiles.output import printable
from rtfiles.quantities import time
from rtrun.judgement.topologies import MeasuredTopology
from rtrun.kinds.lateness import is_late
from rtrun.plan.topology.rates import cpus_text
from rtrun.plan.topology.topology import Topology, TopologyNode, Waits
from rtrun.report.plots.layout import Layout, layered
from rtrun.results.topology_record import CycleStep, HopFigures, NodeFigures, PathFigures

# Sizes in pixels: a character, a line, the padding, the distance between two layers, the margin.
_CHARACTER, _LINE, _PADDING, _WAY, _MARGIN = 6.6, 15.0, 8.0, 96.0, 12.0
_NARROWEST = 96.0
_HEAD = 8.0
# Places for the text of an arrow, as fractions of its length, the best place first.
_TRIED = (0.5, 0.38, 0.62, 0.27, 0.73, 0.2, 0.8, 0.12, 0.88)

# Distances between the ticks of a timeline.
_STEPS_NS = [digit * 10**power for power in range(19) for digit in (1, 2, 5)]
# How far arrows back up start to the right of the arrows down.
_BACK = 14.0


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnText:
    """Lines of text around a place, in pixels, each with its class."""

    x: float
    y: float
    lines: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnNode:
    """A box: its upper left corner, its text, and the text under the pointer."""

    x: float
    y: float
    width: float
    height: float
    style: str
    text: DrawnText
    tooltip: str


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnArrow:
    """An arrow: the paths of its line and its head; without text where there was no room for it."""

    line: str
    head: str
    style: str
    text: DrawnText | None
    tooltip: str


@dataclass(frozen=True, kw_only=True, slots=True)
class TimelineRow:
    """A node's part of a cycle: bars of (class, left, width) in percentages of the whole, and the same in words."""

    name: str
    bars: tuple[tuple[str, float, float], ...]
    tooltip: str


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnTopology:
    """The whole picture; `ticks` of the timeline are (place in per cent, text), `cycle` names the cycle shown."""

    label: str
    run: str
    width: float
    height: float
    nodes: tuple[DrawnNode, ...]
    arrows: tuple[DrawnArrow, ...]
    cycle: str
    timeline: tuple[TimelineRow, ...]
    ticks: tuple[tuple[float, str], ...]


def drawn_topology(measured: MeasuredTopology) -> DrawnTopology:
    """The picture of the displayed run."""
    topology, critical = measured.shown.topology, measured.critical
    figures = {found.node: found for found in measured.shown.nodes}
    texts = {node.name: _node_lines(node, figures.get(node.name)) for node in topology.nodes}
    widths = {
        name: max(_NARROWEST, 2 * _PADDING + _CHARACTER * max(len(line) for line, _ in lines))
        for name, lines in texts.items()
    }
    hops: dict[tuple[str, str], list[HopFigures]] = {}
    for hop in measured.shown.hops:
        hops.setdefault((hop.publisher, hop.subscriber), []).append(hop)
    place = _Places(layered(widths, [pair for pair in hops if pair[0] != pair[1]]), widths, texts)
    marked = set(itertools.pairwise(critical.nodes)) if critical else set()
    nodes = tuple(
        _node(node, place, texts[node.name], topology, is_critical=bool(critical and node.name in critical.nodes))
        for node in topology.nodes
    )
    # The path that matters gets its text first.
    ordered = sorted(hops.items(), key=lambda arrow: arrow[0] not in marked)
    taken = [(node.x, node.y, node.x + node.width, node.y + node.height) for node in nodes]
    arrows = tuple(_arrow(pair, alike, place, taken, is_critical=pair in marked) for pair, alike in ordered)
    return DrawnTopology(
        label=printable(measured.label),
        run=printable(measured.run),
        width=place.width,
        height=place.height,
        nodes=nodes,
        # Drawn last, it is on top of the others.
        arrows=arrows[::-1],
        cycle=_cycle_text(critical, topology) if critical and critical.worst else "",
        timeline=tuple(_timeline(critical.worst)) if critical else (),
        ticks=tuple(_ticks(critical.worst[-1].end_ns)) if critical and critical.worst else (),
    )


class _Places:
    """Places of nodes and arrows in pixels."""

    def __init__(
        self, layout: Layout, widths: Mapping[str, float], texts: Mapping[str, Sequence[tuple[str, str]]]
    ) -> None:
        self.widths = widths
        self.heights = {name: _LINE * len(lines) + _PADDING for name, lines in texts.items()}
        tallest = [
            max((self.heights[name] for name in texts if layout.layer[name] == number), default=0.0)
            for number in range(layout.layers)
        ]
        self._tops = [_MARGIN + sum(tallest[:number]) + number * _WAY for number in range(layout.layers)]
        self._layout, self._tallest = layout, tallest
        self.width = layout.width + 2 * _MARGIN
        self.height = self._tops[-1] + tallest[-1] + _MARGIN if layout.layers else 0.0

    def corner(self, name: str) -> tuple[float, float]:
        """The upper left corner of a node."""
        x = self._layout.x[name] + _MARGIN - self.widths[name] / 2
        return x, self._tops[self._layout.layer[name]]

    def points(self, begin: str, end: str) -> list[tuple[float, float]]:
        """Where an arrow begins, bends and ends."""
        layer = self._layout.layer
        is_down = layer[begin] < layer[end]
        ends = []
        for name, is_top in ((begin, not is_down), (end, is_down)):
            top = self._tops[layer[name]]
            x = self._layout.x[name] + _MARGIN + (0.0 if is_down else _BACK)
            ends.append((x, top if is_top else top + self.heights[name]))
        bends = [
            (x + _MARGIN, self._tops[number] + self._tallest[number] / 2)
            for number, x in self._layout.bends[begin, end]
        ]
        return [ends[0], *bends, ends[1]]


def _node_lines(node: TopologyNode, figures: NodeFigures | None) -> list[tuple[str, str]]:
    """The text in a node: (text, class)."""
    waits = {
        Waits.PERIOD: f"every {time(node.period_ns)}",
        Waits.ANY: "on each message",
        Waits.ALL: "when all came",
    }[node.waits]
    lines = [(printable(node.name), "name"), (waits, "soft")]
    if figures is None or figures.response.max_ns is None:
        return [*lines, ("not seen", "late")]
    lines.append((f"CPU {time(figures.cpu.max_ns)}", "soft"))
    missed = node.deadline_ns is not None and is_late(figures.response.max_ns, node.deadline_ns)
    lines.append((f"done in {time(figures.response.max_ns)}", "late" if missed else "soft"))
    if figures.overruns:
        lines.append((f"{figures.overruns} overrun{'s' * (figures.overruns != 1)}", "late"))
    return lines


def _node(
    node: TopologyNode,
    place: _Places,
    lines: Sequence[tuple[str, str]],
    topology: Topology,
    *,
    is_critical: bool,
) -> DrawnNode:
    x, y = place.corner(node.name)
    executor = topology.executor[node.executor]
    policy = "no real-time priority" if executor.policy == "0" else f"{executor.policy} {executor.priority}"
    cpus = f"CPU {cpus_text(executor.cpus)}" if executor.cpus else "any CPU"
    deadline = f"; deadline {time(node.deadline_ns)}" if node.deadline_ns else ""
    return DrawnNode(
        x=x,
        y=y,
        width=place.widths[node.name],
        height=place.heights[node.name],
        style="critical" if is_critical else "",
        text=DrawnText(x=x + place.widths[node.name] / 2, y=y + _LINE, lines=tuple(lines)),
        tooltip=printable(
            f"{node.name}: busy {time(node.busy_ns)}; thread {executor.name} of process {executor.process}, {policy}, "
            f"{cpus}{deadline}"
        ),
    )


def _arrow(
    pair: tuple[str, str],
    hops: Sequence[HopFigures],
    place: _Places,
    taken: list[tuple[float, float, float, float]],
    *,
    is_critical: bool,
) -> DrawnArrow:
    """An arrow between two nodes; the place of its text is added to `taken`."""
    lines = [line for hop in hops for line in _hop_lines(hop)]
    tooltip = printable("; ".join(f"{hop.topic}: {_hop_told(hop)}" for hop in hops))
    style = "critical" if is_critical else ""
    if pair[0] == pair[1]:
        x, y = place.corner(pair[0])
        right, middle = x + place.widths[pair[0]], y + place.heights[pair[0]] / 2
        loop = f"{right + 26:.1f} {middle - 14:.1f} {right + 26:.1f} {middle + 14:.1f} {right:.1f} {middle + 8:.1f}"
        line = f"M{right:.1f} {middle - 8:.1f}C{loop}"
        return DrawnArrow(line=line, head="", style=style, text=None, tooltip=tooltip)
    points = place.points(*pair)
    (x, y), down = points[-1], points[-1][1] > points[-2][1]
    back = -_HEAD if down else _HEAD
    return DrawnArrow(
        line=_curve([*points[:-1], (x, y + back)]),
        head=f"M{x - _HEAD / 2:.1f} {y + back:.1f}H{x + _HEAD / 2:.1f}L{x:.1f} {y:.1f}Z",
        style=style,
        text=_text_on(points, lines, taken),
        tooltip=tooltip,
    )


def _curve(points: Sequence[tuple[float, float]]) -> str:
    """A path through points, vertical at each of them."""
    path = f"M{points[0][0]:.1f} {points[0][1]:.1f}"
    for (x, y), (to_x, to_y) in itertools.pairwise(points):
        middle = (y + to_y) / 2
        path += f"C{x:.1f} {middle:.1f} {to_x:.1f} {middle:.1f} {to_x:.1f} {to_y:.1f}"
    return path


def _text_on(
    points: Sequence[tuple[float, float]],
    lines: Sequence[tuple[str, str]],
    taken: list[tuple[float, float, float, float]],
) -> DrawnText | None:
    """The text of an arrow at a free place; None where there is none."""
    width, height = _CHARACTER * max(len(line) for line, _ in lines) + _PADDING, _LINE * len(lines)
    pieces = list(itertools.pairwise(points))
    for part in _TRIED:
        for (x, y), (to_x, to_y) in pieces:
            # The curve of `_curve`: vertical at both ends, half-way in the middle.
            at_x = x + (to_x - x) * part**2 * (3 - 2 * part)
            at_y = (y * (1 - part) ** 3 + to_y * part**3) + 3 * part * (1 - part) * (y + to_y) / 2
            box = (at_x - width / 2, at_y - height / 2, at_x + width / 2, at_y + height / 2)
            if all(box[0] >= b[2] or box[2] <= b[0] or box[1] >= b[3] or box[3] <= b[1] for b in taken):
                taken.append(box)
                return DrawnText(x=at_x, y=box[1] + _LINE * 0.8, lines=tuple(lines))
    return None


def _hop_lines(hop: HopFigures) -> Iterator[tuple[str, str]]:
    yield printable(hop.topic), ""
    yield (f"{time(hop.latency.median_ns)}, max {time(hop.latency.max_ns)}", "soft")
    if lost := sum(hop.lost.values()):
        yield f"{lost} lost", "late"


def _hop_told(hop: HopFigures) -> str:
    lost = "".join(f", {number} {cause}" for cause, number in hop.lost.items() if number)
    unused = f", {hop.unused} unused at the end" if hop.unused else ""
    return (
        f"{hop.sent} sent, {hop.taken} taken, {hop.overwritten} overwritten{unused}{lost}; latency median "
        f"{time(hop.latency.median_ns)}, max {time(hop.latency.max_ns)}"
    )


def _cycle_text(path: PathFigures, topology: Topology) -> str:
    limits = {known.topics: known.reaction_ns for known in topology.paths}
    limit_ns = limits.get(tuple(path.topics))
    deadline = f", deadline {time(limit_ns)}" if limit_ns else ""
    return printable(f"{' > '.join(path.nodes)}: the longest reaction, {time(path.worst[-1].end_ns)}{deadline}")


def _timeline(worst: Sequence[CycleStep]) -> Iterator[TimelineRow]:
    """A row for each node of a cycle: when its message was on the way, and when it waited, worked and published."""
    whole = max(worst[-1].end_ns, 1)
    came: CycleStep | None = None
    for step in worst:
        parts = [("wait", step.release_ns, step.begin_ns), ("work", step.begin_ns, step.done_ns)]
        parts.append(("send", step.done_ns, step.end_ns))
        texts = []
        if came is not None and came.publication_ns is not None and came.reception_ns is not None:
            parts = [
                ("way", came.publication_ns, came.reception_ns),
                # Until it was due, it waited for its period or its other inputs; then for its CPU.
                ("idle", came.reception_ns, max(came.reception_ns, step.release_ns)),
                ("wait", max(came.reception_ns, step.release_ns), step.begin_ns),
                *parts[1:],
            ]
            texts = [f"message {time(came.reception_ns - came.publication_ns)} on its way"]
        texts += [
            f"due at {time(step.release_ns)}",
            f"began at {time(step.begin_ns)}",
            f"done at {time(step.done_ns)}",
            f"sent at {time(step.end_ns)}",
        ]
        bars = ((kind, 100 * begin / whole, 100 * (end - begin) / whole) for kind, begin, end in parts if end > begin)
        yield TimelineRow(name=printable(step.node), bars=tuple(bars), tooltip=", ".join(texts))
        came = step


def _ticks(whole_ns: int) -> Iterator[tuple[float, str]]:
    """Round times, at most six."""
    step_ns = next(step for step in _STEPS_NS if 5 * step >= whole_ns)
    for at_ns in range(0, whole_ns + 1, step_ns):
        yield 100 * at_ns / max(whole_ns, 1), time(at_ns)
