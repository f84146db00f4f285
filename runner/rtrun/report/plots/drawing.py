"""A plot as a page draws it: SVG paths that stretch to the available width, between ticks that are page text.

The pictures are there as soon as the page opens, also on paper and without scripts; the page's styles colour them.
"""

import base64
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtfiles.output import printable
from rtfiles.quantities import grouped
from rtrun.analysis.scale import Floats
from rtrun.report.plots.axes import Axis

_SIZE = 1000  # of a drawing, in units of its paths
# From few to many, readable on white and on black; after Nuñez, Anderton & Renslow (2018), "cividis".
_FEW_TO_MANY = ((0, 60, 120), (76, 95, 135), (124, 123, 120), (175, 154, 108), (215, 186, 80), (253, 231, 55))

Kind = Literal["line", "solid", "steps", "area", "dots", "limit"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mark:
    """A thing to draw: a line, dashed or solid, steps that last until the next `x`, an area from `low` to `y`, dots.

    `colour` is the number of a colour of the page. A limit is not a measurement: a line across the whole plot.
    """

    name: str
    kind: Kind
    x: Floats
    y: Floats
    low: Floats | None = None
    colour: int = 0


def make_mark(kind: Kind, name: str, x: Any, y: Any, colour: int = 0, low: Floats | None = None) -> Mark:
    """A mark of any numbers."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    return Mark(kind=kind, name=name, x=x, y=y, colour=colour, low=low)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Cells:
    """Counts as colours: `counts` (rows, columns) between the column edges and the row edges."""

    x_edges: Floats
    y_edges: Floats
    counts: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Plot:
    """A plot: `id` distinguishes it from others of its scenario, `caption` is a sentence on what it shows."""

    id: str
    caption: str
    x: Axis
    y: Axis
    marks: Sequence[Mark]
    cells: Cells | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Drawn:
    """A plot as a template takes it. Places are percentages of the drawing's width, and of its height from the top.

    `paths` are (class, colour, path), `keys` (class, colour, name), ticks (place, text), `limits` (class, place, name):
    a limit has its name at its line, upright or level, and back from it where it is near the end. `data` is what was
    drawn, for the page's script, which shows it under the pointer and writes it as CSV.
    """

    id: str
    caption: str
    x_title: str
    y_title: str
    x_ticks: Sequence[tuple[float, str]]
    y_ticks: Sequence[tuple[float, str]]
    paths: Sequence[tuple[str, int, str]]
    keys: Sequence[tuple[str, int, str]]
    limits: Sequence[tuple[str, float, str]]
    picture: str = ""
    colours: Sequence[tuple[str, str]] = ()
    data: Mapping[str, Any] = field(default_factory=dict)


def drawn(plot: Plot) -> Drawn:
    """The drawing of a plot."""
    x_ticks = [(100 * float(plot.x.scale.at(value)), text) for value, text in plot.x.ticks]
    y_ticks = [(100 * (1 - float(plot.y.scale.at(value))), text) for value, text in plot.y.ticks]
    grid = "".join(f"M{10 * place:.0f} 0V{_SIZE}" for place, _ in x_ticks)
    grid += "".join(f"M0 {10 * place:.0f}H{_SIZE}" for place, _ in y_ticks)
    axes = {name: {"title": axis.title, "unit": axis.unit} for name, axis in (("x", plot.x), ("y", plot.y))}
    more: dict[str, Any] = {}
    if plot.cells is not None:
        more["picture"] = _picture(plot, plot.cells)
        more["colours"] = _colours(int(plot.cells.counts.max()))
    return Drawn(
        id=plot.id,
        caption=plot.caption,
        x_title=plot.x.title,
        y_title=plot.y.title,
        x_ticks=x_ticks,
        y_ticks=y_ticks,
        paths=[("grid", 0, grid), *((mark.kind, mark.colour, _path(plot, mark)) for mark in plot.marks)],
        # Pieces of a line that has gaps share one key.
        keys=[
            *dict.fromkeys((mark.kind, mark.colour, printable(mark.name)) for mark in plot.marks if not _at_line(mark))
        ],
        limits=[_limit(plot, mark) for mark in plot.marks if _at_line(mark)],
        data=axes | _data(plot),
        **more,
    )


def _at_line(mark: Mark) -> bool:
    return mark.kind == "limit" and mark.x.size > 0


def _limit(plot: Plot, mark: Mark) -> tuple[str, float, str]:
    if mark.x[0] == mark.x[-1]:
        style, place = "upright", float(plot.x.scale.at(mark.x[0]))
        is_back = place > 0.5
    else:
        style, place = "level", 1 - float(plot.y.scale.at(mark.y[0]))
        is_back = place < 0.15
    return f"{style} back" if is_back else style, 100 * place, printable(mark.name)


def _data(plot: Plot) -> dict[str, Any]:
    marks = [
        {
            "name": printable(mark.name),
            "x": rounded(mark.x),
            "y": rounded(mark.y),
            **({} if mark.low is None else {"low": rounded(mark.low)}),
        }
        for mark in plot.marks
    ]
    cells = plot.cells
    if cells is None:
        return {"marks": marks}
    places = rounded(plot.y.scale.at(cells.y_edges), 4)
    edges = {"x": rounded(cells.x_edges), "y": rounded(cells.y_edges), "places": places}
    return {"marks": marks, "cells": edges | {"counts": cells.counts.tolist()}}


def _path(plot: Plot, mark: Mark) -> str:
    """The path of a mark; its points have the order of the data."""
    xs, ys = _units(plot.x.scale.at(mark.x)), _units(1 - plot.y.scale.at(mark.y))
    if mark.kind == "dots":
        return "".join(f"M{x} {y}h0" for x, y in zip(xs, ys, strict=True))
    if mark.kind == "area":
        assert mark.low is not None
        lows = _units(1 - plot.y.scale.at(mark.low))
        return _steps(xs, ys) + _steps(xs[::-1], lows[::-1], is_back=True).replace("M", "L", 1) + "Z"
    if mark.kind == "steps":
        return _steps(xs, ys)
    return "M" + "L".join(f"{x} {y}" for x, y in zip(xs, ys, strict=True)) if xs else ""


def _steps(xs: Sequence[str], ys: Sequence[str], *, is_back: bool = False) -> str:
    """A line that keeps the height of a point up to the next one; going back, it changes before the point."""
    form = "V{1}H{0}" if is_back else "H{0}V{1}"
    rest = "".join(form.format(x, y) for x, y in zip(xs[1:], ys[1:], strict=True))
    return f"M{xs[0]} {ys[0]}{rest}" if xs else ""


def _units(places: Floats) -> list[str]:
    return [f"{place:g}" for place in np.round(places * _SIZE, 1).tolist()]


def _picture(plot: Plot, cells: Cells) -> str:
    """A PNG of the cells, of equally large rows and columns on the axes; transparent where the count is 0."""
    rows = np.clip(np.searchsorted(cells.y_edges, _centres(plot.y, cells.counts.shape[0]), "right") - 1, 0, None)
    counts = cells.counts[np.minimum(rows, cells.counts.shape[0] - 1)][::-1]
    return "data:image/png;base64," + base64.b64encode(_png(_levels(counts))).decode()


def _centres(axis: Axis, count: int) -> Floats:
    # At least two pixels per row, so that rows of different height keep their places.
    pixels = 4 * count
    return axis.scale.values_at((np.arange(pixels) + 0.5) / pixels)


def _levels(counts: NDArray[np.int64]) -> NDArray[np.uint8]:
    """0 for an empty cell; 1 to 255 by the logarithm of the count."""
    most = max(2, int(counts.max()))
    levels = 1 + np.round(254 * np.log(np.maximum(counts, 1)) / np.log(most))
    return np.where(counts > 0, levels, 0).astype(np.uint8)


def _png(levels: NDArray[np.uint8]) -> bytes:
    """An image with a byte per pixel: indexed colours, the first of them transparent (PNG, W3C 2003)."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    height, width = levels.shape
    anchors = np.linspace(1, 255, len(_FEW_TO_MANY))
    palette = np.stack([np.interp(np.arange(256), anchors, channel) for channel in zip(*_FEW_TO_MANY, strict=True)], 1)
    lines = b"".join(b"\0" + line.tobytes() for line in levels)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        [
            chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)),
            chunk(b"PLTE", palette.round().astype(np.uint8).tobytes()),
            chunk(b"tRNS", b"\0"),
            chunk(b"IDAT", zlib.compress(lines, 9)),
            chunk(b"IEND", b""),
        ]
    )


def _colours(most: int) -> list[tuple[str, str]]:
    """The colours from few to many, each with the count it stands for; no count occurs twice."""
    top = np.log(max(2, most))
    last = len(_FEW_TO_MANY) - 1
    exact = np.exp(top * np.arange(last + 1) / last)
    # Of colours with the same rounded count, keep the nearest.
    nearest_last = np.argsort(-np.abs(exact - np.round(exact)), kind="stable").tolist()
    of_count = {round(float(exact[k])): _FEW_TO_MANY[k] for k in nearest_last}
    return [(f"rgb{colour}".replace(" ", ""), grouped(count)) for count, colour in sorted(of_count.items())]


def rounded(values: Any, digits: int = 6) -> list[float]:
    """Plain numbers, non-integers rounded to `digits` significant digits, to keep the page small."""
    numbers = np.asarray(values, dtype=np.float64).tolist()
    return [int(value) if value.is_integer() else float(f"{value:.{digits}g}") for value in numbers]
