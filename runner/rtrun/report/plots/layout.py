"""Places the nodes of a graph in a picture: in layers from the top down, with few crossing arrows.

After Sugiyama, Tagawa & Toda 1981: arrows that close a cycle are reversed, layers are longest paths, an arrow over
several layers bends at a place in each, and the order in a layer follows the means of the neighbours.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

Arrow = tuple[str, str]
_SWEEPS = 12
_GAP = 28.0
_BEND = 40.0  # the width that an arrow needs in a layer that it passes


class _Place(NamedTuple):
    """A node in its layer, or a place where an arrow passes through a layer."""

    source: str
    target: str
    layer: int


Neighbours = Mapping[_Place, list[_Place]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """The `layer` and centre `x` of each node; `bends` are the places (layer, x) that an arrow passes through.

    `width` is the total width, `layers` the number of layers.
    """

    layer: Mapping[str, int]
    x: Mapping[str, float]
    bends: Mapping[Arrow, Sequence[tuple[int, float]]]
    width: float
    layers: int


def layered(widths: Mapping[str, float], arrows: Sequence[Arrow]) -> Layout:
    """Lay out nodes, given with their widths, and arrows between different nodes, each arrow once."""
    downwards = _downwards(list(widths), arrows)
    layer = _layers(list(widths), downwards)
    node = {name: _Place(name, "", layer[name]) for name in widths}
    width = {node[name]: of_node for name, of_node in widths.items()}
    links: list[tuple[_Place, _Place]] = []
    passed: dict[Arrow, list[_Place]] = {}
    for arrow, (upper, lower) in zip(arrows, downwards, strict=True):
        passed[arrow] = [_Place(*arrow, at) for at in range(layer[upper] + 1, layer[lower])]
        width |= dict.fromkeys(passed[arrow], _BEND)
        links += itertools.pairwise([node[upper], *passed[arrow], node[lower]])
    rows: list[list[_Place]] = [[] for _ in range(max(layer.values(), default=0) + 1)]
    above: Neighbours = {place: [] for place in width}
    below: Neighbours = {place: [] for place in width}
    for place in width:
        rows[place.layer].append(place)
    for over, under in links:
        below[over].append(under)
        above[under].append(over)
    _order(rows, above, below)
    x = _places(rows, above, below, width)
    left = min((x[place] - width[place] / 2 for place in width), default=0.0)
    right = max((x[place] + width[place] / 2 for place in width), default=0.0)
    bends = {arrow: [(place.layer, x[place] - left) for place in places] for arrow, places in passed.items()}
    return Layout(
        layer=layer,
        x={name: x[node[name]] - left for name in widths},
        bends={arrow: bent if layer[arrow[0]] < layer[arrow[1]] else bent[::-1] for arrow, bent in bends.items()},
        width=right - left,
        layers=len(rows),
    )


def _downwards(names: Sequence[str], arrows: Sequence[Arrow]) -> list[Arrow]:
    """The arrows; those that would close a cycle are reversed."""
    after: dict[str, list[str]] = {name: [] for name in names}
    for source, target in arrows:
        after[source].append(target)
    entered = {target for _, target in arrows}
    turned: set[Arrow] = set()
    done: set[str] = set()
    # Start at nodes without incoming arrows, so that these are at the top.
    for start in (*(name for name in names if name not in entered), *names):
        way, rest = ([start], [iter(after[start])]) if start not in done else ([], [])
        done.add(start)
        while way:
            following = next(rest[-1], None)
            if following is None:
                way.pop()
                rest.pop()
            elif following in way:
                turned.add((way[-1], following))
            elif following not in done:
                done.add(following)
                way.append(following)
                rest.append(iter(after[following]))
    return [(target, source) if (source, target) in turned else (source, target) for source, target in arrows]


def _layers(names: Sequence[str], arrows: Sequence[Arrow]) -> dict[str, int]:
    """The layer of each node: the length of the longest path to it."""
    layer = dict.fromkeys(names, 0)
    for _ in names:
        moved = False
        for source, target in arrows:
            if layer[target] <= layer[source]:
                layer[target], moved = layer[source] + 1, True
        if not moved:
            break
    return layer


def _order(rows: list[list[_Place]], above: Neighbours, below: Neighbours) -> None:
    """Order each row by the mean places of its neighbours in the row before, alternating down and up."""
    for sweep in range(_SWEEPS):
        neighbours, turn = (above, rows[1:]) if sweep % 2 == 0 else (below, rows[-2::-1])
        for row in turn:
            place = {spot: number for layer in rows for number, spot in enumerate(layer)}
            row.sort(key=lambda spot: _mean([float(place[other]) for other in neighbours[spot]], float(place[spot])))


def _places(
    rows: Sequence[Sequence[_Place]],
    above: Neighbours,
    below: Neighbours,
    width: Mapping[_Place, float],
) -> dict[_Place, float]:
    """Centres in the order of the rows, with gaps between them, near the means of their neighbours."""
    x: dict[_Place, float] = {}
    for row in rows:
        at = 0.0
        for place in row:
            x[place] = at + width[place] / 2
            at += width[place] + _GAP
        for place in row:
            x[place] -= at / 2
    for sweep in range(_SWEEPS):
        for row in rows if sweep % 2 == 0 else rows[::-1]:
            wanted = [_mean([x[other] for other in (*above[place], *below[place])], x[place]) for place in row]
            x |= zip(row, _apart(row, wanted, width), strict=True)
    return x


def _apart(row: Sequence[_Place], wanted: Sequence[float], width: Mapping[_Place, float]) -> list[float]:
    """Places in their order and apart, as near to the wanted places as one pass from each side achieves."""
    least = [(width[first] + width[second]) / 2 + _GAP for first, second in itertools.pairwise(row)]
    right, left = list(wanted), list(wanted)
    for place, step in enumerate(least, start=1):
        right[place] = max(right[place], right[place - 1] + step)
    for place in range(len(least) - 1, -1, -1):
        left[place] = min(left[place], left[place + 1] - least[place])
    return [(first + second) / 2 for first, second in zip(right, left, strict=True)]


def _mean(values: Sequence[float], otherwise: float) -> float:
    return sum(values) / len(values) if values else otherwise
