"""The report's plots: what of a group is drawn, and how it is thinned so that no peak is lost."""

import math
from html import escape
from typing import Any

import numpy as np

from rtrun.analysis.extreme_values import Bound
from rtrun.analysis.histogram import Histogram, merge
from rtrun.report.digest import Digest
from rtrun.report.plots.svg import COLOURS, DASHES, FAINT, INK, Axis, Mark, Point, chart
from rtrun.report.study import Group, Study, slowest

_BINS = 240
_OVERLAID = len(COLOURS)
_FLOOR = 0.7  # of the count axis, as in the logs: a count of one is seen


def plots(group: Group, deadline_ns: int) -> list[tuple[str, str]]:
    """(caption, SVG) of every plot of a group that has values."""
    if group.n == 0 or not any(one.histogram.values_ns.size for one in group.digests):
        return []
    what = f"{group.series} in us"
    charts = [("How often each value occurred", _histograms(group, what, deadline_ns))]
    charts.append(("Value that a share of all does not exceed", _quantiles(group, what)))
    with_course = [one for one in group.digests if one.course is not None and one.figures.max_ns is not None]
    if with_course:
        worst = max(with_course, key=lambda one: one.figures.max_ns or 0)
        charts.append((f"Values over the loop index, highest ten marked, of {worst.run}", _course(worst, what)))
    shown = merge(one.histogram for one in slowest(group.digests))
    if shown.values_ns.size:
        caption = "Share of values above, with the fitted tail where there is one"
        charts.append((caption, _ccdf(group, shown, what, deadline_ns)))
    return charts


def _span(group: Group, deadline_ns: int) -> tuple[float, float]:
    """The value axis in us: all values, and the deadline where it is not far beyond them."""
    low = min(int(one.histogram.values_ns[0]) for one in group.digests if one.histogram.values_ns.size)
    high = max(int(one.histogram.values_ns[-1]) for one in group.digests if one.histogram.values_ns.size) + 1000
    if high < deadline_ns < low + 4 * (high - low):
        high = deadline_ns
    edge = 0.03 * (high - low)
    return (low - edge) / 1000, (high + edge) / 1000


def _rule(deadline_ns: int, axis: Axis) -> list[Mark]:
    at = deadline_ns / 1000
    if not axis.low <= at <= axis.high:
        return []
    return [Mark(kind="rule", points=[(at, 1.0)], colour=INK, dash="5 3", name=f"deadline {at:g} us")]


def _steps(histogram: Histogram, low_us: float, high_us: float, bins: int) -> list[Point]:
    """Counts in equal bins; the axis is drawn from there, so that bins of one microsecond stay what they are."""
    width = max(1.0, math.ceil((high_us - low_us) / bins))
    first = math.floor(low_us / width)
    at = np.floor_divide(histogram.values_ns, int(width * 1000)) - first
    size = math.ceil((high_us - low_us) / width) + 2
    counts = np.bincount(np.clip(at, 0, size - 1), weights=histogram.counts, minlength=size)
    points: list[Point] = []
    for k in range(size):
        count = max(float(counts[k]), _FLOOR)
        if points and points[-1][1] == count and k < size - 1:
            continue
        points.append(((first + k) * width, count))
    return points


def _histograms(group: Group, what: str, deadline_ns: int) -> str:
    low, high = _span(group, deadline_ns)
    marks = []
    shown = [one for one in group.digests if one.histogram.values_ns.size]
    few = len(shown) <= _OVERLAID
    for k, one in enumerate(shown):
        steps = _steps(one.histogram, low, high, _BINS if few else _BINS // 2)
        marks.append(
            Mark(
                kind="steps",
                points=steps,
                colour=COLOURS[k] if few else COLOURS[5],
                dash=DASHES[k] if few else "",
                name=_name(one) if few and len(shown) > 1 else "",
                opacity=1.0 if few else 0.5,
            )
        )
    top = max(point[1] for mark in marks for point in mark.points)
    x = Axis(low=low, high=high, label=what)
    if not few:
        steps = _steps(group.histogram, low, high, _BINS)
        top = max(top, *(point[1] for point in steps))
        marks.append(Mark(kind="steps", points=steps, name=f"all {len(shown)} together; each run in light blue"))
    y = Axis(low=_FLOOR, high=max(10.0, top * 1.5), label="count", log=True)
    return chart(f"Histogram of {group.label}", x, y, [*marks, *_rule(deadline_ns, x)])


def _name(one: Digest) -> str:
    return one.run if one.header.output in one.run else f"{one.run} {one.header.output}"


def _quantiles(group: Group, what: str) -> str:
    marks, most, low, high = [], 10.0, math.inf, -math.inf
    shown = [one for one in group.digests if one.histogram.values_ns.size][:_OVERLAID]
    for k, one in enumerate(shown):
        bins = one.histogram
        beyond = np.concatenate(([bins.n], bins.n - np.cumsum(bins.counts)))[:-1] / bins.n
        # A value stands where the share that reaches it is: 1 / share is 1, 10, 100 at p0, p90, p99.
        scale = 1 / beyond
        keep = _thin(np.log10(scale), 160)
        points = [(float(scale[i]), bins.values_ns[i] / 1000) for i in keep]
        most, low, high = max(most, scale[-1]), min(low, points[0][1]), max(high, points[-1][1])
        name = _name(one) if len(shown) > 1 else ""
        marks.append(Mark(kind="steps", points=points, colour=COLOURS[k], dash=DASHES[k], name=name))
    texts = ("p0", "p90", "p99", "p99.9", "p99.99", "p99.999", "p99.9999", "p99.99999")
    x = Axis(
        low=1.0,
        high=float(most),
        label="percentile",
        log=True,
        ticks=tuple((10.0**k, text) for k, text in enumerate(texts)),
    )
    if len(x.marks()) > 6:
        x = Axis(low=1.0, high=float(most), label="percentile", log=True, ticks=x.ticks[::2])
    edge = 0.05 * max(high - low, 1.0)
    return chart(f"Quantiles of {group.label}", x, Axis(low=low - edge, high=high + edge, label=what), marks)


def _thin(places: Any, most: int) -> list[int]:
    """Indices of rising places, at most so many plus the last, evenly along the axis."""
    span = float(places[-1] - places[0]) or 1.0
    cell = np.floor((places - places[0]) / span * most)
    keep = np.flatnonzero(np.diff(cell, prepend=-1.0)).tolist()
    return keep if keep[-1] == len(places) - 1 else [*keep, len(places) - 1]


def _course(one: Digest, what: str) -> str:
    course = one.course
    assert course is not None
    points: list[Point] = []
    for k, (low, high) in enumerate(zip(course.low_ns, course.high_ns, strict=True)):
        middle = (k + 0.5) * course.width
        points += [(middle, low / 1000), (middle, high / 1000)]
    skipped = len(one.header.startup)
    listed = [e for e in one.figures.top if e.index is not None]
    dots = [((e.index or 0) - skipped, e.value_ns / 1000) for e in listed]
    marks = [
        Mark(kind="band", points=points, colour=COLOURS[5], name=f"lowest to highest of each {course.width} loops"),
        Mark(
            kind="dots",
            points=dots,
            colour=COLOURS[1],
            name="ten highest",
            titles=[f"{e.value_ns / 1000:g} us at loop {e.index}" for e in listed],
        ),
    ]
    low, high = min(p[1] for p in points), max(p[1] for p in points)
    edge = 0.05 * max(high - low, 1.0)
    end = max(1.0, float(len(course.low_ns) * course.width))
    x = Axis(low=0.0, high=end, label="loop index")
    return chart(f"Values over time of {one.run}", x, Axis(low=low - edge, high=high + edge, label=what), marks)


def _ccdf(group: Group, bins: Histogram, what: str, deadline_ns: int) -> str:
    low, high = _span(group, deadline_ns)
    n = bins.n
    above = (n - np.cumsum(bins.counts)) / n
    seen = above > 0
    values, above = (bins.values_ns[seen] + bins.bin_ns) / 1000, above[seen]
    keep = _thin(-np.log10(above), 200) if above.size else []
    points: list[Point] = [(low, 1.0), *((float(values[i]), float(above[i])) for i in keep)]
    points.append(((int(bins.values_ns[-1]) + bins.bin_ns) / 1000, 0.5 / n))
    marks = [
        Mark(
            kind="steps",
            points=points,
            name="measured"
            if len(slowest(group.digests)) == len(group.digests)
            else "measured by the slowest subscriber",
        )
    ]
    floor = 0.5 / n
    for bound in group.bounds:
        if bound.refused is None and bound.method == "GPD":
            fitted = _fitted(bound)
            floor = min(floor, bound.probability)
            high = max(high, (bound.high_ns or 0) / 1000 * 1.03)
            marks.append(
                Mark(
                    kind="line",
                    points=fitted,
                    colour=COLOURS[1],
                    dash="6 2",
                    name="fitted tail (GPD), bursts count once",
                )
            )
            marks.append(
                Mark(
                    kind="dots",
                    points=[((bound.high_ns or 0) / 1000, bound.probability)],
                    colour=COLOURS[2],
                    name=f"bound {(bound.high_ns or 0) / 1000:.0f} us at {bound.probability:g} "
                    f"({100 * bound.confidence:g} %)",
                )
            )
    x = Axis(low=low, high=high, label=what)
    y = Axis(low=10 ** math.floor(math.log10(floor)), high=1.0, label="share above", log=True)
    return chart(f"Exceedance of {group.label}", x, y, [*marks, *_rule(deadline_ns, x)])


def _fitted(bound: Bound) -> list[Point]:
    from rtrun.analysis.tails import GPD

    assert bound.rate is not None and bound.shape is not None and bound.scale_ns is not None
    base = float(bound.threshold_ns or 0)
    chances = np.geomspace(1.0, bound.probability / bound.rate, 40)
    parameters = (bound.shape, bound.scale_ns)
    return [((base + GPD.level(float(c), parameters)) / 1000, float(c) * bound.rate) for c in chances]


def long_term(study: Study, suite: str) -> dict[str, Any] | None:
    """Value x count x run of a suite, as thesis figures 5.2 to 5.4: plain data for the still and the turning picture.

    ``values_us`` are lower edges of equal columns, ``rows`` one list of log10 counts (-1: none) for each output.
    """
    shown = [d for g in study.groups if g.suite == suite for d in g.digests if d.histogram.values_ns.size]
    if not shown:
        return None
    low = min(int(d.histogram.values_ns[0]) for d in shown) // 1000
    high = max(int(d.histogram.values_ns[-1]) for d in shown) // 1000 + 1
    columns = 120
    width = max(1, -(-(high - low) // columns))
    size = (high - low) // width + 1
    rows = []
    for d in shown:
        at = (d.histogram.values_ns // 1000 - low) // width
        counts = np.bincount(at, weights=d.histogram.counts, minlength=size)
        with np.errstate(divide="ignore"):
            heights = np.where(counts > 0, np.log10(np.maximum(counts, 1e-9)), -1.0)
        rows.append({"name": _name(d), "log10": [round(float(h), 2) for h in heights]})
    return {"low_us": low, "width_us": width, "size": size, "rows": rows, "measurements": sum(d.n for d in shown)}


def long_term_still(data: dict[str, Any], title: str) -> str:
    """The long-term plot from the side as SVG: runs one behind the other, each hiding what lies behind it."""
    rows, size = data["rows"], data["size"]
    top = max(1.0, *(h for row in rows for h in row["log10"]))
    width, height, depth = 400.0, 170.0, 110.0
    parts = []
    for k in range(len(rows) - 1, -1, -1):
        back = k / max(1, len(rows) - 1)
        left, floor = 40 + 60 * back, 270 - depth * back
        run = "".join(
            f"L{left + i / max(1, size - 1) * (width - 60):.1f} {floor - (h + 1) / (top + 1) * height * 0.8:.1f}"
            for i, h in enumerate(rows[k]["log10"])
        )
        parts.append(
            f'<path d="M{left:.1f} {floor:.1f}{run}L{left + width - 60:.1f} {floor:.1f}Z" fill="#fff" '
            f'fill-opacity=".85" stroke="{COLOURS[0]}" stroke-width=".8">'
            f"<title>{escape(rows[k]['name'])}</title></path>"
        )
    end = data["low_us"] + data["size"] * data["width_us"]
    ticks = [data["low_us"] + (end - data["low_us"]) * k / 4 for k in range(5)]
    for k, tick in enumerate(ticks):
        x = 40 + k / 4 * (width - 60)
        parts.append(f'<text x="{x:.1f}" y="286" text-anchor="middle">{tick:.0f}</text>')
    for k in range(math.floor(top) + 1):
        y = 270 - (k + 1) / (top + 1) * height * 0.8
        parts.append(
            f'<path d="M36 {y:.1f}H40" stroke="{FAINT}"/><text x="34" y="{y + 4:.1f}" text-anchor="end">1e{k}</text>'
        )
    return (
        f'<svg viewBox="-8 0 488 310" role="img" aria-label="{escape(title)}" xmlns="http://www.w3.org/2000/svg" '
        f'font-family="sans-serif" font-size="12" fill="{INK}">{"".join(parts)}'
        '<text x="210" y="304" text-anchor="middle">value in us</text>'
        '<text x="40" y="130" text-anchor="middle">count</text>'
        f'<text x="425" y="215">{len(rows)} series</text></svg>'
    )
