"""Reader of a suite's samples: ``<output>.npy`` with the ``<output>.json`` beside it.

Both are untrusted: their sizes are limited, the npy is never unpickled, and rows and counts must tell the same.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from rtfiles.config import Config, read_json
from rtfiles.errors import UsageError
from rtrun.analysis.histogram import Int64s
from rtrun.plan.limits import (
    TIME_MAX_NS,
    WALL_TIME_MAX_NS,
    ClockStepNs,
    Count,
    Cpu,
    CpuDmaLatencyUs,
    MeanNs,
    Pid,
    Priority,
    TimeNs,
)
from rtrun.plan.question import Measure
from rtrun.plan.suites import Asked, Parameters, Suite, suite
from rtrun.results.npy import read_header
from rtrun.results.rate import Rate

MAX_NPY_BYTES = 4 << 30
NOT_FIRED_NS = -(2**63)
MAX_ABSENT = 10_000_000  # loops without a value, so that they fit into memory
# Clocks that NTP disciplines drift from others by 500 ppm at most.
_NTP_DRIFT = 5e-4
# So many calls in a row are not all interrupted between their two stamps.
_FEW_CALLS = 16
_LEAST_STEP_NS = 1_000_000  # NTP steps a clock by more, and slews it by less
# Threads of a suite that have no part in the measurement: of normal scheduling, on spare CPUs, whatever was asked for.
NON_MEASURING_THREADS = frozenset({"rt_blocks", "rt_traces"})


class Thread(Config):
    """A thread of the measuring program, as the kernel showed it."""

    tid: Pid
    name: str
    policy: str
    priority: Priority
    cpus: list[Cpu]


class InEffect(Config):
    """What was in effect while measuring, read back."""

    threads: list[Thread]
    clock: str
    clock_resolution_ns: ClockStepNs
    clock_step_ns: ClockStepNs
    mlockall: bool
    cpu_dma_latency_us: CpuDmaLatencyUs | None = None
    """The lowest latency that any program held in /dev/cpu_dma_latency, or the kernel's default; None: not known."""


class Kernel(Config):
    """The kernel measured on, as uname names it."""

    release: str
    version: str
    machine: str


class Counts(Config):
    """How many measurements were asked for, and what became of them."""

    asked: Asked
    measured: Count
    not_fired: Count
    missing: Count
    duplicate: Count
    out_of_order: Count

    @property
    def known(self) -> int:
        """How many became something."""
        return self.measured + self.not_fired + self.missing


class Indices(Config):
    """Indices of what the counts count, the first 1000 of each."""

    not_fired: list[Count]
    missing: list[Count]
    duplicate: list[Count]
    out_of_order: list[Count]


class Entry(Config):
    """One value of a list of the highest or lowest."""

    value_ns: TimeNs
    index: Count


class Summary(Config):
    """A program's own summary of one series; the numbers are None when n is 0."""

    n: Count
    min_ns: TimeNs | None
    mean_ns: TimeNs | MeanNs | None
    max_ns: TimeNs | None
    top: list[Entry]
    lowest: list[Entry]


class Files(Config):
    """Names of the files written beside the json."""

    logs: list[str]
    npy: str


class Traces(Config):
    """Values above a limit that the kernel trace was asked for, and the traces that were kept."""

    above_limit: Count
    files: list[str]


class ProgramHead(Config):
    """What the json of every program begins with: what was requested, and in effect."""

    schema_number: Literal[1] = Field(alias="schema")
    suite: str
    program: str
    version: str
    complete: bool
    incomplete_reason: str | None
    requested: Parameters
    in_effect: InEffect
    host: str
    kernel: Kernel
    start_time: str
    end_time: str


class Record(ProgramHead):
    """``<output>.json``, as docs/formats.md has it."""

    counts: Counts
    indices: Indices
    summary: dict[str, Summary]
    files: Files
    columns: list[str] | None = None
    """Of the npy; samples of earlier versions do not name theirs, which are those of suites.yml."""
    rate: Rate | None = None
    """None: samples of earlier versions."""
    traces: Traces = Field(default_factory=lambda: Traces(above_limit=0, files=[]))


class SentCounts(Config):
    """How many messages were asked for, and sent."""

    asked: Asked
    sent: Count


class SenderRecord(ProgramHead):
    """``<output>-publisher.json``: a program without samples."""

    counts: SentCounts
    rate: Rate


def _none() -> Int64s:
    return np.empty(0, np.int64)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class IndexedValues:
    """Values in nanoseconds and the index of each measurement, both of shape (n,).

    `absent`, int64 (a,), ascending, are the loops without a value, counted with them: what did not fire, is missing or
    was skipped. `assumes` says what had to be assumed for the values, `undecidable` why no answer can rest on them.
    """

    values_ns: Int64s
    index: Int64s
    absent: Int64s = field(default_factory=_none)
    assumes: str = ""
    undecidable: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """The samples of one run of a program.

    `series` are measured, reported and difference (one-shot; measured_2014 and difference_2014 too, unless the samples
    are of an earlier version), lateness, jitter and grid (cyclic), or latency (communication, in the order of the
    sequence numbers); the first of them is what the suite is about.
    `columns`, each of shape (rows,), are mapped from the file, in the order of suites.yml.
    """

    path: Path
    record: Record
    columns: dict[str, Int64s]
    series: dict[str, IndexedValues]

    def judged(self, of: Measure | None) -> IndexedValues:
        """The series that a question is of. Raises UsageError when the suite measures no such thing."""
        try:
            measure = suite(self.record.suite).judged(of)
        except UsageError as error:
            raise UsageError(f"{self.path}: {self.record.suite} {error}") from None
        return next(values for name, values in self.series.items() if called(name) == measure)


# What a question calls a series that it may be of; of two by one name the first in the samples is meant.
_CALLED: dict[str, Measure] = {
    "measured": "latency",
    "measured_2014": "latency",
    "latency": "latency",
    "lateness": "lateness",
    "jitter": "jitter",
}


def called(series: str) -> Measure | None:
    """What a question calls a series by this name; None for one that no question is of."""
    return _CALLED.get(series)


def read_samples(path: Path, record: Record | None = None) -> Samples:
    """Read an output by its json or its npy; the other one must stand beside it. `record` is the json, if read before.

    Raises UsageError that names the file, or both where they disagree.
    """
    json_path, npy_path = path.with_suffix(".json"), path.with_suffix(".npy")
    record = record or read_json(json_path, Record)
    if record.suite not in _SERIES_OF_SUITE:
        raise UsageError(f"{json_path}: suite: unknown suite {record.suite!r}, known: {', '.join(_SERIES_OF_SUITE)}")
    counts = record.counts
    if counts.known > counts.asked:
        raise UsageError(
            f"{json_path}: counts: {counts.asked} asked for, but {counts.known} measured + not fired + missing"
        )
    kind = suite(record.suite)
    rows = _read_rows(npy_path, kind)
    names = _column_names(record, kind, npy_path, rows.shape[1])
    columns = {name: rows[:, names.index(name)] for name in kind.columns if name in names}
    series = _SERIES_OF_SUITE[record.suite](columns, record, npy_path)
    return Samples(path=npy_path, record=record, columns=columns, series=series)


def _read_rows(path: Path, kind: Suite) -> Int64s:
    """Map the rows, shape (rows, columns)."""
    if path.exists() and not path.is_file():
        raise UsageError(f"{path}: not a regular file")
    try:
        size = path.stat().st_size
        if size > MAX_NPY_BYTES:
            raise UsageError(f"{path}: {size} bytes, samples have at most {MAX_NPY_BYTES}")
        with path.open("rb") as stream:
            header = read_header(stream)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from error
    shape = header.shape
    if header.dtype != "<i8":
        raise UsageError(f"{path}: values of type {header.dtype}, must be <i8 (int64)")
    width = shape[1] if len(shape) == 2 else 1
    if len(shape) not in (1, 2) or width not in (len(kind.columns), len(kind.columns) - len(kind.added_columns)):
        raise UsageError(f"{path}: shape {shape}, must be (rows, {len(kind.columns)}) of {', '.join(kind.columns)}")
    if header.fortran_order:
        raise UsageError(f"{path}: in Fortran order, must be in C order")
    rows, expected = shape[0], header.start_bytes + 8 * shape[0] * width
    if size != expected:
        raise UsageError(f"{path}: {size} bytes, {rows} rows take {expected}: cut off or not of one piece")
    if rows == 0:
        return np.empty((0, width), dtype=np.int64)
    return np.memmap(path, dtype="<i8", mode="r", offset=header.start_bytes, shape=(rows, width))


def _column_names(record: Record, kind: Suite, path: Path, width: int) -> Sequence[str]:
    """The name of each column of the rows: what the json says, or what earlier versions wrote."""
    if record.columns is None:
        return kind.columns[:width]
    names = set(record.columns)
    needed = set(kind.columns) - set(kind.added_columns)
    if len(names) != len(record.columns) or len(names) != width or not needed <= names <= set(kind.columns):
        raise UsageError(
            f"{_disagree(path)}: columns: {', '.join(record.columns)} in the json, {width} in the rows;"
            f" known: {', '.join(kind.columns)}"
        )
    return record.columns


def _disagree(path: Path) -> str:
    return f"{path} and {path.with_suffix('.json').name} disagree"


def _agree(path: Path, what: str, rows: int, counts: int) -> None:
    if rows != counts:
        raise UsageError(f"{_disagree(path)}: {what}: {rows} in the rows, {counts} in the counts")


def _times(path: Path, *columns: Int64s) -> None:
    for column in columns:
        if column.size and (int(column.min()) < -TIME_MAX_NS or int(column.max()) > TIME_MAX_NS):
            raise UsageError(f"{path}: a time beyond {TIME_MAX_NS} ns cannot be")


def _oneshot(columns: dict[str, Int64s], record: Record, path: Path) -> dict[str, IndexedValues]:
    counts = record.counts
    fired = columns["measured_ns"] != NOT_FIRED_NS
    index = np.flatnonzero(fired)
    _agree(path, "measured", len(index), counts.measured)
    _agree(path, "not fired", len(fired) - len(index), counts.not_fired)
    measured, reported = columns["measured_ns"][index], columns["reported_ns"][index]
    _times(path, columns["start_ns"], columns["end_ns"][index], measured, reported)
    values = {"measured": measured, "reported": reported, "difference": reported - measured}
    absent = np.flatnonzero(~fired)
    if "armed_ns" in columns:
        start, armed = columns["start_ns"][index], columns["armed_ns"][index]
        _times(path, armed)
        # The programs of 2014 counted from after roscpp had armed the timer.
        values["measured_2014"] = measured - (armed - start)
        values["difference_2014"] = reported - values["measured_2014"]
    return {name: IndexedValues(values_ns=column, index=index, absent=absent) for name, column in values.items()}


def _cyclic(columns: dict[str, Int64s], record: Record, path: Path) -> dict[str, IndexedValues]:
    """Lateness of each call, jitter of each period, and the grid from the first timestamp; from the second one on."""
    timestamp = np.asarray(columns["timestamp_ns"])
    _times(path, timestamp)
    _agree(path, "measured periods", max(len(timestamp) - 1, 0), record.counts.measured)
    index = np.arange(max(len(timestamp) - 1, 0))
    passed_ns = timestamp[1:] - timestamp[:1] if len(timestamp) else timestamp
    frequency_hz = _frequency_hz(record, path)
    period_ns = _grid_ns(1, frequency_hz)
    grid = IndexedValues(values_ns=passed_ns - _grid_ns(index + 1, frequency_hz), index=index)
    lateness = _lateness(columns, record, path, period_ns) if "expected_ns" in columns else _estimated(grid, period_ns)
    return {
        "lateness": lateness,
        "jitter": IndexedValues(values_ns=np.diff(timestamp) - period_ns, index=index),
        "grid": grid,
    }


def _lateness(columns: dict[str, Int64s], record: Record, path: Path, period_ns: int) -> IndexedValues:
    """How late each call is against the grid that roscpp keeps, whose skipped periods are absent.

    roscpp moves its grid when it is two periods behind: what it moves it by beyond whole periods is lateness of the
    call there, and the whole periods are skipped. So nothing is made up for by moving the grid.
    """
    expected, real = np.asarray(columns["expected_ns"]), np.asarray(columns["real_ns"])
    for column in (expected, real):
        if column.size and not 0 <= int(column.min()) <= int(column.max()) <= WALL_TIME_MAX_NS:
            raise UsageError(f"{path}: a time of the wall clock below 0 or above {WALL_TIME_MAX_NS} ns cannot be")
    passed = np.diff(expected)
    skipped = np.maximum(passed // period_ns - 1, 0)
    values = (real - expected)[1:] + np.where(passed > period_ns, passed % period_ns, 0)
    _times(path, values)
    total = int(skipped.sum(dtype=np.float64))
    if total > MAX_ABSENT:
        raise UsageError(
            f"{path}: {total} periods were skipped: none with more than {MAX_ABSENT} is read; was the wall clock set?"
        )
    if record.rate is not None and record.rate.skipped is not None:
        _agree(path, "skipped", total, record.rate.skipped)
    # The loops of the calls, of which each has those that were skipped before it.
    loops = np.arange(values.size) + np.cumsum(skipped)
    return IndexedValues(
        values_ns=values,
        index=np.arange(values.size),
        absent=_without(loops, int(loops[-1]) + 1) if total else _none(),
        undecidable=_clock_was_set(real - np.asarray(columns["timestamp_ns"]), period_ns),
    )


def _clock_was_set(offset: Int64s, period_ns: int) -> str:
    """Why calls are neither late nor in time: roscpp's grid jumped with the wall clock; empty where it did not.

    `offset`, int64 (n,), is the wall clock less that of the timestamps, a little less where a thread was interrupted
    between the two stamps of a call. So its highest value among a few calls shows whether one of the clocks was set.
    """
    if not offset.size:
        return ""
    highest = np.maximum.reduceat(offset, np.arange(0, max(1, offset.size - _FEW_CALLS + 1), _FEW_CALLS))
    most_ns = int(np.abs(np.diff(highest)).max(initial=0))
    if most_ns <= max(_LEAST_STEP_NS, period_ns) + _NTP_DRIFT * period_ns * _FEW_CALLS:
        return ""
    return (
        f"the wall clock, by which roscpp keeps its grid, was set by {most_ns / 1e6:.3g} ms while it was measured: "
        "measure again when it is not (NTP steps it after a boot), or ask for the jitter (--of jitter)"
    )


def _estimated(grid: IndexedValues, period_ns: int) -> IndexedValues:
    """Lateness of samples that do not tell when calls were due, against a grid laid through the earliest ones.

    Clocks drift: the grid is that of the first timestamp, tilted so that the earliest of the first quarter and of the
    last are as late as one another, by 500 ppm at most. A call more than two periods late makes roscpp move its grid,
    where to is not known.
    """
    values, quarter = grid.values_ns, grid.values_ns.size // 4
    if not values.size:
        return grid
    late = values
    # Twice: where the grid still falls or rises, the earliest calls are found at the ends of the quarters.
    for _ in range(2):
        first = int(np.argmin(late[: quarter or None]))
        last = late.size - quarter + int(np.argmin(late[-quarter:])) if quarter else first
        slope = (int(late[last]) - int(late[first])) / max(1, last - first)
        limit = _NTP_DRIFT * period_ns
        late = late - np.rint(min(max(slope, -limit), limit) * grid.index).astype(np.int64)
    late = late - late.min()
    undecidable = ""
    if int(late.max()) > 2 * period_ns:
        undecidable = (
            "samples of an earlier version do not tell when calls were due, and one came more than two periods late, "
            "after which roscpp moves its grid: measure again, or ask for the jitter (--of jitter)"
        )
    return IndexedValues(
        values_ns=late,
        index=grid.index,
        assumes="a grid estimated from the earliest calls: these samples do not tell when calls were due",
        undecidable=undecidable,
    )


def _grid_ns(periods: Any, frequency_hz: int) -> Any:
    """So many periods, an int or an array of them, to the nearest nanosecond; in whole numbers, so it never drifts."""
    return (2 * periods * 10**9 + frequency_hz) // (2 * frequency_hz)


def _frequency_hz(record: Record, path: Path) -> int:
    frequency_hz = record.requested.get("frequency_hz")
    if not isinstance(frequency_hz, int):
        raise UsageError(
            f"{path.with_suffix('.json')}: requested.frequency_hz: must be a whole number, got {frequency_hz!r}"
        )
    return frequency_hz


def _communication(columns: dict[str, Int64s], record: Record, path: Path) -> dict[str, IndexedValues]:
    publication, reception, arrived = columns["publication_ns"], columns["reception_ns"], columns["seq"]
    counts = record.counts
    _times(path, publication, reception)
    steps = np.diff(arrived)
    is_in_order = bool(np.all(steps > 0))
    # As a rule nothing is to be sorted, which takes longer than all the figures.
    seq, order = (arrived, slice(None)) if is_in_order else np.unique(arrived, return_index=True)
    first, last = (int(seq[0]), int(seq[-1])) if seq.size else (0, -1)
    if first < 0 or last >= counts.asked:
        raise UsageError(
            f"{_disagree(path)}: seq: {first} to {last} in the rows, {counts.asked} asked for in the counts"
        )
    if len(seq) != len(arrived):
        raise UsageError(
            f"{_disagree(path)}: seq: {len(arrived) - len(seq)} numbers stand in the rows again, which hold each once"
        )
    _agree(path, "measured", len(seq), counts.measured)
    # Whoever did not see the last message knows only of the gaps between those that came.
    missing = range(last + 1 - len(seq), counts.asked - len(seq) + 1)
    if counts.missing not in (missing[-1:] if record.complete else missing):
        _agree(path, "missing", missing[-1], counts.missing)
    _agree(path, "out of order", int(np.count_nonzero(steps < 0)), counts.out_of_order)
    absent = _absent(seq, counts.asked, path) if counts.missing else _none()
    return {"latency": IndexedValues(values_ns=(reception - publication)[order], index=seq, absent=absent)}


def _absent(index: Int64s, asked: int, path: Path) -> Int64s:
    if asked - len(index) > MAX_ABSENT:
        raise UsageError(
            f"{path}: {asked} were asked for, {len(index)} came: none with more than {MAX_ABSENT} missing is read"
        )
    return _without(index, asked)


def _without(present: Int64s, number: int) -> Int64s:
    """Which of so many loops are not among those present, ascending."""
    absent = np.ones(number, dtype=bool)
    absent[present] = False
    return np.flatnonzero(absent).astype(np.int64)


# How the series of a suite follow from its columns in suites.yml.
_SERIES_OF_SUITE: dict[str, Callable[[dict[str, Int64s], Record, Path], dict[str, IndexedValues]]] = {
    "oneshot_timer_tests": _oneshot,
    "cyclic_timer_tests": _cyclic,
    "communication_tests": _communication,
}
