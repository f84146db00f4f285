"""What `rtrun show` prints, and `rtrun run` at its end: banner, table of results, and remarks."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rich.console import Group
from rich.text import Text

from rtfiles.output import counted, print_line, printable
from rtfiles.quantities import time
from rtrun.plan.observation import stream_words
from rtrun.plan.suites import NOT_TELLING, Value, find_suite, options, output_name
from rtrun.report.quantities import times_ns
from rtrun.report.tables import Table
from rtrun.results.rate import OFF_MAX
from rtrun.results.series import MEASURED_2014, NOTE_2014, Header, Result
from rtrun.targets.inspection.platform import Platform, weakest

if TYPE_CHECKING:
    from rtrun.results.reading import ClosedRun, Runs

BANNERS = {
    Platform.EMULATED: "EMULATED: not a real-time statement",
    Platform.VIRTUAL: "VIRTUAL: verdicts are for this virtual machine on this host",
}
NO_PREEMPT_RT = "NO PREEMPT_RT: this kernel promises no deadline"
PREEMPT_RT_IN_PART = "PREEMPT_RT IN PART OF THE RUNS: the kernel of the others promises no deadline"
COARSE_NS = 10_000_000  # from here on a tenth of a microsecond is not worth a column

_SHOWN = ("min", "mean", "max", "p99", "p99.9")
_UNITS = {"timeout_us": "us", "frequency_hz": "Hz", "payload_bytes": "B", "subscribers": "sub"}


def table(results: Sequence[Result]) -> Table:
    """The table of these results, a row each, times in microseconds; it fits into 80 columns."""
    rows = []
    for result, label in zip(results, _labels([result.header for result in results]), strict=True):
        header, figures, times = result.header, result.figures, times_ns(result.figures)
        shown = (_time(times[name], figures.bin_ns) for name in _SHOWN)
        rows.append((*label, str(figures.n), *shown, str(header.missing), str(header.out_of_order)))
    columns = ("suite", "parameters", "n", *(f"{name} us" for name in _SHOWN), "missing", "out of order")
    return Table(columns=columns, rows=rows, numbers=range(2, 10), gap=1)


def _labels(headers: Sequence[Header]) -> list[tuple[str, str]]:
    """Suite and parameters of every row; equal rows are distinguished by the run and the thread."""
    labels = [(_name(header), _parameters(header)) for header in headers]
    rows = Counter(labels)
    rows_of_run = Counter((label, header.run) for label, header in zip(labels, headers, strict=True))
    told_apart = []
    for (name, parameters), header in zip(labels, headers, strict=True):
        words = [parameters] if parameters else []
        of_run = rows_of_run[(name, parameters), header.run]
        if rows[name, parameters] > of_run:
            # A campaign with a goal repeats a run under its name plus the number of the round.
            number = re.fullmatch(r"([0-9]+)-.*?(-r[0-9]+)?", header.run)
            words.append(f"run={''.join(filter(None, number.groups())) if number else header.run}")
        if of_run > 1:
            words.append(f"#{header.output.rpartition('-')[2]}")
        told_apart.append((name, " ".join(words)))
    return told_apart


def _name(header: Header) -> str:
    """The suite; the series only where it is not the main one of the suite."""
    name = stream_words(header.suite, header.parameters)[0] or header.suite.removesuffix("_tests")
    return name if header.is_usual else f"{name} {header.series}"


def _time(value_ns: float | None, bin_ns: int) -> str:
    if value_ns is None:
        return "-"
    digits = 0 if bin_ns >= 1000 or abs(value_ns) >= COARSE_NS else 1
    return f"{round(value_ns / 1000, digits) + 0.0:.{digits}f}"  # + 0.0: no minus sign before a zero


def _parameters(header: Header) -> str:
    """The parameters in a few words: the policy, what the output is named after, and everything but defaults."""
    words: list[str] = []
    for key, value in stream_words(header.suite, header.parameters)[1].items():
        if key == "policy":
            words.insert(0, "OTHER" if value == "0" else str(value))  # as the kernel calls it
        elif key not in NOT_TELLING and value is not None and _is_telling(header.suite, key, value):
            words.append(f"{value}{_UNITS[key]}" if key in _UNITS else f"{key}={value}")
    if header.parameters.get("subscribers", 1) != 1:
        words.append(f"#{header.output.removesuffix(output_name(header.suite, {**header.parameters, 'prefix': ''}))}")
    return " ".join(words)


def _is_telling(suite_name: str, key: str, value: Value) -> bool:
    option, described = options().get(key), find_suite(suite_name)
    # The defaults of another program's options are not known.
    return option is None or described is None or value != option.default or f"{{{key}}}" in described.output


def banner_of(platform: Platform, *, preempt_rt: Iterable[bool] = ()) -> str:
    """The warning before any number, in one line; empty when there is none.

    `preempt_rt` is, for each run, whether its kernel was PREEMPT_RT.
    """
    kernels = set(preempt_rt)
    of_kernels = None if False not in kernels else PREEMPT_RT_IN_PART if True in kernels else NO_PREEMPT_RT
    return "; ".join(filter(None, [BANNERS.get(platform), of_kernels]))


def print_banner(platform: Platform, preempt_rt: Iterable[bool] = ()) -> None:
    """Print the warning about a platform and its kernels, if there is one."""
    if words := banner_of(platform, preempt_rt=preempt_rt):
        print_line(words)


def answer(
    results: Iterable[Result], *, platform: Platform, preempt_rt: Iterable[bool] = (), notes: Iterable[str] = ()
) -> Group:
    """The banner if there is one, the table, and a line for every note and for every remark on a result."""
    results = list(results)
    lines = [*notes, *_startup([result.header for result in results])]
    for result in results:
        lines += [f"{result.header.output}: {remark}" for remark in (*_lost(result.header), *remarks_of(result.header))]
    if any(result.header.series == MEASURED_2014 for result in results):
        lines.append(NOTE_2014)
    if any(0 < result.figures.n < 1000 for result in results):
        lines.append("p99.9 of fewer than 1000 values is their maximum.")
    words = banner_of(platform, preempt_rt=preempt_rt)
    banner = [Text(words, style="bold red")] if words else []
    body = [table(results)] if results else []
    return Group(
        *banner, *body, *(Text(printable(line), no_wrap=True, overflow="ignore") for line in dict.fromkeys(lines))
    )


def _startup(headers: Sequence[Header]) -> list[str]:
    """Start-up values, which no figure includes: a line for each series."""
    lines = []
    started = [header for header in headers if header.startup]
    for series in dict.fromkeys(header.series for header in started):
        of_series = [header for header in started if header.series == series]
        if len(of_series) == 1:
            values = ", ".join(f"{time(value.value_ns)} (loop {value.index})" for value in of_series[0].startup)
            lines.append(f"{of_series[0].output}: {series} start-up apart, in no figure: {values}")
            continue
        values_ns = [value.value_ns for header in of_series for value in header.startup]
        span = f"{time(min(values_ns))} to {time(max(values_ns))}"
        lines.append(f"{series} start-up of {len(of_series)} outputs apart, in no figure: {span}")
    return lines


def _lost(header: Header) -> list[str]:
    """Which measurements no figure includes, one sentence each."""
    lines = []
    if header.not_fired:
        count = header.not_fired
        lines.append(
            "1 timer did not fire, it is in no figure"
            if count == 1
            else f"{count} timers did not fire, they are in no figure"
        )
    if header.skipped and header.main:
        lines.append(f"{counted(header.skipped, 'period')} skipped, in no figure: the timer was too far behind")
    if header.duplicate:
        lines.append(f"{header.duplicate} messages came again, only the first arrival counts")
    return lines


def remarks_of(header: Header) -> list[str]:
    """Why fewer values were measured than requested, and what the file lacks or stated wrongly, one sentence each."""
    return [f"incomplete: {header.incomplete}"] * (header.incomplete is not None) + list(header.remarks)


def answer_of_run(run: "ClosedRun") -> Group:
    """The answer of one run: every series of every output."""
    rates = [f"{name}: {rate.words}" for name, rate in run.record.rates.items()]
    notes = [*_notes(run), *rates]
    return answer(run.results, platform=run.record.platform, preempt_rt=[run.record.preempt_rt], notes=notes)


def answer_of_runs(folder: "Runs") -> Group:
    """The answer of all runs in a folder: a row for every output, and what was not analysed and why."""
    from rtrun.results.record import FILE

    results = [result for run in folder.runs for result in run.results if result.header.main]
    notes = [note for run in folder.runs for note in (*_notes(run), *_not_kept(run))]
    notes += [f"{name}: incomplete: it has no {FILE}, nothing in it is analysed" for name in folder.incomplete]
    return answer(
        results,
        platform=weakest(run.record.platform for run in folder.runs),
        preempt_rt=[run.record.preempt_rt for run in folder.runs],
        notes=notes,
    )


def _notes(run: "ClosedRun") -> list[str]:
    record = run.record
    return [] if record.status == "ok" else [f"{record.run}: {record.status}: {record.reason or 'no reason given'}"]


def _not_kept(run: "ClosedRun") -> list[str]:
    """The rates that the programs of a run missed, one sentence each."""
    rates = run.record.rates.items() if run.record.status == "ok" else ()
    return [
        f"{run.record.run}: {name}: {rate.words}"
        for name, rate in rates
        if rate.off > OFF_MAX or rate.overruns or rate.skipped
    ]
