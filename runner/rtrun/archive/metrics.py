"""The last figures of every course as OpenMetrics text, and a dashboard of Grafana for them.

No line has a time stamp: Prometheus drops what is older than some minutes, and node_exporter refuses a file with one.
When a run was begun is a metric of its own.
"""

import json
from collections.abc import Iterator, Sequence
from datetime import UTC
from typing import Any

from rtfiles.output import printable
from rtrun.archive.courses import Course

_PERCENTILES = (50.0, 99.0, 99.9, 99.99)


def open_metrics(courses: Sequence[Course], *, deadline_ns: int) -> str:
    """The last run of every course in the text format of OpenMetrics 1.0; times in s, that of its start since 1970."""
    lines = [
        "# TYPE rtrun_value_seconds gauge",
        "# UNIT rtrun_value_seconds seconds",
        "# HELP rtrun_value_seconds Percentile of the values of the last run.",
        *(
            _line("rtrun_value_seconds", course, value, percentile=name)
            for course, name, value in _percentiles(courses)
        ),
        "# TYPE rtrun_highest_seconds gauge",
        "# UNIT rtrun_highest_seconds seconds",
        "# HELP rtrun_highest_seconds Highest value of the last run.",
    ]
    last = [(course, course.runs[-1].point) for course in courses]
    lines += [
        _line("rtrun_highest_seconds", course, point.max_ns / 1e9) for course, point in last if point.max_ns is not None
    ]
    lines += ["# TYPE rtrun_miss_ratio gauge", "# HELP rtrun_miss_ratio Share of the last run above the deadline."]
    lines += [
        _line("rtrun_miss_ratio", course, point.p_miss, deadline_seconds=f"{deadline_ns / 1e9:g}")
        for course, point in last
        if point.p_miss is not None
    ]
    lines += ["# TYPE rtrun_measurements gauge", "# HELP rtrun_measurements Measurements of the last run."]
    lines += [_line("rtrun_measurements", course, point.n) for course, point in last]
    lines += [
        "# TYPE rtrun_run_start_time_seconds gauge",
        "# UNIT rtrun_run_start_time_seconds seconds",
        "# HELP rtrun_run_start_time_seconds When the last run was begun, in seconds since 1970.",
        *(
            _line("rtrun_run_start_time_seconds", course, point.start_utc.replace(tzinfo=UTC).timestamp())
            for course, point in last
            if point.start_utc is not None
        ),
    ]
    return "\n".join([*lines, "# EOF"]) + "\n"


def _percentiles(courses: Sequence[Course]) -> Iterator[tuple[Course, str, float]]:
    for course in courses:
        for percent in _PERCENTILES:
            value_ns = course.runs[-1].point.percentiles_ns[percent]
            if value_ns is not None:
                yield course, f"{percent:g}", value_ns / 1e9


def _line(metric: str, course: Course, value: float, **labels: str) -> str:
    point = course.runs[-1].point
    labels = {
        "scenario": course.scenario,
        "machine": course.machine,
        "platform": course.platform,
        "kernel": point.kernel or "unknown",
        **labels,
    }
    words = ",".join(f'{name}="{_escaped(text)}"' for name, text in labels.items())
    return f"{metric}{{{words}}} {value:.10g}"


def _escaped(text: str) -> str:
    # The format allows every control character but the line's end. A terminal would obey them.
    return printable(text).replace("\\", "\\\\").replace('"', '\\"')


def grafana_dashboard() -> str:
    """A dashboard to import into Grafana, whose data source is chosen there: quantiles, highest values, misses."""
    queries = (
        ("Percentiles", 'rtrun_value_seconds{machine=~"$machine"}', "{{machine}} {{scenario}} p{{percentile}}", "s"),
        ("Highest value", 'rtrun_highest_seconds{machine=~"$machine"}', "{{machine}} {{scenario}}", "s"),
        ("Share of misses", 'rtrun_miss_ratio{machine=~"$machine"}', "{{machine}} {{scenario}}", "percentunit"),
        (
            "Time since the last run",
            'time() - rtrun_run_start_time_seconds{machine=~"$machine"}',
            "{{machine}} {{scenario}}",
            "s",
        ),
    )
    source = {"type": "prometheus", "uid": "${source}"}
    panels: list[dict[str, Any]] = [
        {
            "id": number,
            "type": "timeseries",
            "title": title,
            "datasource": source,
            "gridPos": {"x": 0, "y": 9 * (number - 1), "w": 24, "h": 9},
            "fieldConfig": {"defaults": {"unit": unit}, "overrides": []},
            "targets": [{"refId": "A", "datasource": source, "expr": query, "legendFormat": legend}],
        }
        for number, (title, query, legend, unit) in enumerate(queries, start=1)
    ]
    variables = [
        {"name": "source", "type": "datasource", "query": "prometheus"},
        {
            "name": "machine",
            "type": "query",
            "datasource": source,
            "query": "label_values(rtrun_value_seconds, machine)",
            "multi": True,
            "includeAll": True,
        },
    ]
    dashboard = {
        "title": "rtrun",
        "uid": "rtrun",
        "schemaVersion": 39,
        "time": {"from": "now-90d", "to": "now"},
        "templating": {"list": variables},
        "panels": panels,
    }
    return json.dumps(dashboard, indent=1) + "\n"
