"""The last figures of every course as OpenMetrics text, and a Grafana dashboard for them.

No line has a time stamp: Prometheus drops lines older than some minutes, and node_exporter refuses a file with time
stamps. The start of a run is a separate metric.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC
from typing import Any

from rtfiles.output import printable
from rtrun.archive.courses import Course
from rtrun.archive.fleet import BoardHealth, ScenarioHealth

_PERCENTILES = (50.0, 99.0, 99.9, 99.99)


def open_metrics(courses: Sequence[Course], boards: Sequence[BoardHealth], *, deadline_ns: int) -> str:
    """The last run of every course, and the state of each board, in the text format of OpenMetrics 1.0.

    Times are in s; start times are seconds since 1970.
    """
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
    return "\n".join([*(lines if courses else []), *_of_boards(boards), "# EOF"]) + "\n"


def _of_boards(boards: Sequence[BoardHealth]) -> Iterator[str]:
    """What is known about each board; what only a farm knows appears only for its places."""
    in_farm = [board for board in boards if board.in_farm]
    yield from _gauge(
        "rtrun_run_failed",
        "Whether the last run of a scenario failed.",
        [(_labels_of(each), bool(each.failures)) for board in boards for each in board.scenarios],
    )
    yield from _gauge(
        "rtrun_board_failed_scenarios",
        "How many scenarios of a board failed in their last run.",
        [({"machine": board.board}, len(board.failed)) for board in boards],
    )
    yield from _gauge(
        "rtrun_board_new",
        "Whether a board was measured on too few boots for changes to be seen.",
        [({"machine": board.board}, board.is_new) for board in boards],
    )
    yield from _gauge(
        "rtrun_board_offline",
        "Whether the exporter of a place ended.",
        [({"machine": board.board}, bool(board.offline)) for board in in_farm],
    )
    yield from _gauge(
        "rtrun_board_quarantined",
        "Whether a place is in quarantine.",
        [({"machine": board.board}, bool(board.quarantine)) for board in in_farm],
    )
    yield from _gauge(
        "rtrun_board_last_seen_time_seconds",
        "When the last run in which a board answered was begun, in seconds since 1970.",
        [
            ({"machine": board.board}, board.last_seen.replace(tzinfo=UTC).timestamp())
            for board in boards
            if board.last_seen
        ],
        unit="seconds",
    )


def _labels_of(scenario: ScenarioHealth) -> dict[str, str]:
    return {
        "scenario": scenario.last.scenario,
        "machine": scenario.last.machine,
        "platform": scenario.last.platform,
    }


def _gauge(
    name: str, what: str, samples: Sequence[tuple[Mapping[str, str], float]], unit: str | None = None
) -> Iterator[str]:
    """A metric with its samples; nothing without samples.

    Prometheus refuses a page in which two samples have the same labels. Names that differ only in a control character
    give equal labels; the highest such sample counts.
    """
    if samples:
        yield f"# TYPE {name} gauge"
        if unit:
            yield f"# UNIT {name} {unit}"
        yield f"# HELP {name} {what}"
    highest: dict[str, float] = {}
    for labels, value in samples:
        words = _words(labels)
        highest[words] = max(float(value), highest.get(words, float(value)))
    for words, value in highest.items():
        yield f"{name}{{{words}}} {value:.10g}"


def _words(labels: Mapping[str, str]) -> str:
    return ",".join(f'{name}="{_escaped(text)}"' for name, text in labels.items())


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
    return f"{metric}{{{_words(labels)}}} {value:.10g}"


def _escaped(text: str) -> str:
    # The format allows every control character except the line end. A terminal would obey them.
    return printable(text).replace("\\", "\\\\").replace('"', '\\"')


def grafana_dashboard() -> str:
    """A dashboard to import into Grafana, where the data source is chosen: quantiles, highest values, misses."""
    queries = (
        ("Percentiles", 'rtrun_value_seconds{machine=~"$machine"}', "{{machine}} {{scenario}} p{{percentile}}", "s"),
        ("Highest value", 'rtrun_highest_seconds{machine=~"$machine"}', "{{machine}} {{scenario}}", "s"),
        ("Share of misses", 'rtrun_miss_ratio{machine=~"$machine"}', "{{machine}} {{scenario}}", "percentunit"),
        (
            "Scenarios that failed in their last run",
            'rtrun_board_failed_scenarios{machine=~"$machine"}',
            "{{machine}}",
            "none",
        ),
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
