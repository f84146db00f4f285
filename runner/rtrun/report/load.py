"""Every series of every run, one at a time: samples where there are some, else the histogram of a log."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.errors import UsageError
from rtrun.analysis.histogram import Histogram, Int64s
from rtrun.plan.suites import Value
from rtrun.results.gnuplot_log import Log, read_log
from rtrun.results.importers.histogram_file import ENDING, read_histogram
from rtrun.results.reading import MAIN_SERIES, Record, check_file, find_runs, is_closed, log_names, read_record
from rtrun.results.samples import Samples, read_samples

# Loops at the start of a run that stand apart, as in the thesis: the first message, the first two periods.
STARTUP = {"latency": 1, "jitter": 2, "grid": 2}
_NOTHING = np.empty(0, np.int64)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Measured:
    """One series of one output, without its start-up values.

    Either ``values_ns`` (n,) with loop ``index`` (n,), or a ``histogram``. ``never`` are loops, counted from the end
    of the start-up, that were not fired or went missing (their number only, ``never_count``, where order is lost).
    """

    run: str
    target: str
    suite: str
    output: str
    series: str
    parameters: dict[str, Value]
    emulated: bool
    values_ns: Int64s | None
    index: Int64s | None
    histogram: Histogram | None
    startup: tuple[tuple[int, int], ...]
    never: Int64s
    never_count: int
    missing: int
    out_of_order: int
    duplicate: int
    not_fired: int
    period_ns: float | None
    clock_step_ns: int | None
    in_effect: dict[str, Any]
    remarks: tuple[str, ...]

    @property
    def main(self) -> bool:
        """Whether this is the series that the suite is about."""
        return self.series in MAIN_SERIES


@dataclass(frozen=True, kw_only=True, slots=True)
class Source:
    """What a report is made from: closed runs (or one log or npy), and what was left out and why."""

    path: Path
    folders: tuple[Path, ...]
    left_out: tuple[str, ...]

    def records(self) -> list[Record]:
        """The closing record of every run."""
        return [read_record(folder) for folder in self.folders]


def find(path: Path) -> Source:
    """Find the runs in a folder of runs, in one run directory, or the single log or npy that the path names.

    Raises UsageError when there is nothing to analyse.
    """
    if path.is_file():
        return Source(path=path, folders=(), left_out=())
    if not path.exists():
        raise UsageError(f"{path}: no such file or directory")
    if is_closed(path):
        return Source(path=path, folders=(path,), left_out=())
    closed, incomplete = find_runs(path)
    return Source(
        path=path,
        folders=tuple(closed),
        left_out=tuple(f"{run.name}: incomplete, it has no run.json: nothing in it is analysed" for run in incomplete),
    )


def measured(source: Source, left_out: list[str]) -> Iterator[Measured]:
    """Yield every series in the order of the runs; what is refused goes into `left_out`, one line each."""
    if source.path.is_file():
        yield from _of_file(source.path)
        return
    for folder in source.folders:
        try:
            record = read_record(folder)
            if record.status != "ok":
                left_out.append(f"{record.run}: {record.status}: {record.reason or 'no reason given'}")
                continue
            for output in dict.fromkeys(record.outputs):
                yield from _of_output(folder, record, output, left_out)
        except UsageError as error:
            left_out.append(str(error))


def _of_file(path: Path) -> Iterator[Measured]:
    if path.suffix == ".log":
        log = read_log(path)
        yield _of_log(log, run=path.stem, target="", output=path.stem, parameters=log.parameters, emulated=False)
    elif path.suffix in (".npy", ".json"):
        samples = read_samples(path)
        yield from _of_samples(samples, run=path.stem, target="", parameters=samples.record.requested, emulated=False)
    else:
        raise UsageError(f"{path}: not a folder of runs, a run directory, or a .log or .npy of a suite")


def _of_output(folder: Path, record: Record, output: str, left_out: list[str]) -> Iterator[Measured]:
    if f"{output}{ENDING}" in record.files:
        check_file(folder, record, output + ENDING)
        yield _of_histogram(folder, record, output)
        return
    if f"{output}.npy" in record.files:
        for ending in (".npy", ".json"):
            check_file(folder, record, output + ending)
        samples = read_samples(folder / f"{output}.npy")
        if samples.record.suite != record.suite:
            raise UsageError(f"{folder / output}.json: of {samples.record.suite}, but run.json says {record.suite}")
        if not samples.record.complete:
            reason = samples.record.incomplete_reason or "no reason given"
            left_out.append(f"{record.run}: {output} is incomplete: {reason}")
            return
        yield from _of_samples(
            samples, run=record.run, target=target_of(record), parameters=record.circumstances, emulated=record.emulated
        )
        return
    logs = [name for name in log_names(record, output) if name in record.files]
    if not logs:
        raise UsageError(f"{folder / 'run.json'}: neither samples nor log of the output {output!r} among its files")
    for name in logs:
        check_file(folder, record, name)
        log = read_log(folder / name)
        yield _of_log(
            log,
            run=record.run,
            target=target_of(record),
            output=output,
            parameters=record.circumstances,
            emulated=record.emulated,
        )


def _of_samples(
    samples: Samples, *, run: str, target: str, parameters: dict[str, Value], emulated: bool
) -> Iterator[Measured]:
    counts, in_effect = samples.record.counts, samples.record.in_effect
    first = samples.rows[:, 0]
    period = float(int(first[-1]) - int(first[0])) / (first.size - 1) if first.size > 1 else None
    for name, series in samples.series.items():
        skip = STARTUP.get(name, 0)
        head = int(np.searchsorted(series.index, skip))
        never = _gaps(series.index, counts.asked) if counts.not_fired + counts.missing else _NOTHING
        never = never[never >= skip] - skip
        yield Measured(
            run=run,
            target=target,
            suite=samples.record.suite,
            output=samples.path.stem,
            series=name,
            parameters=parameters,
            emulated=emulated,
            values_ns=np.ascontiguousarray(series.values_ns[head:]),
            index=series.index[head:],
            histogram=None,
            startup=tuple((int(v), int(i)) for v, i in zip(series.values_ns[:head], series.index[:head], strict=True)),
            never=never,
            never_count=int(never.size),
            missing=counts.missing,
            out_of_order=counts.out_of_order,
            duplicate=counts.duplicate,
            not_fired=counts.not_fired,
            period_ns=period if period and period > 0 else period_of(parameters),
            clock_step_ns=in_effect.clock_step_ns or None,
            in_effect=json.loads(in_effect.model_dump_json()),
            remarks=(),
        )


def _gaps(index: Int64s, asked: int) -> Int64s:
    there = np.zeros(asked, dtype=bool)
    there[index] = True
    return np.flatnonzero(~there).astype(np.int64)


def _of_log(log: Log, *, run: str, target: str, output: str, parameters: dict[str, Value], emulated: bool) -> Measured:
    counts = log.count.copy()
    startup = []
    # A log names the loop of its ten highest and lowest values only: a start-up value among them can be set apart.
    for entry in {e.index: e for e in (*log.top, *log.lowest)}.values():
        if entry.index is not None and entry.index < STARTUP.get(log.series, 0):
            counts[np.searchsorted(log.value_us, round(entry.value_us))] -= 1
            startup.append((round(entry.value_us * 1000), entry.index))
    kept = counts > 0
    remarks = list(log.remarks)
    if len(startup) < min(STARTUP.get(log.series, 0), int(log.count.sum())):
        remarks.append("start-up values are not among the listed ones: the figures include them")
    return Measured(
        run=run,
        target=target,
        suite=log.suite,
        output=output,
        series=log.series,
        parameters=parameters,
        emulated=emulated,
        values_ns=None,
        index=None,
        histogram=Histogram(values_ns=log.value_us[kept] * 1000, counts=counts[kept]),
        startup=tuple(sorted(startup, key=lambda pair: pair[1])),
        never=_NOTHING,
        never_count=log.missing + log.not_fired,
        missing=log.missing,
        out_of_order=log.out_of_order,
        duplicate=log.duplicate,
        not_fired=log.not_fired,
        period_ns=period_of(parameters),
        clock_step_ns=None,
        in_effect={},
        remarks=tuple(remarks),
    )


def _of_histogram(folder: Path, record: Record, output: str) -> Measured:
    found = read_histogram(folder / f"{output}{ENDING}")
    return Measured(
        run=record.run,
        target=target_of(record),
        suite=record.suite,
        output=output,
        series="latency",
        parameters=record.circumstances,
        emulated=record.emulated,
        values_ns=None,
        index=None,
        histogram=found.histogram,
        startup=(),
        never=_NOTHING,
        never_count=0,
        missing=0,
        out_of_order=0,
        duplicate=0,
        not_fired=0,
        period_ns=found.period_ns,
        clock_step_ns=None,
        in_effect={},
        remarks=found.left_out,
    )


def target_of(record: Record) -> str:
    """The target in a few words: runs on another board or kernel are never pooled with these."""
    told = [record.target.get(key) for key in ("name", "kernel_release", "kernel_version")]
    return ", ".join(word for word in told if isinstance(word, str) and word)


def period_of(parameters: dict[str, Value]) -> float | None:
    """How long one measurement takes at least, in ns, from the parameters; None when they do not tell."""
    timeout, frequency = parameters.get("timeout_us"), parameters.get("frequency_hz")
    if isinstance(timeout, int) and timeout > 0:
        return timeout * 1e3
    if isinstance(frequency, int) and frequency > 0:
        return 1e9 / frequency
    return None
