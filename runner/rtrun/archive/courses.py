"""The runs of one series of a scenario on one board, sorted by time, with their figures and circumstances."""

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

import numpy as np

from rtfiles.errors import UsageError
from rtfiles.quantities import time
from rtfiles.untrusted import parse_json
from rtrun.analysis.order.change_points import Floats, means_of_units
from rtrun.archive.notes import AcceptNote, KnownNote
from rtrun.archive.queries import Point, figures
from rtrun.archive.runs import Archive, RunRow
from rtrun.kinds.lateness import Measure

Figure = Literal["p50", "p99", "p99.9", "P(miss)"]
"""The figures compared with history: those that a single late value does not decide."""

PERCENTS: dict[Figure, float] = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
# A percentile needs this many values beyond it in a run.
_BEYOND = 20
_TEXTS = ("kernel_release", "kernel_version", "commit", "image", "middleware_version", "governor", "clock_source")
_NUMBERS = ("temperature_max_mc", "frequency_max_khz", "load_1min_max")


@dataclass(frozen=True, kw_only=True, slots=True)
class ArchivedRun:
    """A run: its figures (`point`), its boot, and what else is known about it.

    `facts` are texts that can change (kernel, commit, package versions ...), `readings` are numbers that vary.
    """

    point: Point
    boot: str
    facts: Mapping[str, str]
    readings: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Course:
    """Runs of one scenario on one board and platform, first to last, at least one, with any kernel.

    `off_rate` counts further runs, left out because their publisher missed the requested rate. `accepted` is the last
    note that accepted the level; `known` are the notes that call a problem known.
    """

    runs: tuple[ArchivedRun, ...]
    off_rate: int = 0
    accepted: AcceptNote | None = None
    known: tuple[KnownNote, ...] = ()

    @property
    def identity(self) -> tuple[str, str, str, str, str]:
        """What the runs of a course have in common."""
        return _identity(self.runs[0])

    @property
    def scenario(self) -> str:
        """What was measured, in a few words."""
        return self.runs[-1].point.scenario

    @property
    def parameters(self) -> str:
        """What was measured, as JSON."""
        return self.runs[0].point.parameters

    @property
    def platform(self) -> str:
        """hardware, virtual or emulated."""
        return self.runs[0].point.platform

    @property
    def machine(self) -> str:
        """The name of the board."""
        return self.runs[0].point.machine

    @property
    def label(self) -> str:
        """Scenario and board in a few words."""
        return f"{self.scenario} on {self.machine}"

    @property
    def page(self) -> str:
        """The name of its page on a site."""
        return f"{hashlib.sha256(repr(self.identity).encode()).hexdigest()[:16]}.html"

    def knowing(self, figure: Figure) -> "Course | None":
        """The course with only the runs that know the figure from enough values; None where none do."""
        runs = tuple(run for run in self.runs if _knows(run.point, figure))
        return replace(self, runs=runs) if runs else None

    def boots(self) -> tuple[tuple[ArchivedRun, ...], ...]:
        """The runs of each boot, first to last."""
        members: dict[str, list[ArchivedRun]] = {}
        for run in self.runs:
            members.setdefault(run.boot, []).append(run)
        return tuple(tuple(runs) for runs in members.values())

    def values(self, figure: Figure) -> Floats:
        """The figure of each boot, shape (u,): the mean over its runs, in ns; for P(miss) the share of all misses.

        Every run must know it.
        """
        if figure == "P(miss)":
            return np.array([misses / n for n, misses in self.misses()])
        percent = PERCENTS[figure]
        values = np.array([float(run.point.percentiles_ns[percent] or 0) for run in self.runs])
        return means_of_units(values, [run.boot for run in self.runs])

    def misses(self) -> list[tuple[int, int]]:
        """(measurements, misses) of each boot."""
        return [(sum(run.point.n for run in boot), sum(run.point.misses or 0 for run in boot)) for boot in self.boots()]


def courses(archive: Archive, *, deadline_ns: int | None, measure: Measure | None = None) -> list[Course]:
    """Every course of an archive. Runs without a time are left out, as they have no place in a course."""
    points = {point.run_keys[0]: point for point in figures(archive, "run", deadline_ns=deadline_ns, measure=measure)}
    runs = [
        _run(points[row.run_key], row, archive.store.address)
        for row in archive.runs
        if row.run_key in points and row.start_utc is not None
    ]
    runs.sort(key=lambda run: (*_identity(run), run.point.start_utc, run.point.label))
    missed = Counter((row.suite, row.parameters, row.platform, row.machine) for row in archive.runs if row.off_rate)
    found = []
    for (suite, _, parameters, platform, machine), members in groupby(runs, _identity):
        course = Course(runs=tuple(members), off_rate=missed[suite, parameters, platform, machine])
        notes, scenario = archive.notes, course.scenario
        known = tuple(notes.known(machine, scenario))
        found.append(replace(course, accepted=notes.accepted(machine, scenario), known=known))
    return found


def _knows(point: Point, figure: Figure) -> bool:
    if figure == "P(miss)":
        return point.misses is not None and point.n > 0
    percent = PERCENTS[figure]
    return point.percentiles_ns[percent] is not None and point.n >= round(100 * _BEYOND / (100 - percent))


def _identity(run: ArchivedRun) -> tuple[str, str, str, str, str]:
    point = run.point
    return point.suite, point.series, point.parameters, point.platform, point.machine


def _run(point: Point, row: RunRow, origin: str) -> ArchivedRun:
    packages = parse_json(row.packages, f"{origin}: run {row.run_key}: packages")
    if not isinstance(packages, dict):
        raise UsageError(f"{origin}: run {row.run_key}: packages: expected versions by name")
    facts = {name.removesuffix("_release"): text for name in _TEXTS if (text := getattr(row, name)) is not None}
    return ArchivedRun(
        point=point,
        boot=row.boot,
        facts=facts | {f"package {name}": str(version) for name, version in packages.items()},
        readings={name: number for name in _NUMBERS if (number := getattr(row, name)) is not None},
    )


def figure_text(figure: Figure, value: float) -> str:
    """A figure for people; times are in ns."""
    return f"{value:.2g}" if figure == "P(miss)" else time(value)


def facts_of(runs: Iterable[ArchivedRun], name: str) -> list[str]:
    """The different values of a fact in these runs."""
    return list(dict.fromkeys(run.facts[name] for run in runs if name in run.facts))


def readings_of(boots: Sequence[Sequence[ArchivedRun]], name: str) -> Floats:
    """The mean of a reading in each boot that has it."""
    means = [[run.readings[name] for run in boot if name in run.readings] for boot in boots]
    return np.array([sum(values) / len(values) for values in means if values])
