"""The course of a scenario as plots of the report's kind."""

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from rtfiles.quantities import time
from rtrun.analysis.scale import Division, Floats, Scale
from rtrun.archive.courses import Course
from rtrun.archive.trends import Trend
from rtrun.plan.suites import in_words
from rtrun.report.plots import axes
from rtrun.report.plots.axes import Axis
from rtrun.report.plots.drawing import Mark, Plot, make_mark

_COLOURS = (0, 2, 3, 6, 1)  # of the lines, and of the highest value
_SPAN = 10.0  # ratio of the highest to the lowest value from which an axis is logarithmic
_LIMIT_SPAN = 5.0  # a deadline beyond this many times the highest value would dominate the plot


def course_plots(course: Course, trends: Sequence[Trend], *, deadline_ns: int | None) -> list[Plot]:
    """Percentiles and the highest value over time, the share of misses if there are any, a line for each change."""
    points = [run.point for run in course.runs]
    seconds = np.array([_seconds(point.start_utc) for point in points])
    along = axes.dates("start of the run, UTC", seconds.min(), seconds.max())
    values = {name: _numbers([point.times_ns[name] for point in points]) for name in points[0].times_ns}
    known = np.concatenate([numbers[np.isfinite(numbers)] for numbers in values.values()])
    plots = []
    if known.size:
        shows_limit = deadline_ns is not None and bool(deadline_ns <= _LIMIT_SPAN * known.max())
        title = in_words(points[0].suite, points[0].series)
        up = axes.times(title, _scale([*known, *([deadline_ns] if deadline_ns and shows_limit else [])]))
        marks = [_line(k, name, seconds, numbers) for k, (name, numbers) in zip(_COLOURS, values.items(), strict=True)]
        if deadline_ns is not None:
            name = f"deadline {time(deadline_ns)}{'' if shows_limit else ', above the top'}"
            limit = ([along.scale.low, along.scale.high], [deadline_ns] * 2) if shows_limit else ([], [])
            marks.append(make_mark("limit", name, *limit))
        plots.append(
            Plot(
                id="values",
                caption="Percentiles and the highest value of each run. A dotted line is a change.",
                x=along,
                y=up,
                marks=[*marks, *_changes([trend for trend in trends if trend.figure != "P(miss)"], up)],
            )
        )
    if deadline_ns is not None and any(point.p_miss for point in points):
        shares = _numbers([point.p_miss for point in points])
        up = axes.shares("share of misses", 0.0, division=Division.LINEAR, high=float(np.nanmax(shares)) * 1.1)
        plots.append(
            Plot(
                id="misses",
                caption="The share of measurements that missed the deadline in each run.",
                x=along,
                y=up,
                marks=[
                    _line(1, f"P(> {time(deadline_ns)})", seconds, shares),
                    *_changes([trend for trend in trends if trend.figure == "P(miss)"], up),
                ],
            )
        )
    return plots


def _seconds(moment: datetime | None) -> float:
    assert moment is not None  # a course has no runs without a time
    return moment.replace(tzinfo=UTC).timestamp()


def _numbers(values: Sequence[float | None]) -> Floats:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _scale(values: Sequence[float]) -> Scale:
    low, high = min(values), max(values)
    if low > 0 and high > _SPAN * low:
        return Scale(division=Division.LOG, low=low / 1.2, high=high * 1.2)
    # The axis includes zero; values of timers that fire early are all below it.
    low, high = min(0.0, low), max(0.0, high)
    return Scale(division=Division.LINEAR, low=low * 1.05, high=high * 1.05 if high else float(low == 0))


def _line(colour: int, name: str, x: Floats, y: Floats) -> Mark:
    known = np.isfinite(y)
    # A single point has no line.
    return make_mark("solid" if np.count_nonzero(known) > 1 else "dots", name, x[known], y[known], colour)


def _changes(trends: Sequence[Trend], up: Axis) -> list[Mark]:
    ends = [up.scale.low, up.scale.high]
    return [
        make_mark("limit", f"{trend.figure} {trend.word.lower()}", [_seconds(trend.first_after)] * 2, ends, 1)
        for trend in trends
        if trend.first_after is not None
    ]
