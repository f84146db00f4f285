"""Answers from an archive: figures of several runs together, from their histograms.

A percentile is the lower edge of the bin that holds the value of its rank (nearest rank, as in every report). So it is
the report's figure, rounded down to a step of the clock.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import datetime
from functools import cache

from rtfiles.errors import UsageError
from rtrun.archive import By
from rtrun.archive.bins import BinReader, Bins, figures_of_bins, merged
from rtrun.archive.runs import Archive, RunRow
from rtrun.archive.store import Store
from rtrun.kinds.known import called
from rtrun.kinds.lateness import Measure, judged
from rtrun.kinds.limits import BINS_MAX
from rtrun.plan.suites import measures

# How many histogram rows are held at a time, each up to 150 bytes. A run has some ten thousand.
ROWS_MAX = 2 * BINS_MAX  #: rows of an archive's histograms in memory
SHOWN = (50.0, 99.0, 99.9, 99.99)
"""The percentiles that tables and plots show."""
_LARGE = 4096  # rows per group
_LATEST = datetime.max  # sorts runs without a time last
_LABELS: dict[By, Callable[[RunRow], str]] = {
    "day": lambda row: _moment(row, "%Y-%m-%d"),
    "month": lambda row: _moment(row, "%Y-%m"),
    "kernel": lambda row: row.kernel_release or "unknown",
    "board": lambda row: row.machine,
    "commit": lambda row: row.commit or "unknown",
    "image": lambda row: row.image or "unknown",
    "run": lambda row: f"{_moment(row, '%Y-%m-%d %H:%M:%S')} {row.run}" if row.start_utc else row.run,
}
# The order of points: by time, and for boards and kernels side by side.
_ORDERS: dict[By, Callable[["_Group"], tuple[object, ...]]] = {
    "kernel": lambda group: (group.label, group.row.machine, group.start),
    "board": lambda group: (group.row.machine, group.start),
}


def _moment(row: RunRow, form: str) -> str:
    return row.start_utc.strftime(form) if row.start_utc else "unknown"


@dataclass(frozen=True, kw_only=True, slots=True)
class Point:
    """Runs of one scenario on one board and kernel together, for one of their series.

    `scenario` names the series unless it is the usual one. `run_keys` are their names in the archive; `off_rate` counts
    further runs, left out because they missed the requested rate. `n` counts the requested values without the start-up;
    `misses` are late or never came, None without a deadline and where a histogram does not reach up to it. `unclear` of
    them lie in the bin of the deadline and may have met it. A percentile or the highest value is None where it falls
    among values that are only counted.
    """

    scenario: str
    series: str
    parameters: str
    suite: str
    machine: str
    platform: str
    kernel: str | None
    label: str
    start_utc: datetime | None
    run_keys: tuple[str, ...]
    off_rate: int
    boots: int
    n: int
    misses: int | None
    unclear: int
    percentiles_ns: dict[float, int | None]
    max_ns: int | None

    @property
    def times_ns(self) -> dict[str, int | None]:
        """What tables and plots show of it, by its word."""
        return {**{f"p{percent:g}": self.percentiles_ns[percent] for percent in SHOWN}, "max": self.max_ns}

    @property
    def p_miss(self) -> float | None:
        """The share of the measurements that missed the deadline."""
        return None if self.misses is None or not self.n else self.misses / self.n


@dataclass(frozen=True, kw_only=True, slots=True)
class _Group:
    """Runs that belong to one point for each of their series.

    They are the ok runs, sorted by time, and how many missed their rate.
    """

    label: str
    runs: Sequence[RunRow]
    off_rate: int

    @property
    def row(self) -> RunRow:
        return self.runs[0]

    @property
    def start(self) -> datetime:
        return self.row.start_utc or _LATEST


def figures(archive: Archive, by: By, *, deadline_ns: int | None, measure: Measure | None = None) -> list[Point]:
    """The figures of every point, scenario by scenario; runs that are not ok are left out.

    `measure` says which values have the deadline; None: the first measure of each suite, where a run has it. Runs with
    other known values are in other points, or in none. Raises UsageError, InfrastructureError.
    """
    groups = _groups(archive.runs, by)
    reader = BinReader(archive.store)
    held = [sum(archive.histograms[row.run_key].number for row in _known(archive, group)) for group in groups]
    number = _threads(archive.store, held)
    with ThreadPoolExecutor(number) as threads:
        # Handing such small work to a single thread takes as long as computing it.
        apply = threads.map if number > 1 else map
        of_groups = apply(lambda group: list(_points(archive, reader, group, deadline_ns, measure)), groups)
        points = [point for of_group in of_groups for point in of_group]
    return sorted(points, key=lambda point: (point.scenario, point.parameters, point.platform))


def _threads(store: Store, held: Sequence[int]) -> int:
    """How many threads read and compute groups of these sizes; together they hold at most ROWS_MAX rows.

    More than one thread is faster where files are waited for, or where groups are large: numpy releases Python's lock
    only for long arrays.
    """
    if store.is_local and sum(held) < _LARGE * len(held):
        return 1
    largest = min(max([1, *held]), ROWS_MAX)
    return min(os.cpu_count() or 1, ROWS_MAX // largest)


def _groups(runs: Sequence[RunRow], by: By) -> list[_Group]:
    """The runs that are shown together, in display order."""
    members: dict[tuple[object, ...], list[RunRow]] = {}
    label = _LABELS[by]
    for row in runs:
        if row.status == "ok" or row.off_rate:
            kernel = (row.kernel_release, row.kernel_version)
            key = (row.scenario, row.parameters, row.suite, row.machine, row.platform, *kernel, label(row))
            members.setdefault(key, []).append(row)
    groups = []
    for (*_, name), rows in members.items():
        counted = sorted((row for row in rows if row.status == "ok"), key=_when)
        if counted:
            groups.append(_Group(label=str(name), runs=counted, off_rate=sum(row.off_rate for row in rows)))

    def place(group: _Group) -> tuple[object, ...]:
        row = group.row
        order = _ORDERS[by](group) if by in _ORDERS else (row.machine, group.start)
        return row.scenario, row.parameters, row.platform, *order, group.label, row.kernel_version or ""

    return sorted(groups, key=place)


def _when(row: RunRow) -> tuple[datetime, str]:
    return row.start_utc or _LATEST, row.run_key


def _known(archive: Archive, group: _Group) -> Iterator[RunRow]:
    """The runs of a group whose histograms are in the archive."""
    return (row for row in group.runs if row.run_key in archive.histograms)


def _points(
    archive: Archive, reader: BinReader, group: _Group, deadline_ns: int | None, measure: Measure | None
) -> Iterator[Point]:
    of_series: dict[str, list[RunRow]] = {}
    bins: dict[str, list[Bins]] = {}
    held = 0
    for row in _known(archive, group):
        place = archive.histograms[row.run_key]
        if held + place.number > ROWS_MAX:
            bins = {series: [merged(pieces)] for series, pieces in bins.items()}
            held = sum(pieces[0][0].size for pieces in bins.values())
        if held + place.number > ROWS_MAX:
            what = f"{row.scenario} on {row.machine}: the histograms of {len(group.runs)} runs"
            raise UsageError(
                f"{archive.store.address}: {what} have {held} different bins before {place.number} more are added, at "
                f"most {ROWS_MAX} are held: ask for fewer runs together (--by month, day or run)"
            )
        read = reader.read(place)
        if (series := _series_of(row.suite, tuple(read), measure)) is not None:
            of_series.setdefault(series, []).append(row)
            bins.setdefault(series, []).append(read[series])
            held += read[series][0].size
    for series, runs in of_series.items():
        yield _point(group, series, runs, bins[series], deadline_ns)


@cache
def _series_of(suite: str, names: tuple[str, ...], asked: Measure | None) -> str | None:
    """Which of these series of a run the question is about; None if it is about none."""
    known = {called(name): name for name in names}
    wanted = measures(suite)
    try:
        wanted = wanted if asked is None else (judged(wanted, asked),)
    except UsageError:
        return None
    return next((known[measure] for measure in wanted if measure in known), None)


def _point(group: _Group, series: str, runs: Sequence[RunRow], bins: Sequence[Bins], deadline_ns: int | None) -> Point:
    row, measure = runs[0], called(series)
    is_usual = measure is None or measure == measures(row.suite)[0]
    return Point(
        scenario=row.scenario if is_usual else f"{row.scenario}, {measure}",
        series=series,
        parameters=row.parameters,
        suite=row.suite,
        machine=row.machine,
        platform=row.platform,
        kernel=row.kernel_release,
        label=group.label,
        start_utc=row.start_utc,
        run_keys=tuple(run.run_key for run in runs),
        off_rate=group.off_rate,
        boots=len({run.boot for run in runs}),
        **figures_of_bins(bins, deadline_ns),
    )
