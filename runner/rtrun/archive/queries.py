"""What an archive answers: figures of runs together, from their histograms. DuckDB says which runs belong together.

A percentile is the lower edge of the bin that holds the value of its rank (nearest rank, as in every report). So it is
the report's figure, rounded down to a step of the clock.
"""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.analysis.figures import PERCENTILES
from rtrun.analysis.histogram import Int64s
from rtrun.archive import By
from rtrun.archive.store import Store, find_files
from rtrun.kinds.known import called
from rtrun.plan.limits import BINS_MAX, TIME_MAX_NS
from rtrun.plan.question import Measure
from rtrun.plan.suites import judged, measures
from rtrun.targets.inspection.platform import Platform

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection
    from pyarrow.parquet import FileMetaData, ParquetFile

_Bins = tuple[Int64s, Int64s, Int64s]
_Run = tuple[str, str, datetime | None]  # key, boot, start
_NONE = -(2**63)  # stands for null
_GRID_MAX = 4  # places of a grid for each bin on it
_COUNT_MAX = 2**53  # of all bins: above, a double no longer counts one by one
# Rows of histograms that are held at one time, which takes up to 150 bytes each. A run has some ten thousand.
ROWS_MAX = 2 * BINS_MAX
_MEMORY = "1GB"  # for the table of runs: a row of a run takes some KB
# Whoever may write a file of the archive may write anything into it: every value is given its type of docs/archive.md.
_TEXTS = ("run_key", "run", "scenario", "parameters", "platform", "status", "packages", "machine", "suite", "month")
_OPTIONAL_TEXTS = (
    *("reason", "boot_id", "kernel_release", "kernel_version", "commit", "image", "middleware_version", "governor"),
    "clock_source",
)
_NUMBERS = {"temperature_max_mc": "BIGINT", "frequency_max_khz": "BIGINT", "load_1min_max": "DOUBLE"}
_LABELS: dict[By, str] = {
    "day": "coalesce(strftime(start_utc, '%Y-%m-%d'), 'unknown')",
    "month": "month",
    "kernel": "coalesce(kernel_release, 'unknown')",
    "board": "machine",
    "commit": "coalesce(commit, 'unknown')",
    "image": "coalesce(image, 'unknown')",
    "run": "coalesce(strftime(start_utc, '%Y-%m-%d %H:%M:%S '), '') || run",
}
# Which points follow one another: by time, and for boards and kernels side by side.
_ORDERS: dict[By, str] = {"kernel": "label, machine, start_utc", "board": "machine, start_utc"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Point:
    """Runs of one scenario on one board and kernel together, by one series of theirs; the scenario names it where
    another one is usual.

    `run_keys` are their names in the archive; `off_rate` counts others, which are left out because they missed the rate
    that was asked for. `n` counts what was asked for but for the start-up; `misses` are late or never came, None where
    a histogram does not reach to the deadline. `unclear` of them lie in the bin of the deadline and may have met it. A
    percentile or the highest value is None where it is among values known by number only.
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
    def p_miss(self) -> float | None:
        """The share of the measurements that missed the deadline."""
        return None if self.misses is None or not self.n else self.misses / self.n


@dataclass(frozen=True, kw_only=True, slots=True)
class Archive:
    """An archive that is open for questions.

    `connection` is DuckDB with the table of runs as `runs`; `histograms` are the paths of the histograms by the name of
    their run.
    """

    store: Store
    connection: "DuckDBPyConnection"
    histograms: Mapping[str, str]


@contextmanager
def connected(store: Store) -> Iterator[Archive]:
    """An archive, open for questions.

    Raises UsageError when it has no runs or a file is damaged, InfrastructureError when it cannot be read.
    """
    import duckdb

    if not find_files(store, "runs"):
        raise UsageError(f"{store.address}: there are no runs in this archive")
    # What does not fit into memory is an error: it is not written into a folder.
    connection = duckdb.connect(
        config={"autoinstall_known_extensions": False, "memory_limit": _MEMORY, "temp_directory": ""}
    )
    try:
        if not store.is_local:
            connection.register_filesystem(store.file_system)
        files = store.url("runs/**/*.parquet").replace("'", "''")
        if wrong := connection.execute(_NOT_ONE_ROW.format(files=files)).fetchone():
            raise _damaged(store, f"{wrong[0]}: has {wrong[1]} rows, the file of a run has one")
        connection.execute(_runs_view(files))
        histograms = {
            path.rpartition("/")[2].removesuffix(".parquet"): path for path in find_files(store, "histograms")
        }
        yield Archive(store=store, connection=connection, histograms=histograms)
    except duckdb.Error as error:
        text, *others = str(error).splitlines()
        if text.startswith("Traceback"):  # of fsspec: the first line that is not indented names what was raised
            raised = next((line for line in others if line and not line.startswith(" ")), text)
            raise _unreadable(store, raised.partition(": ")[2] or raised) from error
        raise _damaged(store, text) from error
    finally:
        connection.close()


def _runs_view(files: str) -> str:
    """The statement that makes the table of runs, with each value of its type: a value of another one is an error."""

    def valid(column: str, kind: str, condition: str, wrong: str) -> str:
        value = f"CAST({column} AS {kind})"
        return f"CASE WHEN {condition.format(value)} THEN error('{column}: {wrong}') ELSE {value} END AS {column}"

    columns = [
        *(valid(column, "VARCHAR", "{} IS NULL", "missing") for column in _TEXTS),
        *(f"CAST({column} AS VARCHAR) AS {column}" for column in _OPTIONAL_TEXTS),
        *(valid(column, kind, "NOT isfinite(CAST({} AS DOUBLE))", "no number") for column, kind in _NUMBERS.items()),
        valid("off_rate", "BOOLEAN", "{} IS NULL", "missing"),
        valid("start_utc", "TIMESTAMP", "NOT {} BETWEEN TIMESTAMP '1900-01-01' AND TIMESTAMP '3000-01-01'", "no time"),
    ]
    source = f"read_parquet('{files}', hive_partitioning = true, hive_types_autocast = false)"
    return f"CREATE VIEW runs AS SELECT {', '.join(columns)} FROM {source}"


def _unreadable(store: Store, reason: str) -> InfrastructureError:
    return InfrastructureError(f"{store.address}: cannot be read: {reason}")


def _damaged(store: Store, what: str) -> UsageError:
    return UsageError(f"{store.address}: {what}; rtrun archive add writes a file anew that is not whole")


def figures(archive: Archive, by: By, *, deadline_ns: int, of: Measure | None = None) -> list[Point]:
    """The figures of every point, scenario by scenario; runs that are not ok are in none.

    `of` are the values that have the deadline, None: what each suite measures first, where a run has it. Runs of which
    other values are known are in other points, or in none.
    """
    query = _POINTS.format(label=_LABELS[by], order=_ORDERS.get(by, "machine, start_utc"))
    cursor = archive.connection.execute(query)
    names = [column[0] for column in cursor.description or ()]
    rows = [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]
    if unknown := {row["platform"] for row in rows} - {*Platform}:
        raise _damaged(archive.store, f"platform: {min(unknown)[:40]!r}, expected one of {', '.join(Platform)}")

    # The number of rows stands at the end of a file: what is too much is refused before it is read.
    members = [[(run, path) for run in _runs_of(row) if (path := archive.histograms.get(run[0]))] for row in rows]
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        paths = [path for of_row in members for _, path in of_row]
        footers = dict(zip(paths, threads.map(partial(_footer, archive.store), paths), strict=True))
    largest = max((sum(footers[path].num_rows for _, path in of_row) for of_row in members), default=0)

    def points(row: dict[str, Any], runs: Sequence[tuple[_Run, str]]) -> list[Point]:
        of_series: dict[str, list[_Run]] = {}
        bins: dict[str, list[_Bins]] = {}
        held = 0
        for run, path in runs:
            more = footers[path].num_rows
            if held + more > ROWS_MAX:
                bins = {series: [_merged(each)] for series, each in bins.items()}
                held = sum(each[0][0].size for each in bins.values())
            if held + more > ROWS_MAX:
                what = f"{row['scenario']} on {row['machine']}: the histograms of {len(runs)} runs"
                raise UsageError(
                    f"{archive.store.address}: {what} have {held} different bins before {more} more are added, at most "
                    f"{ROWS_MAX} are held: ask for fewer runs together (--by month, day or run)"
                )
            read = _read_bins(archive.store, path, footers[path])
            if (series := _series_of(row["suite"], read, of)) is not None:
                of_series.setdefault(series, []).append(run)
                bins.setdefault(series, []).append(read[series])
                held += read[series][0].size
        return [_point(row, series, of_series[series], bins[series], deadline_ns) for series in bins]

    # Reading and sorting leave Python's lock to others.
    with ThreadPoolExecutor(min(os.cpu_count() or 1, ROWS_MAX // min(max(1, largest), ROWS_MAX))) as threads:
        made = [point for of_row in threads.map(points, rows, members) for point in of_row]
    return sorted(made, key=lambda point: (point.scenario, point.parameters, point.platform))


def _runs_of(row: dict[str, Any]) -> list[_Run]:
    """Key, boot and start of each run of a row of _POINTS, which are taken out of it."""
    return list(zip(*(row.pop(name) for name in ("run_keys", "boot_ids", "starts")), strict=True))


def _series_of(suite: str, names: Iterable[str], of: Measure | None) -> str | None:
    """Which of these series of a run the question is of; None for none."""
    known = {called(name): name for name in names}
    wanted = measures(suite)
    try:
        wanted = wanted if of is None else (judged(wanted, of),)
    except UsageError:
        return None
    return next((known[measure] for measure in wanted if measure in known), None)


def _point(row: Mapping[str, Any], series: str, runs: Sequence[_Run], bins: Sequence[_Bins], deadline_ns: int) -> Point:
    keys, boots, starts = zip(*runs, strict=True)
    measure = called(series)
    words = {"series": series, "start_utc": min((start for start in starts if start), default=None)}
    if measure is not None and measure != measures(row["suite"])[0]:
        words["scenario"] = f"{row['scenario']}, {measure}"
    return Point(**{**row, **words}, run_keys=keys, boots=len(set(boots)), **_figures_of(bins, deadline_ns))


@contextmanager
def _opened(store: Store, path: str, footer: "FileMetaData | None" = None) -> "Iterator[ParquetFile]":
    """A histogram's file. Raises UsageError where what is in it is wrong, InfrastructureError."""
    import pyarrow
    import pyarrow.parquet

    try:
        # A file of this machine by its path: pyarrow reads it without Python's lock.
        with nullcontext(path) if store.is_local else store.file_system.open(path, "rb") as source:
            yield pyarrow.parquet.ParquetFile(source, metadata=footer, read_dictionary=["series"])
    except (pyarrow.ArrowException, ValueError) as error:
        raise _damaged(store, f"{path}: {error}") from error
    except Exception as error:  # each object store has exceptions of its own
        raise _unreadable(store, " ".join(str(error).split()) or type(error).__name__) from error


def _footer(store: Store, path: str) -> "FileMetaData":
    """What a histogram's file says of itself. Raises UsageError where it has more than BINS_MAX rows."""
    with _opened(store, path) as file:
        if file.metadata.num_rows > BINS_MAX:
            raise ValueError(f"{file.metadata.num_rows} bins, a histogram has at most {BINS_MAX}")
        return file.metadata


def _read_bins(store: Store, path: str, footer: "FileMetaData") -> dict[str, _Bins]:
    """value_ns, bin_ns and count of a histogram's rows by series, shape (n,); _NONE where the table has null.

    Raises UsageError for a file that is no histogram.
    """
    import pyarrow

    names = ("value_ns", "bin_ns", "count")
    with _opened(store, path, footer) as file:
        types = {field.name: field.type for field in file.schema_arrow}
        expected = {"series": pyarrow.dictionary(pyarrow.int32(), pyarrow.string())}
        expected |= dict.fromkeys(names, pyarrow.int64())
        if wrong := [name for name, type_ in expected.items() if types.get(name) != type_]:
            wanted = "string" if wrong[0] == "series" else "int64"
            raise ValueError(f"{wrong[0]}: expected {wanted}, got {types.get(wrong[0], 'no such column')}")
        table = file.read(columns=["series", *names], use_threads=False)
        series = table["series"].unify_dictionaries().combine_chunks()
        value, width, count = (table[name].fill_null(_NONE).combine_chunks().to_numpy() for name in names)
        _check_bins(value, width, count)
    known = series.dictionary.to_pylist()
    if len(known) == 1:
        return {str(known[0]): (value, width, count)}
    places = series.indices.fill_null(-1).to_numpy()
    chosen = {str(name): places == place for place, name in enumerate(known)}
    return {name: (value[rows], width[rows], count[rows]) for name, rows in chosen.items()}


def _check_bins(value: Int64s, width: Int64s, count: Int64s) -> None:
    """Raise ValueError for a number that `histogram_table` never writes."""
    for name, column, lowest, highest in (
        ("value_ns", value[value != _NONE], -TIME_MAX_NS, TIME_MAX_NS),
        ("bin_ns", width[width != _NONE], 1, TIME_MAX_NS),
        ("count", count, 0, _COUNT_MAX),
    ):
        if column.size and not lowest <= column.min() <= column.max() <= highest:
            raise ValueError(f"{name}: from {column.min()} to {column.max()}, expected {lowest} to {highest}")
    if (total := count.sum(dtype=np.float64)) > _COUNT_MAX:
        raise ValueError(f"count: {total:g} in all, expected at most {_COUNT_MAX}")


def _merged(bins: Sequence[_Bins]) -> _Bins:
    """The same counts with each bin once, shape (n,)."""
    value, width, count = (np.concatenate(columns) for columns in zip(*bins, strict=True))
    order = np.lexsort((width, value))
    value, width, count = value[order], width[order], count[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(value) != 0) | (np.diff(width) != 0)][: value.size])
    return value[starts], width[starts], np.add.reduceat(count, starts) if starts.size else count


def _figures_of(bins: Sequence[_Bins], deadline_ns: int) -> dict[str, Any]:
    """What a Point says of the bins of its runs (docs/archive.md: columns of histograms)."""
    value, width, count = (np.concatenate(columns) for columns in zip(*bins, strict=True))
    came, known = value != _NONE, width != _NONE
    late = ~came | ~known | (value > deadline_ns - width + 1)
    is_reached = not np.any(came & ~known & (value < deadline_ns))
    values, reached = _added_up(value[came], width[came], count[came])
    percentiles_ns: dict[float, int | None] = dict.fromkeys(PERCENTILES)
    highest_ns: int | None = None
    if values.size:
        # The rank in whole numbers, so that no rounding moves it.
        ranks = [-(-int(reached[-1]) * round(1000 * p) // 100_000) for p in PERCENTILES]
        places = np.searchsorted(reached, ranks)
        # From here on values are known by number only.
        limit_ns = min(value[came & ~known].tolist(), default=None)
        *at_percentiles, highest_ns = (
            int(each) if limit_ns is None or each < limit_ns else None for each in (*values[places], values[-1])
        )
        percentiles_ns = dict(zip(PERCENTILES, at_percentiles, strict=True))
    return {
        "n": int(count.sum()),
        "misses": int(count[late].sum()) if is_reached else None,
        "unclear": int(count[came & known & (value <= deadline_ns) & late].sum()),
        "percentiles_ns": percentiles_ns,
        "max_ns": highest_ns,
    }


def _added_up(value: Int64s, width: Int64s, count: Int64s) -> tuple[Int64s, Int64s]:
    """Values ascending, and how many measurements are at each or below, shape (k,)."""
    step = width[0] if value.size and np.all(width == width[0]) else 0
    if step > 0:
        # Bins of one clock lie on a grid: to add up those of many runs there takes a fraction of the time of sorting.
        lowest = value.min()
        places, beside = np.divmod(value - lowest, step)
        if not beside.any() and places.max() < _GRID_MAX * value.size:
            counts = np.bincount(places, weights=count).astype(np.int64)  # whole numbers below 2**53
            filled = np.flatnonzero(counts)
            return lowest + step * filled, np.cumsum(counts[filled])
    order = np.argsort(value, kind="stable")
    return value[order], np.cumsum(count[order])


_NOT_ONE_ROW = "SELECT file_name, num_rows FROM parquet_file_metadata('{files}') WHERE num_rows <> 1 LIMIT 1"
_POINTS = """
SELECT scenario, parameters, suite, machine, platform, kernel_release AS kernel, {label} AS label,
       min(runs.start_utc) FILTER (status = 'ok') AS start_utc,
       list(run_key ORDER BY runs.start_utc, run_key) FILTER (status = 'ok') AS run_keys,
       list(coalesce(boot_id, run_key) ORDER BY runs.start_utc, run_key) FILTER (status = 'ok') AS boot_ids,
       list(runs.start_utc ORDER BY runs.start_utc, run_key) FILTER (status = 'ok') AS starts,
       count(*) FILTER (off_rate) AS off_rate
FROM runs WHERE status = 'ok' OR off_rate
GROUP BY scenario, parameters, suite, machine, platform, kernel_release, kernel_version, {label}
HAVING bool_or(status = 'ok')
ORDER BY scenario, parameters, platform, {order}, label, kernel_version
"""
