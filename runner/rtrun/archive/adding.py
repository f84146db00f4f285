"""Put the runs of a results folder into an archive: a file per run in each table, the row of the run last.

So a run that has its row is complete, and the next call completes what an interrupted call left. Two writers that add
the same run write the same bytes under the same name.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.archive.files import read_files
from rtrun.archive.store import Store, is_whole, write_file
from rtrun.archive.tables import (
    SCHEMAS,
    Origin,
    as_parquet,
    file_of,
    histogram_table,
    key_of,
    run_table,
    sample_table,
)
from rtrun.plan.suites import ALLOCATIONS
from rtrun.results.reading import Source, find_copies, find_source, read_series
from rtrun.results.record import RunRecord, RunStatus, read_record, verify
from rtrun.results.series import Series
from rtrun.results.target_states import read_states


@dataclass(frozen=True, kw_only=True, slots=True)
class Addition:
    """What became of a results folder: the runs added now and before, and why others were refused.

    `notes` name the outputs of added runs that have no measurements in the archive.
    """

    added: tuple[str, ...]
    present: tuple[str, ...]
    refused: tuple[str, ...]
    notes: tuple[str, ...]


def find_runs(results: Path) -> Source:
    """The runs of a folder. Raises UsageError when there are none."""
    source = find_source(results)
    if not source.folders:
        raise UsageError(f"{results}: not a results folder or a run directory")
    return source


def add_results(
    source: Source, store: Store, origin: Origin, *, samples: bool, on_added: Callable[[int, int], None]
) -> Addition:
    """Add every closed run whose files are those that it was closed with.

    A run that is not ok is added without measurements. `on_added` receives how many runs are in the archive, and of how
    many. Raises InfrastructureError, stating how far it came, when the archive cannot be read or written.
    """
    refused = [f"{name}: incomplete, it has no run.json" for name in source.incomplete]
    added: list[str] = []
    present: list[str] = []
    notes: list[str] = []
    tables = [table for table in SCHEMAS if samples or table != "samples"]
    there = {table: _files_of_runs(store, table) for table in tables}
    # Attempts that were measured again show how often the requested rate was missed.
    folders = [*source.folders, *filter(_missed_its_rate, source.old)]
    copies = _copies(folders)
    refused += copies.values()
    for folder in folders:
        if folder in copies:
            continue
        try:
            record = verify(folder)
            run = _add_run(folder, record, store, origin, there)
            (added if run.is_new else present).append(record.run)
            notes += run.notes
        except UsageError as error:
            refused += str(error).splitlines()[:1]
        except InfrastructureError as error:
            raise InfrastructureError(
                f"{error}\n{len(added) + len(present)} of {len(folders)} runs are in the archive: "
                "the same command adds the others"
            ) from error
        on_added(len(added) + len(present), len(folders))
    return Addition(added=tuple(added), present=tuple(present), refused=tuple(refused), notes=tuple(notes))


def _missed_its_rate(folder: Path) -> bool:
    with contextlib.suppress(UsageError):
        return read_record(folder).is_off_rate
    return False


def _copies(folders: Sequence[Path]) -> dict[Path, str]:
    """The runs that are copies of one another; a run without a readable record is refused when it is added."""
    records: dict[Path, RunRecord] = {}
    for folder in folders:
        with contextlib.suppress(UsageError):
            records[folder] = read_record(folder)
    return find_copies(records)


@dataclass(frozen=True, kw_only=True, slots=True)
class _AddedRun:
    is_new: bool
    """False: the archive had all of it already."""
    notes: tuple[str, ...]


def _files_of_runs(store: Store, table: str) -> dict[str, str | None]:
    """The file of each run in a table; None for a run in a pack, which is complete."""
    files = read_files(store, table)
    return {**files.alone, **dict.fromkeys(files.newest())}


def _add_run(
    folder: Path, record: RunRecord, store: Store, origin: Origin, there: Mapping[str, Mapping[str, str | None]]
) -> _AddedRun:
    key = key_of(folder)

    def is_there(table: str) -> bool:
        path = there[table].get(key, "")
        return path is None or bool(path and is_whole(store, path))

    # The row of the run is written last. Counting allocations affects the times of a run.
    tables = there if record.status is RunStatus.OK and not record.parameters.get(ALLOCATIONS) else ["runs"]
    missing = [table for table in tables if not is_there(table)]
    judged: list[Series] = []
    notes: list[str] = []
    if "histograms" in missing or "samples" in missing:
        for series in read_series(folder, record):
            if series.header.main and series.header.incomplete:
                notes.append(f"{record.run}: {series.header.output} is incomplete: {series.header.incomplete}")
            elif series.header.measure is not None and not series.header.incomplete:
                judged.append(series)
    states = None
    try:
        states = read_states(folder, record) if "runs" in missing else None
    except UsageError as error:  # it describes the board; the values do not depend on it
        notes.append(f"{record.run}: {error}")
    for table in missing:
        rows = {
            "samples": lambda: sample_table(key, judged),
            "histograms": lambda: histogram_table(key, judged),
            "runs": lambda: run_table(key, record, origin, states.before if states else None),
        }[table]()
        write_file(store, file_of(table, key), as_parquet(rows))
    return _AddedRun(is_new=bool(missing), notes=tuple(notes))
