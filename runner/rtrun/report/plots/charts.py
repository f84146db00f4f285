"""The plots of a scenario, thinned without losing any peak."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rtfiles.quantities import grouped, time
from rtrun.analysis.histogram import Histogram, merge
from rtrun.analysis.scale import Division, Floats, Scale, scale_of
from rtrun.analysis.tails.extreme_values import Bound
from rtrun.judgement.digest import Digest, JudgedDigest
from rtrun.judgement.groups import slowest
from rtrun.report.plots import axes
from rtrun.report.plots.axes import Axis
from rtrun.report.plots.drawing import Cells, Mark, Plot, make_mark
from rtrun.report.scenarios import Scenario, output_labels

_BINS = 240
_ROWS = 60
_COLOURS = 8  # of the page, 0 to 7; up to this many outputs are drawn separately
_EMPTY = 0.7  # place of an empty bin on the logarithmic axis of counts
_US = 1000.0
_STRETCHED = " The axis is even around the median, and logarithmic away from it."


def plots(scenario: Scenario, *, probability: float) -> list[Plot]:
    """Every plot of a scenario; none where it has no values."""
    group = scenario.group
    shown = [digest for digest in group.digests if digest.histogram.values_ns.size]
    if not shown:
        return []
    limit_ns = group.question.deadline_ns if group.question else None
    along = axes.times(scenario.measured, scale_of(merge(digest.histogram for digest in shown), limit_ns))
    charts = [_histograms(shown, along, limit_ns)]
    slow = [digest for digest in slowest(group.digests) if digest.histogram.values_ns.size]
    if slow:
        charts.append(_exceedance(scenario, shown, slow, along, limit_ns, probability))
    with_course = [digest for digest in shown if digest.course is not None and digest.figures.max_ns is not None]
    if with_course:
        worst = max(with_course, key=lambda digest: digest.figures.max_ns or 0)
        charts.append(
            _course(worst, along, limit_ns, name=output_labels(shown)[shown.index(worst)] if shown[1:] else "")
        )
    if len(shown) > 1:
        charts.append(_outputs(shown, scenario.measured))
    elif with_course:
        charts.append(_over_time(with_course[0], scenario.measured))
    return charts


def _limit(limit_ns: float | None, along: Axis, across: Axis, *, is_upright: bool) -> list[Mark]:
    """The line of the deadline; nothing without a deadline, and only its name where it is beyond the axis."""
    if limit_ns is None:
        return []
    scale = along.scale
    if not scale.low <= limit_ns <= scale.high:
        side = "beyond the right end" if is_upright else "above the top"
        return [make_mark("limit", f"deadline {time(limit_ns)}, {side}", [], [])]
    ends = [across.scale.low, across.scale.high]
    x, y = ([limit_ns] * 2, ends) if is_upright else (ends, [limit_ns] * 2)
    return [make_mark("limit", f"deadline {time(limit_ns)}", x, y)]


def _histograms(shown: Sequence[Digest], along: Axis, limit_ns: float | None) -> Plot:
    edges = along.scale.edges(_BINS, _US)
    named = [(label, digest.histogram) for label, digest in zip(output_labels(shown), shown, strict=True)]
    if len(named) > _COLOURS:
        named = [(f"all {len(shown)} outputs", merge(bins for _, bins in named))]
    marks = []
    for k, (name, bins) in enumerate(named):
        counts = np.append(_counted(bins, edges), 0.0)
        marks.append(make_mark("steps", name, edges, counts, k))
    top = max(float(mark.y.max()) for mark in marks)
    up = axes.many("count", _EMPTY, max(top, 1.0) * 1.2)
    return Plot(
        id="values",
        caption=f"How often each value occurred.{_STRETCHED if along.scale.division is Division.STRETCHED else ''}",
        x=along,
        y=up,
        marks=[*marks, *_limit(limit_ns, along, up, is_upright=True)],
    )


def _counted(bins: Histogram, edges: Floats) -> Floats:
    at = np.clip(np.searchsorted(edges, bins.values_ns, side="right") - 1, 0, edges.size - 2)
    return np.asarray(np.bincount(at, weights=bins.counts, minlength=edges.size - 1), dtype=np.float64)


def _exceedance(
    scenario: Scenario,
    shown: Sequence[Digest],
    slow: Sequence[Digest],
    along: Axis,
    limit_ns: float | None,
    probability: float,
) -> Plot:
    group = scenario.group
    together = "all" if len(slow) == len(group.digests) else "slowest subscriber of each run"
    marks = [_share_above(0, "measured" if len(shown) == 1 else together, slow)]
    if 1 < len(shown) < _COLOURS:
        labels = enumerate(zip(output_labels(shown), shown, strict=True), start=1)
        marks += [_share_above(k, label, [digest]) for k, (label, digest) in labels]
    floor = 0.5 / max(digest.n for digest in shown)
    if limit_ns is not None:
        floor = min(floor, probability)
    tails: list[Mark] = []
    for bound in group.bounds:
        if bound.refused is None and bound.method == "GPD" and bound.high_ns is not None:
            tails += _tail(bound, along.scale)
            floor = min(floor, bound.probability)
    up = axes.shares("share above", floor / 2)
    ends = [along.scale.low, along.scale.high]
    asked = _limit(limit_ns, along, up, is_upright=True)
    if asked:
        asked.append(make_mark("limit", f"P = {probability:g}, asked for", ends, [probability] * 2, 1))
    return Plot(
        id="shares",
        caption=f"Share of the values above each value{', with the fitted tail' if tails else ''}."
        f"{' What lies right of the deadline is late.' if asked else ''}"
        f"{' A value that never came counts as above all others.' if any(map(_absent, shown)) else ''}",
        x=along,
        y=up,
        marks=[*marks, *tails, *asked],
    )


def _share_above(k: int, name: str, series: Sequence[Digest]) -> Mark:
    bins = merge(digest.histogram for digest in series)
    total = bins.n + sum(map(_absent, series))
    above = total - np.cumsum(bins.counts)
    # No value is above the last one, which a logarithm cannot show: half a value stands for it.
    keep = _thin(np.log10(total / np.maximum(above, 0.5)), 200)
    x = np.concatenate(([bins.values_ns[0]], bins.values_ns[keep] + bins.bin_ns))
    return make_mark("steps", name, x, np.concatenate(([1.0], np.maximum(above[keep], 0.5) / total)), k)


def _absent(digest: Digest) -> int:
    return digest.header.missing + digest.header.not_fired + digest.header.skipped


def _thin(places: Any, most: int) -> Any:
    """Indices of ascending places, at most `most` plus the last, evenly along the axis."""
    span = float(places[-1] - places[0]) or 1.0
    cell = np.floor((places - places[0]) / span * most)
    keep = np.flatnonzero(np.diff(cell, prepend=-1.0))
    return keep if keep[-1] == len(places) - 1 else np.append(keep, len(places) - 1)


def _tail(bound: Bound, scale: Scale) -> list[Mark]:
    from rtrun.analysis.tails.fits import GPD

    assert bound.rate is not None and bound.shape is not None and bound.scale_ns is not None
    assert bound.high_ns is not None
    chances = np.geomspace(1.0, bound.probability / bound.rate, 40)
    base = float(bound.threshold_ns or 0)
    values = np.array([base + GPD.level(float(c), (bound.shape, bound.scale_ns)) for c in chances])
    inside = values <= scale.high
    name = f"bound {time(bound.high_ns)} at {bound.probability:g} ({100 * bound.confidence:g} %)"
    beyond = "" if bound.high_ns <= scale.high else ", beyond the right end"
    dot = ([], []) if beyond else ([bound.high_ns], [bound.probability])
    return [
        make_mark("line", "fitted tail (GPD), bursts count once", values[inside], (chances * bound.rate)[inside], 1),
        make_mark("dots", f"{name}{beyond}", *dot, 2),
    ]


def _course(digest: JudgedDigest, up: Axis, limit_ns: float | None, *, name: str) -> Plot:
    """The course of an output, called by its `name` if there are others."""
    course = digest.course
    assert course is not None
    along = axes.counts("loop", float(len(digest.header.startup)), float(course.end))
    # Loops whose values are missing leave a gap.
    gaps = np.flatnonzero(np.diff(course.loops) > course.width) + 1
    pieces = zip(*(np.split(column, gaps) for column in (course.loops, course.low_ns, course.high_ns)), strict=True)
    if course.width == 1:
        marks = [make_mark("line", "values", loops, highest) for loops, _, highest in pieces]
        caption = "Values over the loops"
    else:
        caption = f"Lowest to highest of each {grouped(course.width)} loops"
        marks = [
            make_mark(
                "area",
                caption[0].lower() + caption[1:],
                np.append(loops, min(loops[-1] + course.width, course.end)),
                np.append(highest, highest[-1]),
                low=np.append(lowest, lowest[-1]).astype(np.float64),
            )
            for loops, lowest, highest in pieces
        ]
    listed = [(e.index, e.value_ns) for e in digest.figures.top if e.index is not None]
    marks.append(
        make_mark("dots", f"{len(listed)} highest", [at for at, _ in listed], [value for _, value in listed], 1)
    )
    where = f" of {name}, where the highest value is" if name else ""
    return Plot(
        id="course",
        caption=f"{caption}{where}.",
        x=along,
        y=up,
        marks=[*marks, *_limit(limit_ns, up, along, is_upright=False)],
    )


def _over_time(digest: JudgedDigest, measured: str) -> Plot:
    """How the values were distributed from the first loop to the last."""
    course = digest.course
    assert course is not None
    skipped, columns = len(digest.header.startup), course.counts.shape[1]
    edges = np.minimum(skipped + np.arange(columns + 1) * course.columns_of, course.end).astype(np.float64)
    return Plot(
        id="over-time",
        caption="How often each value occurred while time went on.",
        x=axes.counts("loop", float(edges[0]), float(edges[-1])),
        y=axes.times(measured, course.scale),
        marks=[],
        cells=Cells(x_edges=edges, y_edges=course.edges_ns, counts=course.counts.astype(np.int64)),
    )


def _outputs(shown: Sequence[Digest], measured: str) -> Plot:
    """What figures 5.2 to 5.4 of the thesis show in three dimensions: value, count and run."""
    up = axes.times(measured, scale_of(merge(digest.histogram for digest in shown)))
    edges = up.scale.edges(_ROWS, _US)
    counts = np.array([_counted(digest.histogram, edges) for digest in shown]).T
    runs = len({digest.run for digest in shown})
    what = "run" if runs == len(shown) else "subscriber" if runs == 1 else "output"
    return Plot(
        id="outputs",
        caption=f"How often each value occurred in each {what}, first to last.",
        x=axes.counts(what, 0.5, len(shown) + 0.5),
        y=up,
        marks=[],
        cells=Cells(
            x_edges=np.arange(len(shown) + 1, dtype=np.float64) + 0.5,
            y_edges=edges,
            counts=counts.astype(np.int64),
        ),
    )
