"""Reads the table of runs: a row for each run in the archive, with the value types that docs/archive.md defines.

Anybody who may write to a file of the archive may write anything into it.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import unquote

import numpy as np

from rtfiles.errors import UsageError
from rtrun.archive.entries import YEARS
from rtrun.archive.files import RowRange, check_rows, coded, is_pack, opened, paths_of, places
from rtrun.archive.notes import Notes, read_notes
from rtrun.archive.store import Store
from rtrun.targets.inspection.platform import Platform

if TYPE_CHECKING:
    from pyarrow import DataType
    from pyarrow.parquet import ParquetFile

PACKED_MAX = 1 << 13  #: runs in one file of an archive
_TEXT_BYTES_MAX = 1 << 28  #: texts in such a file; those of a run take some KB
PARTITIONED = ("machine", "suite")  # in schema 1 they were only in the path, as machine=NAME/suite=NAME

LATER = ("cpu", "command_line", "memory_kib")
"""Columns that files of older versions lack: they are null there."""


class RunRow(NamedTuple):
    """A run: what distinguishes it from others, and its circumstances; None where nothing is known.

    `packages` is JSON; temperature in mC, frequency in kHz; `start_utc` has no zone.
    """

    run_key: str
    run: str
    scenario: str
    parameters: str
    platform: str
    status: str
    packages: str
    machine: str
    suite: str
    reason: str | None
    boot_id: str | None
    kernel_release: str | None
    kernel_version: str | None
    commit: str | None
    image: str | None
    middleware_version: str | None
    governor: str | None
    clock_source: str | None
    cpu: str | None
    command_line: str | None
    off_rate: bool
    start_utc: datetime | None
    temperature_max_mc: float | None
    frequency_max_khz: float | None
    load_1min_max: float | None
    cpus: float | None
    memory_kib: float | None

    @property
    def boot(self) -> str:
        """Its boot; a boot of its own where that is not known."""
        return self.boot_id or self.run_key


_REQUIRED = RunRow._fields[: RunRow._fields.index("reason")]
_TEXTS = RunRow._fields[: RunRow._fields.index("off_rate")]


@dataclass(frozen=True, kw_only=True, slots=True)
class Archive:
    """The content of an archive: the runs that count, sorted by key, and where their histograms are.

    `ignored` is how many runs do not count, by reason.
    """

    store: Store
    runs: Sequence[RunRow]
    histograms: Mapping[str, RowRange]
    notes: Notes
    ignored: Mapping[str, int]


def read_archive(store: Store, now: datetime | None = None) -> Archive:
    """The content of an archive at a time in UTC without a zone, by default now.

    Raises UsageError when it has no runs or a file is damaged, InfrastructureError.
    """
    now = now or datetime.now(UTC).replace(tzinfo=None)
    notes = read_notes(store)
    # In this order, because the histogram of a run is written before its row.
    rows = read_runs(store)
    if not rows:
        raise UsageError(f"{store.address}: there are no runs in this archive")
    histograms = places(store, "histograms")
    runs: list[RunRow] = []
    ignored: Counter[str] = Counter()
    for row in (row for row in rows if is_kept(row, notes.kept_since("runs", now))):
        if (note := notes.ignoring(partial(getattr, row), row.start_utc)) is not None:
            ignored[note.words] += 1
        else:
            runs.append(row)
    since = notes.kept_since("histograms", now)
    known = {row.run_key: histograms[row.run_key] for row in runs if row.run_key in histograms and is_kept(row, since)}
    return Archive(store=store, runs=runs, histograms=known, notes=notes, ignored=ignored)


def last_runs(rows: Iterable[RunRow]) -> dict[str, RunRow]:
    """The last run of each board, by the board's name."""
    return {row.machine: row for row in sorted(rows, key=by_time)}


def by_time(row: RunRow) -> tuple[datetime, str]:
    """Sorts runs; one without a time comes first, as it tells nothing about today."""
    return row.start_utc or datetime.min, row.run_key


def is_kept(row: RunRow, since: datetime | None) -> bool:
    """Whether a run began late enough to be kept; with None all are kept, and so is a run without a time."""
    return since is None or row.start_utc is None or row.start_utc >= since


def read_runs(store: Store) -> list[RunRow]:
    """Every run of an archive once, sorted by key. Raises UsageError, InfrastructureError."""
    packs, alone = paths_of(store, "runs")
    found: dict[str, RunRow] = {}
    with ThreadPoolExecutor(store.at_once) as threads:
        for rows in threads.map(partial(_rows, store), packs):
            for row in rows:
                found.setdefault(row.run_key, row)
        others = [path for key, path in alone.items() if key not in found]
        for rows in threads.map(partial(_rows, store), others):
            found |= {row.run_key: row for row in rows}
    return [found[key] for key in sorted(found)]


def _rows(store: Store, path: str) -> list[RunRow]:
    import pyarrow

    partitioned = [name for name in PARTITIONED if f"/{name}=" in path]
    texts = [name for name in _TEXTS if name not in partitioned]
    # pyarrow refuses the name of a column that is absent.
    with opened(store, path, dictionary=[name for name in texts if name not in LATER]) as file:
        check_rows(file.metadata, PACKED_MAX if is_pack(path) else 1)
        _check_size(file)
        there = {*file.schema_arrow.names}
        absent = [name for name in LATER if name not in there]
        in_file = [name for name in RunRow._fields if name not in (*partitioned, *absent)]
        if missing := {*in_file} - there:
            raise ValueError(f"{min(missing)}: no such column")
        table = file.read(columns=in_file, use_threads=False)
        columns = {name: _texts(table, name) for name in texts if name not in absent}
        columns |= {name: [None] * table.num_rows for name in absent}
        columns |= {name: [in_path(path, name)] * table.num_rows for name in partitioned}
        columns["off_rate"] = _as(pyarrow.bool_(), table["off_rate"]).to_pylist()
        if None in columns["off_rate"]:
            raise ValueError("off_rate: missing")
        columns["start_utc"] = list(_times(_as(pyarrow.timestamp("us"), table["start_utc"]).to_pylist()))
        for name in RunRow._fields[RunRow._fields.index("temperature_max_mc") :]:
            if name in absent:
                continue
            columns[name] = _as(pyarrow.float64(), table[name]).to_pylist()
            if any(value is not None and not np.isfinite(value) for value in columns[name]):
                raise ValueError(f"{name}: no number")
        if unknown := set(columns["platform"]) - {*Platform}:
            raise ValueError(f"platform: {min(unknown)[:40]!r}, expected one of {', '.join(Platform)}")
    return list(map(RunRow._make, zip(*(columns[name] for name in RunRow._fields), strict=True)))


def _check_size(file: "ParquetFile") -> None:
    """Raise ValueError where the texts of a file would take too much memory."""
    footer = file.metadata
    size = 0
    for group in map(footer.row_group, range(footer.num_row_groups)):
        columns = map(group.column, range(group.num_columns))
        size += sum(column.total_uncompressed_size for column in columns if column.path_in_schema in _TEXTS)
    if size > _TEXT_BYTES_MAX:
        raise ValueError(f"{size} bytes of texts, at most {_TEXT_BYTES_MAX} are read")


def _as(type_: "DataType", column: Any) -> Any:
    """A column converted to this type. pyarrow loads its functions only when there is something to convert."""
    return column if column.type == type_ else column.cast(type_)


def _texts(table: Any, name: str) -> list[Any]:
    """A column of texts; equal texts share one object."""
    import pyarrow

    column = _as(pyarrow.dictionary(pyarrow.int32(), pyarrow.string()), table[name])
    if name in _REQUIRED and column.null_count:
        raise ValueError(f"{name}: missing")
    known, codes = coded(column)
    known.append(None)
    return [known[code] for code in codes.tolist()]


def _times(moments: Sequence[datetime | None]) -> Iterator[datetime | None]:
    for moment in moments:
        if moment is not None and not YEARS[0] <= moment.year < YEARS[1]:
            raise ValueError(f"start_utc: {moment}, expected a time from {YEARS[0]} to {YEARS[1]}")
        yield moment


def in_path(path: str, name: str) -> str:
    """The value that a schema 1 path has for this name."""
    return unquote(path.partition(f"/{name}=")[2].partition("/")[0])
