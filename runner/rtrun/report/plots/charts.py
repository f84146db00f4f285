"""The plots of a scenario as plotly takes them, thinned so that no peak is lost.

A colour is the name of a CSS variable of the page, so that a plot follows the page from light to dark and to paper.
Text in a figure passes `plain` first: plotly obeys some HTML.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rtfiles.output import printable
from rtfiles.quantities import grouped
from rtrun.analysis.extreme_values import Bound
from rtrun.analysis.histogram import Histogram, merge
from rtrun.judgement.digest import Digest, JudgedDigest
from rtrun.judgement.groups import slowest
from rtrun.report.plots.scale import Division, Scale, rounded, scale_of
from rtrun.report.scenarios import Scenario, output_labels

_BINS = 240
_BINS_3D = 80
_COLOURS = 8  # --series-0 to --series-7; so many outputs are drawn each on its own
_DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot", "5px,2px", "2px,4px")
_EMPTY = 0.7  # where a bin without a value lies on the logarithmic axis of counts
_NUMBERED = 12  # outputs with a tick each
_HOVER = "%{text}<extra></extra>"

Trace = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A plot: what it shows in a sentence, and plotly's ``data`` and ``layout``."""

    caption: str
    data: list[Trace]
    layout: dict[str, Any]


def plots(scenario: Scenario, *, probability: float) -> list[Plot]:
    """Every plot of a scenario; none where it has no values."""
    group = scenario.group
    shown = [one for one in group.digests if one.histogram.values_ns.size]
    if not shown:
        return []
    limit_us = group.question.deadline_ns / 1000 if group.question else None
    what = f"{group.series} in us"
    scale = scale_of(merge(one.histogram for one in shown), limit_us)
    drawn = [_histograms(shown, scale, what, limit_us)]
    slow = [one for one in slowest(group.digests) if one.histogram.values_ns.size]
    if slow:
        drawn.append(_exceedance(scenario, shown, slow, scale, what, limit_us, probability))
    with_course = [one for one in shown if one.course is not None and one.figures.max_ns is not None]
    if with_course:
        worst = max(with_course, key=lambda one: one.figures.max_ns or 0)
        drawn.append(_course(worst, scale, what, limit_us))
    if len(shown) > 1:
        drawn.append(_outputs(shown, scale, what))
    return drawn


def plain(text: str) -> str:
    """Text that plotly shows as it is."""
    return printable(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _line(k: int, name: str, x: Any, y: Any, text: Sequence[str], **more: Any) -> Trace:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": plain(name),
        "x": rounded(x),
        "y": rounded(y),
        "text": list(text),
        "hovertemplate": _HOVER,
        "line": {"color": f"--series-{k}", "dash": _DASHES[k], "shape": "hv", "width": 1.6},
    } | more


def _limit(limit_us: float | None, scale: Scale, across: Sequence[float], *, is_upright: bool) -> list[Trace]:
    """The line of the deadline, between the two places `across` its axis; none where there is no deadline."""
    if limit_us is None:
        return []
    name = f"deadline {limit_us:g} us"
    place = float(scale.place(limit_us))
    x, y = ([place, place], across) if is_upright else (across, [place, place])
    line = {"color": "--ink", "dash": "dash", "width": 1.5}
    return [_line(0, name, x, y, [name, name]) | {"line": line}]


def _histograms(shown: Sequence[Digest], scale: Scale, what: str, limit_us: float | None) -> Plot:
    edges = scale.edges_us(_BINS)
    named = [(label, one.histogram) for label, one in zip(output_labels(shown), shown, strict=True)]
    if len(named) > _COLOURS:
        named = [(f"all {len(shown)} outputs", merge(bins for _, bins in named))]
    data = []
    top = 1.0
    for k, (name, bins) in enumerate(named):
        counts = _counted(bins, edges)
        # A step is told only where the count changes.
        keep = np.flatnonzero(np.diff(counts, prepend=-1.0, append=-1.0)[:-1] != 0)
        keep = np.append(keep, counts.size)
        counts = np.append(counts, 0.0)
        top = max(top, float(counts.max()))
        text = [f"{_count(counts[i])} from {edges[i]:g} us to {edges[j]:g} us" for i, j in _pairs(keep, edges.size - 1)]
        data.append(_line(k, name, scale.place(edges[keep]), np.maximum(counts[keep], _EMPTY), text))
    data += _limit(limit_us, scale, [_EMPTY, top], is_upright=True)
    layout = {"xaxis": scale.axis(what), "yaxis": _log("count")}
    return Plot(caption="How often each value occurred.", data=data, layout=layout)


def _pairs(keep: Any, last: int) -> list[tuple[int, int]]:
    ends = [*keep[1:].tolist(), last]
    return list(zip(keep.tolist(), ends, strict=True))


def _count(count: float) -> str:
    return f"{grouped(count)} values" if count else "no value"


def _counted(bins: Histogram, edges_us: Any) -> Any:
    at = np.clip(np.searchsorted(edges_us, bins.values_ns / 1000, side="right") - 1, 0, edges_us.size - 2)
    return np.bincount(at, weights=bins.counts, minlength=edges_us.size - 1)


def _log(title: str) -> dict[str, Any]:
    return {"title": {"text": title}, "type": "log", "dtick": 1}


def _exceedance(
    scenario: Scenario,
    shown: Sequence[Digest],
    slow: Sequence[Digest],
    scale: Scale,
    what: str,
    limit_us: float | None,
    probability: float,
) -> Plot:
    group = scenario.group
    together = "all" if len(slow) == len(group.digests) else "slowest subscriber of each run"
    data = [_share_above(0, "measured" if len(shown) == 1 else together, merge(one.histogram for one in slow), scale)]
    if 1 < len(shown) < _COLOURS:
        for k, (label, one) in enumerate(zip(output_labels(shown), shown, strict=True), start=1):
            line = _share_above(k, label, one.histogram, scale)
            line["line"]["width"] = 1
            data.append(line)
    floor = min(0.5 / max(one.n for one in shown), probability)
    for bound in group.bounds:
        if bound.refused is None and bound.method == "GPD" and bound.high_ns is not None:
            data += _tail(bound, scale)
            floor = min(floor, bound.probability)
    data += _limit(limit_us, scale, [floor, 1.0], is_upright=True)
    ends = [min(min(trace["x"]) for trace in data), max(max(trace["x"]) for trace in data)]
    name = f"P = {probability:g}, asked for"
    line = {"color": "--ink", "dash": "dot", "width": 1.5}
    data.append(_line(0, name, ends, [probability] * 2, [name] * 2) | {"line": line})
    return Plot(
        caption="Share of the values above each value, with the fitted tail where there is one. "
        "What lies right of the deadline is late.",
        data=data,
        layout={"xaxis": scale.axis(what), "yaxis": _log("share above") | {"exponentformat": "power"}},
    )


def _share_above(k: int, name: str, bins: Histogram, scale: Scale) -> Trace:
    above = bins.n - np.cumsum(bins.counts)
    # The last value has none above it, which a logarithm cannot show: half a value stands for it.
    places = np.log10(bins.n / np.maximum(above, 0.5))
    keep = _thin(places, 200)
    values = (bins.values_ns[keep] + bins.bin_ns) / 1000
    late = above[keep]
    n = grouped(bins.n)
    text = [f"all {n} above"] + [
        f"{_count(count)} of {n} above {value:g} us" for count, value in zip(late, values, strict=True)
    ]
    x = np.concatenate(([bins.values_ns[0] / 1000], values))
    return _line(k, name, scale.place(x), np.concatenate(([1.0], np.maximum(late, 0.5) / bins.n)), text)


def _thin(places: Any, most: int) -> Any:
    """Indices of rising places, at most so many plus the last, evenly along the axis."""
    span = float(places[-1] - places[0]) or 1.0
    cell = np.floor((places - places[0]) / span * most)
    keep = np.flatnonzero(np.diff(cell, prepend=-1.0))
    return keep if keep[-1] == len(places) - 1 else np.append(keep, len(places) - 1)


def _tail(bound: Bound, scale: Scale) -> list[Trace]:
    from rtrun.analysis.tails import GPD

    assert bound.rate is not None and bound.shape is not None and bound.scale_ns is not None
    assert bound.high_ns is not None
    chances = np.geomspace(1.0, bound.probability / bound.rate, 40)
    base = float(bound.threshold_ns or 0)
    values = [(base + GPD.level(float(c), (bound.shape, bound.scale_ns))) / 1000 for c in chances]
    shares = chances * bound.rate
    text = [f"{value:.1f} us at {share:.2g}" for value, share in zip(values, shares, strict=True)]
    fitted = _line(1, "fitted tail (GPD), bursts count once", scale.place(values), shares, text)
    fitted["line"] |= {"shape": "linear", "dash": "dash"}
    high_us = bound.high_ns / 1000
    name = f"bound {high_us:.0f} us at {bound.probability:g} ({100 * bound.confidence:g} %)"
    dot = _line(2, name, scale.place([high_us]), [bound.probability], [name])
    return [fitted, dot | {"mode": "markers", "marker": {"color": "--series-2", "size": 9, "symbol": "diamond"}}]


def _course(one: JudgedDigest, scale: Scale, what: str, limit_us: float | None) -> Plot:
    course = one.course
    assert course is not None
    skipped, size = len(one.header.startup), len(course.low_ns)
    loops = skipped + np.arange(size) * course.width
    low, high = course.low_ns / 1000, course.high_ns / 1000
    if course.width == 1:
        text = [f"{value:g} us in loop {loop}" for value, loop in zip(high, loops, strict=True)]
        values = _line(0, "values", loops, scale.place(high), text)
        values["line"] |= {"shape": "linear", "width": 1}
        data = [values | {"mode": "lines+markers", "marker": {"color": "--series-0", "size": 4}}]
        caption = "Values over the loops"
    else:
        text = [
            f"{a:g} us to {b:g} us in loops {loop} to {loop + course.width - 1}"
            for a, b, loop in zip(low, high, loops, strict=True)
        ]
        name = f"lowest to highest of each {course.width} loops"
        bottom = _line(0, name, loops, scale.place(low), text, showlegend=False, legendgroup="range")
        top = _line(0, name, loops, scale.place(high), text, fill="tonexty", legendgroup="range")
        data = [bottom, top]
        caption = f"Lowest to highest of each {course.width} loops"
    listed = [(e.index, e.value_ns / 1000) for e in one.figures.top if e.index is not None]
    dots = _line(
        1,
        f"{len(listed)} highest",
        [index for index, _ in listed],
        scale.place([value for _, value in listed]),
        [f"{value:g} us in loop {index}" for index, value in listed],
    )
    data.append(dots | {"mode": "markers", "marker": {"color": "--series-1", "size": 9, "symbol": "circle-open"}})
    data += _limit(limit_us, scale, [skipped, skipped + max(1, size * course.width - 1)], is_upright=False)
    layout = {"xaxis": {"title": {"text": "loop"}}, "yaxis": scale.axis(what)}
    return Plot(
        caption=f"{caption} of {one.header.output} in {one.run}, where the highest value is.", data=data, layout=layout
    )


def _outputs(shown: Sequence[Digest], scale: Scale, what: str) -> Plot:
    """Value, count and run, as figures 5.2 to 5.4 of the thesis; the page shows it flat where it cannot be turned."""
    low = min(float(one.histogram.values_ns[0]) for one in shown) / 1000
    high = max(float(one.histogram.values_ns[-1]) for one in shown) / 1000
    part = Scale(division=scale.division, low_us=low, high_us=high)
    # A surface has no logarithmic axis.
    flat = part if part.division is Division.LINEAR else replace(part, division=Division.SIGNED)
    edges = part.edges_us(_BINS_3D)
    counts = np.array([_counted(one.histogram, edges) for one in shown])
    heights = np.round(np.log10(np.maximum(counts, 0.5)), 2)
    places = flat.place(edges[:-1])
    ticks = np.linspace(0, len(places) - 1, 5).astype(int)
    names = [plain(label) for label in output_labels(shown)]
    text = [
        [f"{name}<br>{edges[k]:g} us to {edges[k + 1]:g} us<br>{_count(row[k])}" for k in range(row.size)]
        for name, row in zip(names, counts, strict=True)
    ]
    rows = list(range(1, len(shown) + 1))
    top = math.ceil(float(heights.max()))
    trace = {
        "type": "surface",
        "x": rounded(places),
        "y": rows,
        "z": heights.tolist(),
        "text": text,
        "hovertemplate": _HOVER,
        "colorscale": "Cividis",
        "colorbar": {
            "title": {"text": "count"},
            "tickvals": list(range(top + 1)),
            "ticktext": [f"1e{k}" for k in range(top + 1)],
            "thickness": 12,
        },
    }
    x = {
        "title": {"text": what},
        "tickvals": rounded(places[ticks]),
        "ticktext": [f"{edges[k]:.0f}" for k in ticks],
    }
    y: dict[str, Any] = {"title": {"text": "output"}}
    if len(shown) <= _NUMBERED:
        y["tickvals"] = rows
    z = {"title": {"text": "count"}, "tickvals": list(range(top + 1)), "ticktext": [f"1e{k}" for k in range(top + 1)]}
    return Plot(
        caption=f"How often each value occurred in each of {len(shown)} outputs: the thesis' long-term picture.",
        data=[trace],
        layout={
            "scene": {"xaxis": x, "yaxis": y, "zaxis": z, "camera": {"eye": {"x": 1.6, "y": 1.6, "z": 1.1}}},
            "xaxis": x,
            "yaxis": y,
        },
    )
