"""Reader of cyclictest's histograms: the text of ``-h`` and the file of ``--json`` (rt-tests 1.0 to 2.10)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rtfiles.errors import UsageError
from rtfiles.untrusted import lines_of
from rtrun.kinds.limits import CPU_DMA_LATENCY_MAX_US, CPUS_MAX
from rtrun.plan.suites import Value, period_of
from rtrun.plan.topology.rates import cpus_text
from rtrun.results.importers.command_line import Command, read_command
from rtrun.results.importers.counts import (
    NO_INTERVAL,
    NO_ORDER,
    StatedSummary,
    Statistics,
    bins_of,
    check_bins,
    histogram,
    load,
    numbered,
    numbers_in,
    once,
    overflow_of,
    statistics_in,
    whole,
)
from rtrun.results.importers.histogram_file import Imported
from rtrun.results.importers.origin import NOWHERE, FileOrigin, read_origin

NO_UNIT = "whether -N changed the unit: microseconds are assumed"
NO_OPTIONS = "policy, priority, CPUs and other options: runs that do not tell them are taken as alike"
_ROW = re.compile(r"[0-9]+([ \t]+[0-9]+)+", re.ASCII)
_SUMMARY = re.compile(r"# (Total|Min Latencies|Avg Latencies|Max Latencies|Histogram Overflows):(.*)", re.ASCII)
_CYCLES = re.compile(r"# Thread ([0-9]{1,5}):((?:[ \t]+[0-9]+)*)(?:[ \t]+# ([0-9]{1,15}) others)?[ \t]*", re.ASCII)
_ALWAYS = ("Min Latencies", "Avg Latencies", "Max Latencies", "Histogram Overflows")  # 2.9 dropped Total
_CYCLE_NUMBERS = "Histogram Overflow at cycle number"
_HELD = re.compile(r"# /dev/cpu_dma_latency set to ([0-9]{1,10})us", re.ASCII)


@dataclass(frozen=True, kw_only=True, slots=True)
class _TextFacts:
    """What is known of all threads of a file, and a sentence for each thing that is not known."""

    unit_ns: int
    parameters: dict[str, Value]
    left_out: tuple[str, ...] = ()
    origin: FileOrigin = NOWHERE


@dataclass(kw_only=True, slots=True)
class _Text:
    """The parts of a text, in whatever order they came: a column of bins for each thread, and the summary lines."""

    columns: list[dict[int, int]] = field(default_factory=list)
    limit: int = 0  # one more than the last bin
    summary: dict[str, list[int]] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)  # where each summary line stands
    cycles: dict[int, int] = field(default_factory=dict)  # by thread: how many overflows are listed with their cycle
    held_us: int | None = None  # the latency at which idle CPUs were kept awake, where a line states it


def read_text(path: Path, text: str, *, command: str | None = None, unit_ns: int | None = None) -> tuple[Imported, ...]:
    """Read one histogram per thread. `command` is the command line, if known: the text does not state it.

    `unit_ns` is the unit, for a caller that knows only that. Raises UsageError ``file:line: what is wrong``.
    """
    asked = None if command is None else read_command(path, "its command line", command)
    parts = _parts(path, text, asked.limit if asked else None)
    threads = len(parts.summary["Min Latencies"])
    _check_shape(path, parts, threads)
    known = _of_command(asked, threads) if asked else _of_text(parts, threads, unit_ns)
    return tuple(_thread(path, parts, thread, known) for thread in range(threads))


def _of_command(command: Command, threads: int) -> _TextFacts:
    return _TextFacts(unit_ns=1 if command.nanoseconds else 1000, parameters=command.parameters(threads))


def _of_text(parts: _Text, threads: int, unit_ns: int | None) -> _TextFacts:
    """What a text states without its command line: a parameter that it does not state is unknown, not a default."""
    held: dict[str, Value] = {} if parts.held_us is None else {"cpu_dma_latency_us": parts.held_us}
    return _TextFacts(
        unit_ns=unit_ns or 1000,
        parameters={"threads": threads, **held},
        left_out=(NO_INTERVAL, *(() if unit_ns else (NO_UNIT,)), NO_OPTIONS),
    )


def _check_shape(path: Path, parts: _Text, threads: int) -> None:
    """Refuse lines that disagree about the threads, and wrong sums (``-H`` adds them as a last column)."""
    widths = {name: len(values) for name, values in parts.summary.items()}
    columns = widths["Max Latencies"]
    if not parts.columns and "Total" not in parts.summary:  # since 2.9 empty rows are left out
        parts.columns = [{} for _ in range(columns)]
    if "Total" not in parts.summary and threads == columns == 1 and len(parts.columns) == 2:
        # -H of one thread: since 2.9 its rows have a sum, but the lines below them do not.
        if parts.columns[0] != parts.columns[1]:
            raise UsageError(f"{path}:{parts.lines['Histogram']}: the last column is not the sum of the 1 threads")
        del parts.columns[1]
    place = f"{path}:{parts.lines['Max Latencies']}"
    expected = dict.fromkeys(widths, columns) | {"Min Latencies": threads, "Avg Latencies": threads}
    if not 0 < threads <= columns <= threads + 1 or widths != expected or len(parts.columns) != columns:
        numbers = ", ".join(f"{count} in {name}" for name, count in widths.items())
        raise UsageError(f"{place}: the number of threads differs: {len(parts.columns)} columns of bins, {numbers}")
    for thread in range(threads):
        listed, overflow = parts.cycles.get(thread), parts.summary["Histogram Overflows"][thread]
        if listed is None:
            raise UsageError(f"{path}: cut off: no line # Thread {thread}: below # Histogram Overflow at cycle number:")
        if listed != overflow:
            place = f"{path}:{parts.lines[f'Thread {thread}']}"
            raise UsageError(f"{place}: # Thread {thread}: lists {listed} overflows, # Histogram Overflows: {overflow}")
    if len(parts.cycles) != threads:
        raise UsageError(f"{path}: {len(parts.cycles)} lines # Thread N:, but {threads} threads")
    if columns == threads:
        return
    sums: dict[int, int] = {}
    for column in parts.columns[:threads]:
        for value, count in column.items():
            sums[value] = sums.get(value, 0) + count
    if sums != parts.columns[threads]:
        raise UsageError(f"{place}: the last column is not the sum of the {threads} threads")
    for name in ("Total", "Histogram Overflows", "Max Latencies"):
        *values, last = parts.summary.get(name, [0])
        if last != (max(values) if name == "Max Latencies" else sum(values)):
            raise UsageError(f"{path}:{parts.lines[name]}: {name}: {last} does not sum up the threads")


def _parts(path: Path, text: str, limit: int | None) -> _Text:
    parts, started, number, rows, gap, bins = _Text(), False, 0, 0, 0, 0
    for number, raw in enumerate(lines_of(text, str(path)), start=1):
        line = raw.rstrip()
        if line.startswith("# Histogram") and ":" not in line:
            once(path, parts.lines, "Histogram", number)
            started = True
        elif match := _HELD.fullmatch(line):
            once(path, parts.lines, "/dev/cpu_dma_latency", number)
            (parts.held_us,) = numbers_in(path, number, match[1])
            if parts.held_us > CPU_DMA_LATENCY_MAX_US:
                raise UsageError(f"{path}:{number}: expected at most {CPU_DMA_LATENCY_MAX_US} us")
        elif match := _SUMMARY.fullmatch(line):
            once(path, parts.lines, match[1], number)
            parts.summary[match[1]] = numbers_in(path, number, match[2])
        elif line == f"# {_CYCLE_NUMBERS}:":
            once(path, parts.lines, _CYCLE_NUMBERS, number)
        elif match := _CYCLES.fullmatch(line):
            once(path, parts.lines, f"Thread {int(match[1])}", number)
            parts.cycles[int(match[1])] = len(match[2].split()) + int(match[3] or 0)
        elif started and line and not line.startswith("#"):
            if not _ROW.fullmatch(line):
                raise UsageError(f"{path}:{number}: expected a bin, 'value count count ...', got {line[:40]!r}")
            value, *counts = numbers_in(path, number, line)
            parts.columns = parts.columns or [{} for _ in counts]
            if len(counts) != len(parts.columns):
                raise UsageError(f"{path}:{number}: {len(counts)} counts, {len(parts.columns)} before")
            if value < parts.limit:
                raise UsageError(f"{path}:{number}: {value} does not rise")
            if limit is not None and value >= limit:
                raise UsageError(f"{path}:{number}: a bin of {value}, but the histogram ends below {limit}")
            gap = gap or (number if value != rows else 0)
            rows, parts.limit = rows + 1, value + 1
            for column, count in zip(parts.columns, counts, strict=True):
                if count:
                    column[value] = count
                    bins += 1
            check_bins(path, bins)
    if not started or (not parts.columns and "Total" in parts.summary):
        raise UsageError(f"{path}:{number}: cut off: no bins")
    for name in (*_ALWAYS, _CYCLE_NUMBERS):
        if name not in parts.lines:
            raise UsageError(f"{path}:{number}: cut off: no line # {name}:")
    if "Total" in parts.summary and gap:
        raise UsageError(f"{path}:{gap}: a row is missing before this one: where # Total: is printed, all rows are")
    if "Total" in parts.summary and limit is not None and rows != limit:
        raise UsageError(f"{path}:{number}: cut off: {rows} rows of bins, the command line asks for {limit}")
    parts.limit = parts.limit if limit is None else limit
    return parts


def _thread(path: Path, parts: _Text, thread: int, known: _TextFacts) -> Imported:
    bins = parts.columns[thread]
    seen = sum(bins.values())
    if "Total" in parts.summary and (total := parts.summary["Total"][thread]) != seen:
        place = f"{path}:{parts.lines['Total']}"
        raise UsageError(f"{place}: thread {thread}: a total of {total}, but the bins hold {seen}")
    least, mean, most = (
        StatedSummary(place=f"{path}:{parts.lines[name]}: thread {thread}", value=parts.summary[name][thread])
        for name in ("Min Latencies", "Avg Latencies", "Max Latencies")
    )
    return _imported(
        str(thread),
        bins,
        known,
        Statistics(least=least, mean=mean, most=most),
        overflow=parts.summary["Histogram Overflows"][thread],
        limit=parts.limit,
    )


def _imported(
    thread: str,
    bins: dict[int, int],
    known: _TextFacts,
    printed: Statistics,
    *,
    overflow: int,
    limit: int,
) -> Imported:
    unit = "ns" if known.unit_ns == 1 else "us"
    left_out = [NO_ORDER, *known.left_out]
    if overflow:
        left_out.append(f"{overflow} values of {limit} {unit} and more: only counted, the largest is known")
    return Imported(
        source="cyclictest",
        name=f"cyclictest-t{thread}",
        histogram=histogram(bins, printed, unit_ns=known.unit_ns, overflow=overflow, limit=limit),
        period_ns=period_of(known.parameters),
        left_out=tuple(left_out),
        parameters=known.parameters,
        unit_ns=known.unit_ns,
        origin=known.origin,
    )


def _cpus(path: Path, threads: Mapping[str, Mapping[str, Any]]) -> dict[str, Value]:
    """The CPUs that the threads were bound to, "" for none; empty where the file does not state them."""
    cpus = [thread.get("cpu") for thread in threads.values()]
    if None in cpus:
        return {}
    for name, cpu in zip(threads, cpus, strict=True):
        if isinstance(cpu, bool) or not isinstance(cpu, int) or not -1 <= cpu < CPUS_MAX:
            raise UsageError(f"{path}: thread.{name}.cpu: expected -1 to {CPUS_MAX - 1}, got {str(cpu)[:40]!r}")
    return {"cpu": cpus_text({cpu for cpu in cpus if isinstance(cpu, int) and cpu >= 0})}


def read_json_results(path: Path, text: str) -> tuple[Imported, ...] | None:
    """Read one histogram per thread; None when the file is not from cyclictest, or was written without ``-h``.

    Raises UsageError naming file and key.
    """
    data = load(path, text)
    key = next((key for key in ("cmdline:", "cmdline") if isinstance(data.get(key), str)), None)
    words = data[key] if key else ""
    threads: Any = data.get("thread")
    if not isinstance(threads, dict) or key is None or not re.match(r"(?:\S*/)?cyclictest(?:\s|$)", words):
        return None
    command = read_command(path, key, words)
    by_number = numbered(path, "thread", threads)
    if command.limit is None and not any(thread.get("histogram") for thread in by_number.values()):
        return None
    if (number := whole(path, "num_threads", data.get("num_threads"))) != len(by_number):
        raise UsageError(f"{path}: num_threads: {number}, but thread has {len(by_number)}")
    if (unit := whole(path, "resolution_in_ns", data.get("resolution_in_ns"))) != int(command.nanoseconds):
        asked = "nanoseconds (-N), expected 1" if command.nanoseconds else "microseconds (no -N), expected 0"
        raise UsageError(f"{path}: resolution_in_ns: {unit}, but its command line asks for {asked}")
    known = _of_command(command, number)
    known = replace(known, parameters=known.parameters | _cpus(path, by_number), origin=read_origin(path, data))
    imported = []
    for name, thread in by_number.items():
        where = f"thread.{name}"
        if "histogram" not in thread:
            raise UsageError(f"{path}: {where}.histogram: missing, run cyclictest with --histogram=US")
        bins = bins_of(path, f"{where}.histogram", thread["histogram"], limit=command.limit)
        imported.append(
            _imported(
                name,
                bins,
                known,
                statistics_in(path, where, thread),
                overflow=overflow_of(path, f"{where}.cycles", thread.get("cycles"), bins),
                # Without the option, nothing is known beyond the last filled bin.
                limit=max(bins, default=-1) + 1 if command.limit is None else command.limit,
            )
        )
    return tuple(imported)
