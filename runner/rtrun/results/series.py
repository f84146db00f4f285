"""One series of one output, from samples, a log or an import: every figure and verdict begins here.

The start-up values are separated here, so that they stay separate in everything that is reported.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rtfiles.errors import UsageError
from rtfiles.output import printable
from rtrun.analysis.figures import Figures, IndexedValue, figures_of_histogram, figures_of_samples
from rtrun.analysis.histogram import Histogram
from rtrun.kinds.known import MAIN_2014, called, startup_loops
from rtrun.kinds.lateness import Measure, judged
from rtrun.kinds.values import Int64s
from rtrun.plan.suites import Value, measures, period_of, suite
from rtrun.results.output import InEffect
from rtrun.results.samples import Samples, read_samples
from rtrun.targets.inspection.platform import Platform

if TYPE_CHECKING:
    from rtrun.results.gnuplot_log import Log
    from rtrun.results.importers.histogram_file import Imported
    from rtrun.results.importers.samples_file import ImportedSamples

MEASURED_2014 = "measured_2014"
# The remark for every display of such a series.
NOTE_2014 = (
    "measured counts from before the timer is armed; measured_2014 and difference_2014 count from after it, as the"
    " programs of 2014 and the logs do: a few microseconds less."
)


_US = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class Header:
    """Everything known about a series except its values.

    For a single file, `run` is the name of the file, `target` is empty, and `parameters` are those that the file
    states. `measure` is the name of this series in a question, None if no question can ask for it. `main` marks the
    series that the question is about and that is judged. `startup` are the values of the first loops, which no figure
    includes. `missing`, `out_of_order`, `duplicate`, `not_fired` and `skipped` count what is not a value. `incomplete`
    is the reason why fewer values were measured than asked for, `undecidable` the reason why no answer can rest on
    them; empty where there is none. `remarks` are sentences on what the file does not state, or stated wrongly and was
    corrected.
    """

    run: str
    target: str = ""
    suite: str
    output: str
    series: str
    measure: Measure | None = None
    main: bool = True
    parameters: dict[str, Value]
    platform: Platform = Platform.HARDWARE
    startup: tuple[IndexedValue, ...] = ()
    missing: int = 0
    out_of_order: int = 0
    duplicate: int = 0
    not_fired: int = 0
    skipped: int = 0
    period_ns: float | None = None
    clock_step_ns: int | None = None
    in_effect: InEffect | None = None
    incomplete: str | None = None
    undecidable: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def is_usual(self) -> bool:
        """Whether a question that names no series means this one, where its suite has several."""
        return self.main and (self.measure is None or self.measure == measures(self.suite)[0])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SampleSeries:
    """Values in the order of their loops, shape (n,), without the start-up; `index`, shape (n,), is the loop of each.

    `absent` are the loops that did not fire, were skipped, or whose message is missing. All loops are counted from the
    end of the start-up.
    """

    header: Header
    values_ns: Int64s
    index: Int64s
    absent: Int64s

    def figures(self) -> Figures:
        """Figures of the values."""
        return figures_of_samples(self.values_ns, self.index)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HistogramSeries:
    """Counts of values in unknown order, without the start-up values as far as the file identifies them.

    `top` and `lowest` are the values that the file lists with their loop, best first. `absent_count` is the number of
    loops without a value.
    """

    header: Header
    histogram: Histogram
    top: tuple[IndexedValue, ...]
    lowest: tuple[IndexedValue, ...]
    absent_count: int

    def figures(self) -> Figures:
        """Figures of the counts."""
        return figures_of_histogram(self.histogram, top=self.top, lowest=self.lowest)


Series = SampleSeries | HistogramSeries


@dataclass(frozen=True, kw_only=True, slots=True)
class Result:
    """The figures of one series of one output: one row of a table."""

    header: Header
    figures: Figures


def results_of(every_series: Iterable[Series]) -> tuple[Result, ...]:
    """The figures of each series."""
    return tuple(Result(header=series.header, figures=series.figures()) for series in every_series)


def read_file(path: Path, measure: Measure | None = None) -> tuple[Series, ...]:
    """Read every series in a log, or in an npy and the json of its name; `measure` is the one that the question names.

    Raises UsageError as `read_log` and `read_samples` do, and for a file of another kind.
    """
    if path.suffix == ".log":
        from rtrun.results.gnuplot_log import read_log  # takes as long to load as samples to read

        return (series_of_log(read_log(path), measure),)
    if path.suffix in (".npy", ".json"):
        return series_of_samples(read_samples(path), measure)
    raise UsageError(f"{path}: not a run directory, a folder of runs, or a .log, .npy or .json of a suite")


def series_of_samples(samples: Samples, measure: Measure | None = None) -> tuple[SampleSeries, ...]:
    """Every series in samples; the one that a question about `measure` means is the main one.

    Raises UsageError when the suite measures no such thing.
    """
    record = samples.record
    counts = record.counts
    main = samples.judged(measure)
    first = next(iter(samples.columns.values()))
    period_ns = float(int(first[-1]) - int(first[0])) / (first.size - 1) if first.size > 1 else 0.0
    sample_series = []
    named: set[Measure | None] = set()
    for name, values in samples.series.items():
        # A question about "latency" fits two series of a one-shot timer. The first is meant; the second is that of
        # 2014.
        known = None if called(name) in named else called(name)
        named.add(known)
        loops = startup_loops(name) if suite(record.suite).subject == "started" else 0
        absent = values.absent
        head = min(loops - int(np.searchsorted(absent, loops)), values.values_ns.size)
        sample_series.append(
            SampleSeries(
                header=Header(
                    run=printable(samples.path.stem),
                    suite=record.suite,
                    output=samples.path.stem,
                    series=name,
                    measure=known,
                    main=values is main,
                    parameters=record.requested,
                    startup=tuple(
                        IndexedValue(value_ns=int(value), index=int(index))
                        for value, index in zip(values.values_ns[:head], values.index[:head], strict=True)
                    ),
                    missing=counts.missing,
                    out_of_order=counts.out_of_order,
                    duplicate=counts.duplicate,
                    not_fired=counts.not_fired,
                    skipped=max(0, absent.size - counts.missing - counts.not_fired),
                    period_ns=period_ns if period_ns > 0 else period_of(record.requested),
                    clock_step_ns=record.in_effect.clock_step_ns or None,
                    in_effect=record.in_effect,
                    incomplete=None if record.complete else record.incomplete_reason or "no reason given",
                    undecidable=values.undecidable,
                ),
                values_ns=np.ascontiguousarray(values.values_ns[head:]),
                index=values.index[head:],
                absent=absent[absent >= loops] - loops,
            )
        )
    return tuple(sample_series)


def series_of_log(log: "Log", measure: Measure | None = None) -> HistogramSeries:
    """The series in a log.

    A log names the loops of only its ten highest and lowest values. A start-up value among them is separated; a remark
    reports the start-up values that are not. Raises UsageError for a question about something that a log does not hold.
    """
    known = called(log.series) if log.series in MAIN_2014 else None
    try:
        if known is not None and measure is not None and judged(measures(log.suite), measure) != known:
            raise UsageError(f"a log keeps the {known} only: ask for it (--of {known})")
    except UsageError as error:
        raise UsageError(f"{log.path}: {log.suite}: {error}") from None
    loops = startup_loops(log.series)
    listed = {entry.index: entry for entry in (*log.top, *log.lowest) if entry.index is not None}
    startup = tuple(listed[index] for index in range(loops) if index in listed)
    count = log.count.copy()
    for entry in startup:
        count[np.searchsorted(log.value_us, entry.value_ns // 1000)] -= 1
    kept = count > 0
    remarks = log.remarks
    if len(startup) < min(loops, int(log.count.sum())):
        remarks += ("start-up values are not among the listed ones: the figures include them",)
    return HistogramSeries(
        header=Header(
            run=printable(log.path.stem),
            suite=log.suite,
            output=log.path.stem,
            series=log.series,
            measure=known,
            main=known is not None,
            parameters=log.parameters,
            startup=startup,
            missing=log.missing,
            out_of_order=log.out_of_order,
            duplicate=log.duplicate,
            not_fired=log.not_fired,
            period_ns=period_of(log.parameters),
            incomplete=log.incomplete,
            remarks=remarks,
        ),
        histogram=Histogram(values_ns=log.value_us[kept] * 1000, counts=count[kept]),
        top=tuple(entry for entry in log.top if entry not in startup),
        lowest=tuple(entry for entry in log.lowest if entry not in startup),
        absent_count=log.missing + log.not_fired,
    )


def series_of_histogram(imported: "Imported", measure: Measure | None = None) -> HistogramSeries:
    """The series in a histogram of another program. Raises UsageError for a question about its jitter."""
    return HistogramSeries(
        header=_header_of(imported, measure, undecidable=imported.undecidable),
        histogram=imported.histogram,
        top=(),
        lowest=(),
        absent_count=0,
    )


def series_of_imported_samples(imported: "ImportedSamples", measure: Measure | None = None) -> SampleSeries:
    """The series in samples of another program. Raises UsageError for a question about its jitter."""
    values_ns = imported.values_ns
    header = _header_of(imported, measure)
    # cyclictest prints whole microseconds, truncated, unless -N asks for ns.
    if values_ns.size and not np.any(values_ns % _US):
        header = replace(header, clock_step_ns=max(_US, header.clock_step_ns or 1))
    return SampleSeries(
        header=header,
        values_ns=np.ascontiguousarray(values_ns),
        index=np.arange(values_ns.size, dtype=np.int64),
        absent=np.empty(0, dtype=np.int64),
    )


def _header_of(imported: "Imported | ImportedSamples", measure: Measure | None, undecidable: str = "") -> Header:
    try:
        judged(("latency",), measure)
    except UsageError as error:
        raise UsageError(f"{imported.name}: {imported.source} {error}") from None
    return Header(
        run=imported.name,
        suite=imported.source,
        output=imported.name,
        series="latency",
        measure="latency",
        main=True,
        parameters=dict(imported.parameters),
        period_ns=imported.period_ns,
        undecidable=undecidable,
        remarks=tuple(f"not known: {text}" for text in imported.left_out),
    )
