"""Charts as SVG text: axes with units, colours a colour-blind reader can tell apart, the same input the same bytes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

# Okabe & Ito (2008), "Color Universal Design"; dashes tell the lines apart without any colour.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ("", "6 2", "2 2", "8 2 2 2", "4 4", "1 3")
INK, FAINT = "#222222", "#cccccc"
WIDTH, HEIGHT = 480, 300
_LEFT, _RIGHT, _TOP, _BOTTOM = 58, 26, 14, 44

Point = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Axis:
    """An axis from low to high; with `log`, both are positive. `ticks` are (value, text) where they are not regular."""

    low: float
    high: float
    label: str
    log: bool = False
    ticks: tuple[tuple[float, str], ...] = ()

    def position(self, value: float) -> float:
        """Where a value lies between the ends, 0 to 1; values beyond an end lie on it."""
        low, high = float(self.low), float(self.high)
        if self.log:
            low, high, value = math.log10(low), math.log10(high), math.log10(max(value, self.low))
        if high <= low:
            return 0.5
        return min(1.0, max(0.0, (value - low) / (high - low)))

    def marks(self) -> list[tuple[float, str]]:
        """Values with the text of their tick."""
        if self.ticks:
            return [tick for tick in self.ticks if self.low <= tick[0] <= self.high]
        if self.log:
            first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
            every = max(1, -(-(last - first + 1) // 7))
            return [(10.0**e, _power(e)) for e in range(first, last + 1, every)]
        step = _round_step((self.high - self.low) / 5)
        start = math.ceil(self.low / step - 1e-9)
        return [(k * step, _number(k * step)) for k in range(start, math.floor(self.high / step + 1e-9) + 1)]


@dataclass(frozen=True, kw_only=True)
class Mark:
    """What is drawn: ``kind`` is line, steps, band (pairs of points: low, high), dots or rule (one x)."""

    kind: str
    points: Sequence[Point]
    colour: str = COLOURS[0]
    dash: str = ""
    name: str = ""
    titles: Sequence[str] = ()
    opacity: float = 1.0


def chart(title: str, x: Axis, y: Axis, marks: Sequence[Mark]) -> str:
    """Return one chart as an SVG element; its title is what a screen reader says."""

    def at(point: Point) -> tuple[str, str]:
        across = _LEFT + x.position(point[0]) * (WIDTH - _LEFT - _RIGHT)
        down = HEIGHT - _BOTTOM - y.position(point[1]) * (HEIGHT - _TOP - _BOTTOM)
        return _short(across), _short(down)

    named = [mark for mark in marks if mark.name]
    height = HEIGHT + 16 * len(named)
    parts = [
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(title)}" '
        f'xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" font-size="12" fill="{INK}">'
    ]
    for value, text in x.marks():
        px = at((value, y.low))[0]
        parts.append(f'<path d="M{px} {_TOP}V{HEIGHT - _BOTTOM}" stroke="{FAINT}" stroke-width=".6"/>')
        parts.append(f'<text x="{px}" y="{HEIGHT - _BOTTOM + 15}" text-anchor="middle">{escape(text)}</text>')
    for value, text in y.marks():
        py = at((x.low, value))[1]
        parts.append(f'<path d="M{_LEFT} {py}H{WIDTH - _RIGHT}" stroke="{FAINT}" stroke-width=".6"/>')
        parts.append(f'<text x="{_LEFT - 5}" y="{py}" dy="4" text-anchor="end">{escape(text)}</text>')
    parts.append(
        f'<path d="M{_LEFT} {_TOP}V{HEIGHT - _BOTTOM}H{WIDTH - _RIGHT}" fill="none" stroke="{INK}"/>'
        f'<text x="{(_LEFT + WIDTH - _RIGHT) // 2}" y="{HEIGHT - 8}" text-anchor="middle">{escape(x.label)}</text>'
        f'<text transform="translate(12 {(HEIGHT - _BOTTOM + _TOP) // 2}) rotate(-90)" text-anchor="middle">'
        f"{escape(y.label)}</text>"
    )
    parts += [_draw(mark, at) for mark in marks]
    for row, mark in enumerate(named):
        down = HEIGHT + 16 * row + 6
        parts.append(
            f'<path d="M{_LEFT} {down}h24" stroke="{mark.colour}" stroke-width="2.5" stroke-dasharray="{mark.dash}"/>'
            f'<text x="{_LEFT + 30}" y="{down + 4}">{escape(_cut(mark.name))}</text>'
        )
    return "".join(parts) + "</svg>"


def _draw(mark: Mark, at: Callable[[Point], tuple[str, str]]) -> str:
    style = f'stroke="{mark.colour}" stroke-width="1.5" stroke-dasharray="{mark.dash}" opacity="{mark.opacity:g}"'
    places = [at(point) for point in mark.points]
    if not places:
        return ""
    if mark.kind == "rule":
        return f'<path d="M{places[0][0]} {_TOP}V{HEIGHT - _BOTTOM}" {style}/>'
    if mark.kind == "dots":
        drawn = []
        for (px, py), title in zip(places, [*mark.titles, *[""] * len(places)], strict=False):
            tooltip = f"<title>{escape(title)}</title>" if title else ""
            drawn.append(f'<circle cx="{px}" cy="{py}" r="3" fill="none" {style}>{tooltip}</circle>')
        return "".join(drawn)
    if mark.kind == "band":
        lines = "".join(f"M{a[0]} {a[1]}V{b[1]}" for a, b in zip(places[::2], places[1::2], strict=True))
        return f'<path d="{lines}" fill="none" {style}/>'
    if mark.kind == "steps":
        path = f"M{places[0][0]} {places[0][1]}" + "".join(f"H{px}V{py}" for px, py in places[1:])
    else:
        path = "M" + "L".join(f"{px} {py}" for px, py in places)
    return f'<path d="{path}" fill="none" {style}/>'


def _cut(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _short(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def _power(exponent: int) -> str:
    return f"{10**exponent:g}" if 0 <= exponent <= 3 else f"1e{exponent}"


def _number(value: float) -> str:
    return f"{value:.6g}" if abs(value) < 1e6 else f"{value:.3g}"


def _round_step(raw: float) -> float:
    if raw <= 0:
        return 1.0
    unit = 10.0 ** math.floor(math.log10(raw))
    return next(unit * factor for factor in (1, 2, 5, 10) if raw <= unit * factor * (1 + 1e-9))
