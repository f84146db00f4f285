"""Results read back, from a run directory or from a folder of runs.

Everything that prints or judges results, terminal or report, takes them from here.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.kinds.lateness import Measure
from rtrun.plan.suites import log_names, period_of
from rtrun.plan.trace import WARM_UP
from rtrun.results.gnuplot_log import read_log
from rtrun.results.importers import samples_file
from rtrun.results.importers.histogram_file import ENDING, read_histogram
from rtrun.results.record import FILE, RunRecord, RunStatus, check_file, is_closed, read_record
from rtrun.results.samples import EMPTY_BYTES, read_samples
from rtrun.results.series import (
    Result,
    Series,
    results_of,
    series_of_histogram,
    series_of_imported_samples,
    series_of_log,
    series_of_samples,
)

_PUT_ASIDE = re.compile(rf"^\.|\.old-[0-9]+$|{re.escape(WARM_UP)}$")
_OLD = re.compile(r".+\.old-[0-9]+")
_CUT_OFF = re.compile(r"(.+)\.incomplete-[0-9]+")


@dataclass(frozen=True, kw_only=True, slots=True)
class ClosedRun:
    """A closed run: its record, and the results of every output; no results when the run failed or is invalid."""

    folder: Path
    record: RunRecord
    results: tuple[Result, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Runs:
    """The runs in a folder: those that were read, the names of open ones, and why the others were refused."""

    folder: Path
    runs: tuple[ClosedRun, ...]
    incomplete: tuple[str, ...]
    refused: tuple[str, ...]


def read_run(folder: Path) -> ClosedRun:
    """Read a run directory: its record, then the figures of its outputs. Raises UsageError as `read_series` does."""
    record = read_record(folder)
    of_use = record.status not in (RunStatus.FAILED, RunStatus.INVALID)
    return ClosedRun(folder=folder, record=record, results=results_of(read_series(folder, record)) if of_use else ())


def read_series(folder: Path, record: RunRecord, measure: Measure | None = None) -> Iterator[Series]:
    """Yield every series of every output of a run; the files must be those that the record was closed with.

    An output is read from its samples. If it has none (the programs of 2014 write none), it is read from its logs.
    `measure` is the one that the question names. Raises UsageError when a file is missing, altered or malformed, or has
    no such series.
    """
    for output in dict.fromkeys(record.outputs):
        for series in _series_of_output(folder, record, output, measure):
            if series.header.suite != record.suite and f"{output}{ENDING}" not in record.files:
                raise UsageError(f"{folder / output}: of {series.header.suite}, but {FILE} says {record.suite}")
            yield replace(
                series,
                header=replace(
                    series.header,
                    run=record.run,
                    target=target_of(record),
                    suite=record.suite,
                    output=output,
                    parameters=record.circumstances,
                    platform=record.platform,
                    period_ns=series.header.period_ns or period_of(record.parameters),
                ),
            )


def _series_of_output(folder: Path, record: RunRecord, output: str, measure: Measure | None) -> Iterator[Series]:
    if f"{output}{ENDING}" in record.files:
        check_file(folder, record, output + ENDING)
        yield series_of_histogram(read_histogram(folder / f"{output}{ENDING}"), measure)
    elif f"{output}{samples_file.ENDING}" in record.files:
        for ending in (samples_file.ROWS_ENDING, samples_file.ENDING):
            check_file(folder, record, output + ending)
        yield series_of_imported_samples(
            samples_file.read_imported_samples(folder / f"{output}{samples_file.ENDING}"), measure
        )
    elif f"{output}.npy" in record.files:
        for ending in (".npy", ".json"):
            check_file(folder, record, output + ending)
        yield from series_of_samples(read_samples(folder / f"{output}.npy"), measure)
    else:
        logs = [name for name in log_names(record.suite, output) if name in record.files]
        if not logs:
            raise UsageError(f"{folder / FILE}: neither samples nor log of the output {output!r} among its files")
        for name in logs:
            check_file(folder, record, name)
            yield series_of_log(read_log(folder / name), measure)


def target_of(record: RunRecord) -> str:
    """The target in a few words: runs on different boards or kernels are never pooled."""
    facts = (record.target.name, record.target.kernel_release, record.target.kernel_version)
    return ", ".join(word for word in facts if isinstance(word, str) and word)


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """What a path holds: closed runs and the names of open ones; or one file, and then `folders` is empty.

    ``repeated`` are attempts that a restart of the target cut off, at runs that were closed later. ``old`` are closed
    attempts that were measured again.
    """

    path: Path
    folders: tuple[Path, ...]
    incomplete: tuple[str, ...] = ()
    repeated: tuple[str, ...] = ()
    old: tuple[Path, ...] = ()


def find_source(path: Path) -> Source:
    """Find what is at a path: a file, a run directory, or a folder of runs.

    Folders that the runner put aside (``.<run>.partial``, ``<run>.old-<n>``, ``<run>.warm-up``) are left out. Raises
    UsageError when there is neither a file nor a closed run, naming the folders below that hold some.
    """
    if path.is_file():
        return Source(path=path, folders=())
    if not path.exists():
        raise UsageError(f"{path}: no such file or directory")
    if is_closed(path):
        return Source(path=path, folders=(path,))
    try:
        every = sorted(child for child in path.iterdir() if child.is_dir())
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    folders = [child for child in every if not _PUT_ASIDE.search(child.name)]
    names = {child.name for child in every if is_closed(child)}
    closed = tuple(folder for folder in folders if folder.name in names)
    if not closed:
        holders = {record.parent.parent for record in path.glob(f"*/*/{FILE}")}
        below = sorted(str(folder) for folder in holders if not folder.is_symlink())
        raise UsageError(
            f"{path}: no finished run (one with {FILE}) in it{', give ' if below else ''}{' or '.join(below)}"
        )
    others = [folder.name for folder in folders if folder.name not in names]
    repeated = tuple(name for name in others if (cut_off := _CUT_OFF.fullmatch(name)) and cut_off[1] in names)
    incomplete = tuple(name for name in others if name not in repeated)
    old = tuple(child for child in every if _OLD.fullmatch(child.name) and child.name in names)
    return Source(path=path, folders=closed, incomplete=incomplete, repeated=repeated, old=old)


def read_runs(folder: Path) -> Runs:
    """Read every closed run in a folder. Raises UsageError as `find_source` does."""
    source = find_source(folder)
    runs: list[ClosedRun] = []
    refused: list[str] = []
    for path in source.folders:
        try:
            runs.append(read_run(path))
        except UsageError as error:
            refused.append(str(error))
    return Runs(folder=folder, runs=tuple(runs), incomplete=source.incomplete, refused=tuple(refused))


def find_copies(records: Mapping[Path, RunRecord]) -> dict[Path, str]:
    """Find run directories that hold the same as another: a line for each, naming both.

    They have the same attempt, or the same samples, because two measurements never give equal samples. Samples without
    any measurement are alike in all runs, and histograms may be equal by chance.
    """
    holders: dict[tuple[str, str], list[Path]] = {}
    for folder, record in records.items():
        marks = [("attempt", record.attempt)] if record.attempt else []
        # Two streams of one run may hold the same times, for example two paths that begin and end alike.
        identity = f"{record.suite} {sorted(record.parameters.items())}" if record.subject == "attached" else ""
        marks += [
            (f"samples {identity}", file.sha256)
            for name, file in record.files.items()
            if name.endswith(".npy") and file.size_bytes > EMPTY_BYTES
        ]
        for mark in dict.fromkeys(marks):
            holders.setdefault(mark, []).append(folder)
    copies: dict[Path, str] = {}
    for (what, _), folders in holders.items():
        for folder in folders if len(folders) > 1 else []:
            other = next(other for other in folders if other != folder)
            alike = "are of the same attempt" if what == "attempt" else "hold the same samples"
            copies.setdefault(
                folder, f"{folder.name}: a copy? it and {other.name} {alike}, and neither counts: remove the copy"
            )
    return copies
