"""Results read back: from a log, from samples, from a run directory, from a folder of runs.

A `Result` is one series of one output, what a row of the table shows.
"""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from rtfiles.config import Config, read_json
from rtfiles.errors import UsageError
from rtrun.analysis.figures import Figures, figures_of_histogram
from rtrun.plan.suites import Value, suite
from rtrun.results.gnuplot_log import read_log
from rtrun.results.importers.histogram_file import ENDING, read_histogram
from rtrun.results.samples import Count, read_samples

RECORD = "run.json"
MAIN_SERIES = ("measured", "jitter", "latency")  # what a suite is about; the others are seen from another side
_PUT_ASIDE = re.compile(r"^\.|\.old-[0-9]+$")

Name = Annotated[str, Field(min_length=1, max_length=255)]


class Program(Config):
    """A program that ran."""

    name: str
    argv: list[str]
    exit_status: int | None


class File(Config):
    """Size and checksum of a file in the run directory."""

    size_bytes: Count
    sha256: str


class Record(Config):
    """``run.json``, as docs/formats.md has it; `outputs` are the names, without ending, of what the programs wrote."""

    schema_number: Literal[1] = Field(alias="schema")
    run: str
    campaign: str
    suite: str
    parameters: dict[str, Value]
    emulated: bool
    status: Literal["ok", "failed", "incomplete", "invalid"]
    reason: str | None
    start_time: str
    end_time: str
    programs: list[Program]
    outputs: list[Name]
    target: dict[str, Any]
    attempt: str = ""
    condition: str = "idle"
    settings: dict[str, Value] = Field(default_factory=dict)
    repeat: int = 1
    seed: int | None = None
    requested: dict[str, Any] = Field(default_factory=dict)
    in_effect: dict[str, Any] = Field(default_factory=dict)
    refused: dict[str, str] = Field(default_factory=dict)
    files: dict[Name, File]

    @property
    def preempt_rt(self) -> bool:
        """Whether the kernel was PREEMPT_RT; true where nobody has asked it."""
        return self.target.get("preempt_rt") is not False

    @property
    def circumstances(self) -> dict[str, Value]:
        """The parameters, and what was there beside the suite where there was something: runs of one are alike."""
        condition: dict[str, Value] = {} if self.condition == "idle" else {"condition": self.condition}
        settings = {key: value for key, value in self.settings.items() if value not in (None, "")}
        return self.parameters | condition | settings


@dataclass(frozen=True, kw_only=True, slots=True)
class Result:
    """One series of one output. `parameters` are those known: all of a run's, or what a log's name tells."""

    suite: str
    output: str
    series: str
    parameters: dict[str, Value]
    figures: Figures
    remarks: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain data: what it is, then the figures under their own names."""
        return {
            "suite": self.suite,
            "output": self.output,
            "series": self.series,
            "parameters": self.parameters,
            **self.figures.as_json(),
            "remarks": list(self.remarks),
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """A closed run: its record, and the results of every output, none when the run failed or is invalid."""

    folder: Path
    record: Record
    results: tuple[Result, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Runs:
    """The runs in a folder: those read, the names of those that are not closed, and why any other was refused."""

    folder: Path
    runs: tuple[Run, ...]
    incomplete: tuple[str, ...]
    refused: tuple[str, ...]


def result_of_log(path: Path) -> Result:
    """The result in one log. Raises UsageError as `read_log` does."""
    log = read_log(path)
    return Result(
        suite=log.suite,
        output=path.stem,
        series=log.series,
        parameters=log.parameters,
        figures=log.figures(),
        remarks=log.remarks,
    )


def results_of_samples(path: Path) -> tuple[Result, ...]:
    """The results, one a series, in an npy and the json beside it. Raises UsageError as `read_samples` does."""
    samples = read_samples(path)
    record = samples.record
    remarks = () if record.complete else (f"incomplete: {record.incomplete_reason or 'no reason given'}",)
    return tuple(
        Result(
            suite=record.suite,
            output=samples.path.stem,
            series=name,
            parameters=record.requested,
            figures=figures,
            remarks=remarks,
        )
        for name, figures in samples.figures().items()
    )


def is_closed(folder: Path) -> bool:
    """Whether a run directory has its closing record; without it, nothing in there may be analysed."""
    return (folder / RECORD).is_file()


def read_record(folder: Path) -> Record:
    """Read the closing record of a run directory. Raises UsageError when there is none, or it is wrong."""
    if not is_closed(folder):
        raise UsageError(f"{folder}: incomplete run, it has no {RECORD}: nothing in it is analysed, run it again")
    record = read_json(folder / RECORD, Record)
    for name in [*record.files, *record.outputs]:
        if name in (".", "..") or "/" in name or "\0" in name:
            raise UsageError(f"{folder / RECORD}: {name!r} is no name of a file in the run directory")
    return record


def read_run(folder: Path) -> Run:
    """Read a run directory: its record, then its outputs, whose size and checksum must be those of the record.

    An output is read from its samples, or, when it has none (the programs of 2014 write none), from its logs. Raises
    UsageError when the run is not closed, or a file is missing, altered or not what it should be.
    """
    record = read_record(folder)
    results: list[Result] = []
    if record.status not in ("failed", "invalid"):
        for output in dict.fromkeys(record.outputs):
            results += _results_of_output(folder, record, output)
    return Run(folder=folder, record=record, results=tuple(results))


def _results_of_output(folder: Path, record: Record, output: str) -> list[Result]:
    if f"{output}{ENDING}" in record.files:
        check_file(folder, record, output + ENDING)
        imported = read_histogram(folder / f"{output}{ENDING}")
        return [
            Result(
                suite=record.suite,
                output=output,
                series="latency",
                parameters=record.circumstances,
                figures=figures_of_histogram(imported.histogram),
                remarks=tuple(f"not known: {text}" for text in imported.left_out),
            )
        ]
    if f"{output}.npy" in record.files:
        for ending in (".npy", ".json"):
            check_file(folder, record, output + ending)
        found = list(results_of_samples(folder / f"{output}.npy"))
    else:
        logs = [name for name in log_names(record, output) if name in record.files]
        if not logs:
            raise UsageError(f"{folder / RECORD}: neither samples nor log of the output {output!r} among its files")
        for name in logs:
            check_file(folder, record, name)
        found = [result_of_log(folder / name) for name in logs]
    for result in found:
        if result.suite != record.suite:
            raise UsageError(f"{folder / output}: of {result.suite}, but {RECORD} says {record.suite}")
    return [
        Result(
            suite=result.suite,
            output=output,
            series=result.series,
            parameters=record.circumstances,
            figures=result.figures,
            remarks=result.remarks,
        )
        for result in found
    ]


def log_names(record: Record, output: str) -> list[str]:
    """The names of the logs that an output of this run's suite has."""
    return [f"{output}-{log}.log" for log in suite(record.suite).logs] or [f"{output}.log"]


def check_file(folder: Path, record: Record, name: str) -> None:
    """Refuse a file that is not the one the record was closed with."""
    path = folder / name
    if name not in record.files:
        raise UsageError(f"{folder / RECORD}: {name!r} is not among its files")
    if path.is_symlink() or not path.is_file():
        raise UsageError(f"{path}: named in {RECORD}, but no such file")
    try:
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    expected = record.files[name]
    if path.stat().st_size != expected.size_bytes or digest != expected.sha256:
        raise UsageError(f"{path}: altered since the run was closed: size or checksum is not that in {RECORD}")


def find_runs(folder: Path) -> tuple[list[Path], list[Path]]:
    """The run directories in a folder: those that are closed, and those that are not.

    What the runner put aside (``.<run>.partial``, ``<run>.old-<n>``) is left out. Raises UsageError when there is no
    closed run, naming the folders below that hold some.
    """
    try:
        folders = sorted(path for path in folder.iterdir() if path.is_dir() and not _PUT_ASIDE.search(path.name))
    except OSError as error:
        raise UsageError(f"{folder}: {error.strerror}") from error
    closed = [path for path in folders if is_closed(path)]
    if not closed:
        below = sorted({str(path.parent.parent) for path in folder.glob(f"*/*/{RECORD}")})
        raise UsageError(
            f"{folder}: no finished run (one with {RECORD}) in it{', give ' if below else ''}{' or '.join(below)}"
        )
    return closed, [path for path in folders if path not in closed]


def read_runs(folder: Path) -> Runs:
    """Read every closed run in a folder. Raises UsageError as `find_runs` does."""
    closed, incomplete = find_runs(folder)
    runs: list[Run] = []
    refused: list[str] = []
    for path in closed:
        try:
            runs.append(read_run(path))
        except UsageError as error:
            refused.append(str(error))
    return Runs(
        folder=folder,
        runs=tuple(runs),
        incomplete=tuple(path.name for path in incomplete),
        refused=tuple(refused),
    )
