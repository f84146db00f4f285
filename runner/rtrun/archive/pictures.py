"""The course of a scenario as plots of the report's kind."""

from collections.abc import Sequence
from typing import Any

from rtrun.archive.courses import Course
from rtrun.archive.trends import Trend
from rtrun.report.plots.charts import Plot, Trace, plain

_LINES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "p99.99": 99.99}


def course_plots(course: Course, trends: Sequence[Trend], *, deadline_ns: int) -> list[Plot]:
    """Percentiles and the highest value over time, the share of misses where there are any, a line for each change."""
    points = [run.point for run in course.runs]
    times = [f"{point.start_utc:%Y-%m-%d %H:%M:%S}" for point in points]
    named: dict[str, list[int | None]] = {
        name: [point.percentiles_ns[percent] for point in points] for name, percent in _LINES.items()
    }
    named["max"] = [point.max_ns for point in points]
    values = [
        _points(k, name, times, [None if value is None else value / 1000 for value in values_ns], "us")
        for k, (name, values_ns) in enumerate(named.items())
    ]
    of_values = [trend for trend in trends if trend.figure != "P(miss)"]
    of_misses = [trend for trend in trends if trend.figure == "P(miss)"]
    plots = [
        Plot(
            caption="Percentiles and the highest value of each run. A dashed line is a change.",
            data=values,
            layout=_layout("us", of_values),
        )
    ]
    if any(point.p_miss for point in points):
        plots.append(
            Plot(
                caption="The share of measurements that missed the deadline in each run.",
                data=[_points(1, f"P(> {deadline_ns / 1000:g} us)", times, [point.p_miss for point in points], "")],
                layout=_layout("share of misses", of_misses),
            )
        )
    return plots


def _points(colour: int, name: str, times: Sequence[str], values: Sequence[float | None], unit: str) -> Trace:
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "name": plain(name),
        "x": list(times),
        "y": list(values),
        "hovertemplate": f"{plain(name)} %{{y:.4g}} {unit}<br>%{{x}}<extra></extra>",
        "line": {"color": f"--series-{colour}", "width": 1.4},
        "marker": {"color": f"--series-{colour}", "size": 4},
    }


def _layout(title: str, trends: Sequence[Trend]) -> dict[str, Any]:
    return {
        "xaxis": {"type": "date"},
        "yaxis": {"title": {"text": title}, "rangemode": "tozero"},
        "shapes": [
            {
                "type": "line",
                "xref": "x",
                "yref": "paper",
                "x0": f"{trend.first_after:%Y-%m-%d %H:%M:%S}",
                "x1": f"{trend.first_after:%Y-%m-%d %H:%M:%S}",
                "y0": 0,
                "y1": 1,
                "line": {"color": "--refuted" if trend.is_worse else "--proven", "dash": "dash", "width": 1.5},
            }
            for trend in trends
            if trend.first_after is not None
        ],
    }
