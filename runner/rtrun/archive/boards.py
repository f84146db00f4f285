"""Boards, their kernels and middlewares on one page: the state of each, and the course of its slowest scenario."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from rtfiles.output import counted
from rtfiles.quantities import time
from rtfiles.untrusted import parse_json
from rtrun.archive.courses import ArchivedRun, Course
from rtrun.archive.states import TEXTS, CourseState
from rtrun.report.terminal import BANNERS
from rtrun.targets.inspection.platform import Platform

# A kernel is a past one if none of this many last boots of a course ran it.
_LATEST_BOOTS = 3
_PERCENTS = (99.9, 99.0, 50.0)
_POINTS_MAX = 60  # of a sparkline
_WIDTH, _HEIGHT = 200, 40  # of a sparkline, in units of its paths
_LEAST_SPAN = 0.25  # of its height, relative to its highest value: steady values look steady


@dataclass(frozen=True, kw_only=True, slots=True)
class BoardCell:
    """The scenarios of a board on a kernel through a middleware.

    `state` is the gravest state among them, "" where the kernel is a past one. `page` and the SVG paths belong to the
    leading scenario: the slowest among those with the gravest state. `path` shows its runs on the kernel, `whole` all
    its runs.
    """

    state: str
    style: str
    text: str
    figure: str
    page: str
    title: str
    path: str
    whole: str


@dataclass(frozen=True, kw_only=True, slots=True)
class BoardRow:
    """A board on a kernel: its last run there, its banner if it is not hardware, and its cells by middleware."""

    board: str
    kernel: str
    last_run: str
    banner: str
    cells: Mapping[str, BoardCell]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Part:
    """The part of a course that was measured on one kernel."""

    course: Course
    state: CourseState
    runs: Sequence[ArchivedRun]
    is_past: bool


def board_rows(courses: Sequence[tuple[Course, CourseState]]) -> list[BoardRow]:
    """A row for each board, platform and kernel: the gravest boards first, and for each board its last kernel first."""
    parts: dict[tuple[str, str, str], dict[str, list[_Part]]] = {}
    for course, state in courses:
        by_kernel: dict[str, list[ArchivedRun]] = {}
        for run in course.runs:
            by_kernel.setdefault(run.point.kernel or "unknown", []).append(run)
        latest = {run.point.kernel or "unknown" for boot in course.boots()[-_LATEST_BOOTS:] for run in boot}
        for kernel, runs in by_kernel.items():
            part = _Part(course=course, state=state, runs=runs, is_past=kernel not in latest)
            cells = parts.setdefault((course.machine, course.platform, kernel), {})
            cells.setdefault(_column(course), []).append(part)
    last = {key: max(_start(part.runs[-1]) for cell in cells.values() for part in cell) for key, cells in parts.items()}
    grave = {
        (board, platform): min(_gravity(part) for key, cells in parts.items() if key[:2] == (board, platform)
                               for cell in cells.values() for part in cell)
        for board, platform, _ in parts
    }  # fmt: skip

    def place(key: tuple[str, str, str]) -> tuple[object, ...]:
        return grave[key[:2]] > 0, *key[:2], -last[key].timestamp()

    return [
        BoardRow(
            board=board,
            kernel=kernel,
            last_run=f"{last[board, platform, kernel]:%Y-%m-%d}",
            banner=BANNERS.get(Platform(platform), "").partition(":")[0],
            cells={name: _cell(cell) for name, cell in parts[board, platform, kernel].items()},
        )
        for board, platform, kernel in sorted(parts, key=place)
    ]


def columns_of(rows: Sequence[BoardRow]) -> list[str]:
    """The middlewares of all rows, sorted by name."""
    return sorted({name for row in rows for name in row.cells})


def _column(course: Course) -> str:
    """The middleware; without one, as for another program's histogram, the program that measured."""
    parameters = parse_json(course.parameters, "parameters of an archived run")
    named = parameters.get("middleware") if isinstance(parameters, dict) else None
    return str(named or course.runs[0].point.suite.removesuffix("_tests"))


def _gravity(part: _Part) -> int:
    """0 is the gravest state; past kernels come last."""
    return len(TEXTS) if part.is_past else list(TEXTS).index(part.state.word)


def _cell(parts: Sequence[_Part]) -> BoardCell:
    leading = min(parts, key=lambda part: (_gravity(part), -_highest(part)))
    percent = _percent(leading)
    whole = _known(leading.course.runs, percent)
    values = _known(leading.runs, percent)
    figure = f"p{percent:g} {time(values[-1][1])}" if values else "no percentile known"
    scenarios = counted(len(parts), "scenario")
    if leading.is_past:
        state, style, text = "", "none", f"until {_start(leading.runs[-1]):%Y-%m-%d}, {scenarios}"
    else:
        state, style = leading.state.word, leading.state.style
        alike = sum(_gravity(part) == _gravity(leading) for part in parts)
        text = f"{leading.state.mark} {state}, {f'{alike} of ' if alike < len(parts) else ''}{scenarios}"
    return BoardCell(
        state=state,
        style=style,
        text=text,
        figure=figure,
        page=leading.course.page,
        title=f"{leading.course.scenario}: {counted(len(values), 'run')}, {figure}",
        path=_path(values, whole),
        whole=_path(whole, whole) if len(whole) > len(values) else "",
    )


def _percent(part: _Part) -> float:
    """The percentile to show: the highest that the state is about, or else that is known."""
    named = [p for p in _PERCENTS if f"p{p:g}" in part.state.figures and not part.is_past]
    known = [p for p in _PERCENTS if part.runs[-1].point.percentiles_ns[p] is not None]
    return next(iter([*named, *known]), _PERCENTS[0])


def _known(runs: Sequence[ArchivedRun], percent: float) -> list[tuple[float, int]]:
    """Start, in seconds, and percentile, in ns, of the runs where it is known."""
    values = [(_start(run).timestamp(), run.point.percentiles_ns[percent]) for run in runs]
    return [(moment, value) for moment, value in values if value is not None]


def _highest(part: _Part) -> float:
    point = part.runs[-1].point
    return float(max((value for value in point.percentiles_ns.values() if value is not None), default=0))


def _start(run: ArchivedRun) -> datetime:
    assert run.point.start_utc is not None  # a course has no runs without a time
    return run.point.start_utc


def _path(values: Sequence[tuple[float, int]], whole: Sequence[tuple[float, int]]) -> str:
    """Values over time on the scale of `whole`; many values are averaged over stretches. Empty for fewer than two."""
    if len(values) < 2:
        return ""
    moments, all_values = zip(*whole, strict=True)
    begin, end, low, high = moments[0], moments[-1], float(min(all_values)), float(max(all_values))
    if (lacking := _LEAST_SPAN * high - (high - low)) > 0:
        low, high = low - lacking / 2, high + lacking / 2
    points = np.array(values, np.float64)
    means = np.array([part.mean(axis=0) for part in np.array_split(points, min(len(points), _POINTS_MAX))])
    across = _WIDTH * (means[:, 0] - begin) / max(1.0, end - begin)
    up = _HEIGHT * (0.95 - 0.9 * (means[:, 1] - low) / max(1.0, high - low))
    return "M" + "L".join(f"{a:.0f} {b:.1f}" for a, b in zip(across, up, strict=True))
