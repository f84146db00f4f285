"""The last figures of every course as OpenMetrics text, and a Grafana dashboard for them.

No line has a time stamp: Prometheus drops lines older than some minutes, and node_exporter refuses a file with time
stamps. The start of a run is a separate metric.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from rtfiles.output import printable
from rtrun.archive.courses import Course
from rtrun.archive.fleet import BoardHealth

_HELP = {
    "rtrun_value_seconds": "Percentile of the values of the last run.",
    "rtrun_highest_seconds": "Highest value of the last run.",
    "rtrun_miss_ratio": "Share of the last run above the deadline.",
    "rtrun_measurements": "Measurements of the last run.",
    "rtrun_run_start_time_seconds": "When the last run was begun, in seconds since 1970.",
    "rtrun_run_failed": "Whether the last run of a scenario failed.",
    "rtrun_board_failed_scenarios": "How many scenarios of a board failed in their last run.",
    "rtrun_board_new": "Whether a board was measured on too few boots for changes to be seen.",
    "rtrun_board_offline": "Whether the exporter of a place ended.",
    "rtrun_board_quarantined": "Whether a place is in quarantine.",
    "rtrun_board_last_seen_time_seconds": (
        "When the last run in which a board answered was begun, in seconds since 1970."
    ),
}
_Sample = tuple[str, Mapping[str, str], float]
"""A metric, its labels and its value."""


def open_metrics(courses: Sequence[Course], boards: Sequence[BoardHealth], *, deadline_ns: int | None) -> str:
    """The last run of every course and the state of each board, in the text format of OpenMetrics 1.0.

    Times are in s; start times are seconds since 1970. Prometheus refuses a page in which two samples have the same
    labels. Names that differ only in a control character give equal labels; the highest such sample counts.
    """
    samples: dict[str, dict[str, float]] = {name: {} for name in _HELP}
    for name, labels, value in (*_of_courses(courses, deadline_ns), *_of_boards(boards)):
        words = ",".join(f'{label}="{_escaped(text)}"' for label, text in labels.items())
        samples[name][words] = max(float(value), samples[name].get(words, float(value)))
    lines = []
    for name, values in samples.items():
        if values:
            unit = [f"# UNIT {name} seconds"] * name.endswith("_seconds")
            lines += [f"# TYPE {name} gauge", *unit, f"# HELP {name} {_HELP[name]}"]
            lines += [f"{name}{{{words}}} {value:.10g}" for words, value in values.items()]
    return "\n".join([*lines, "# EOF"]) + "\n"


def _of_courses(courses: Sequence[Course], deadline_ns: int | None) -> Iterator[_Sample]:
    for course in courses:
        point = course.runs[-1].point
        labels = {name: getattr(course, name) for name in ("scenario", "machine", "platform")}
        labels["kernel"] = point.kernel or "unknown"
        for name, value_ns in point.times_ns.items():
            if value_ns is not None and name != "max":
                yield "rtrun_value_seconds", {**labels, "percentile": name.removeprefix("p")}, value_ns / 1e9
        if point.max_ns is not None:
            yield "rtrun_highest_seconds", labels, point.max_ns / 1e9
        if deadline_ns is not None and point.p_miss is not None:
            yield "rtrun_miss_ratio", {**labels, "deadline_seconds": f"{deadline_ns / 1e9:g}"}, point.p_miss
        yield "rtrun_measurements", labels, point.n
        if point.start_utc is not None:
            yield "rtrun_run_start_time_seconds", labels, _seconds(point.start_utc)


def _of_boards(boards: Sequence[BoardHealth]) -> Iterator[_Sample]:
    """What is known about each board; what only a farm knows appears only for its places."""
    for board in boards:
        labels = {"machine": board.board}
        for scenario in board.scenarios:
            of_scenario = {name: getattr(scenario.last, name) for name in ("scenario", "machine", "platform")}
            yield "rtrun_run_failed", of_scenario, bool(scenario.failures)
        yield "rtrun_board_failed_scenarios", labels, len(board.failed)
        yield "rtrun_board_new", labels, board.is_new
        if board.in_farm:
            yield "rtrun_board_offline", labels, bool(board.offline)
            yield "rtrun_board_quarantined", labels, bool(board.quarantine)
        if board.last_seen:
            yield "rtrun_board_last_seen_time_seconds", labels, _seconds(board.last_seen)


def _seconds(moment: datetime) -> float:
    return moment.replace(tzinfo=UTC).timestamp()


def _escaped(text: str) -> str:
    # The format allows every control character except the line end. A terminal would obey them.
    return printable(text).replace("\\", "\\\\").replace('"', '\\"')


def grafana_dashboard() -> str:
    """A dashboard to import into Grafana, where the data source is chosen: quantiles, highest values, misses."""
    per_scenario, per_board = "{{machine}} {{scenario}}", "{{machine}}"
    queries = (
        ("Percentiles", "rtrun_value_seconds", f"{per_scenario} p{{{{percentile}}}}", "s"),
        ("Highest value", "rtrun_highest_seconds", per_scenario, "s"),
        ("Share of misses", "rtrun_miss_ratio", per_scenario, "percentunit"),
        ("Scenarios that failed in their last run", "rtrun_board_failed_scenarios", per_board, "none"),
        ("Time since the last run", "time() - rtrun_run_start_time_seconds", per_scenario, "s"),
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
            "targets": [
                {"refId": "A", "datasource": source, "expr": f'{query}{{machine=~"$machine"}}', "legendFormat": legend}
            ],
        }
        for number, (title, query, legend, unit) in enumerate(queries, start=1)
    ]
    variables = [
        {"name": "source", "type": "datasource", "query": "prometheus"},
        {
            "name": "machine",
            "type": "query",
            "datasource": source,
            "query": "label_values(rtrun_board_failed_scenarios, machine)",
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
