"""Reader of cyclictest's histograms: the text of ``-h`` and the file of ``--json`` (rt-tests 1.0 to 2.10)."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rtfiles.errors import UsageError
from rtfiles.untrusted import lines_of
from rtrun.results.importers.counts import (
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

_ROW = re.compile(r"[0-9]+([ \t]+[0-9]+)+", re.ASCII)
_SUMMARY = re.compile(r"# (Total|Min Latencies|Avg Latencies|Max Latencies|Histogram Overflows):(.*)", re.ASCII)
_CYCLES = re.compile(r"# Thread ([0-9]{1,5}):((?:[ \t]+[0-9]+)*)(?:[ \t]+# ([0-9]{1,15}) others)?[ \t]*", re.ASCII)
_ALWAYS = ("Min Latencies", "Avg Latencies", "Max Latencies", "Histogram Overflows")  # 2.9 dropped Total
_CYCLE_NUMBERS = "Histogram Overflow at cycle number"
_MOST_BINS = 1_000_000  # no limit of ours: cyclictest takes more as this
# Short options without a value may stand before one in the same word, as in -qh400.
_SHORT = r"(?:^|\s)-[BCEfImMnNPqrRsSuUvwWX]*"
_BINS_OPTION = re.compile(rf"(?:{_SHORT}[hH]|\s--hist(?:ogram|ofall)[= ])\s?([0-9]{{1,9}})(?=\s|$)", re.ASCII)
_INTERVAL_OPTION = re.compile(rf"(?:{_SHORT}i|\s--interval[= ])\s?([0-9]{{1,9}})(?=\s|$)", re.ASCII)
_NANOSECONDS_OPTION = re.compile(rf"{_SHORT}N|\s--ns(?:ecs?|e)?(?=\s|$)", re.ASCII)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Command:
    """What a command line of cyclictest tells about its histogram."""

    limit: int | None = None  # one more than its last bin
    interval_us: int | None = None
    nanoseconds: bool = False


def _read_command(words: str) -> _Command:
    # Of an option that is given twice, cyclictest takes the last one.
    limits, intervals = _BINS_OPTION.findall(words), _INTERVAL_OPTION.findall(words)
    return _Command(
        limit=min(int(limits[-1]), _MOST_BINS) if limits else None,
        interval_us=int(intervals[-1]) if intervals else 1000,
        nanoseconds=_NANOSECONDS_OPTION.search(words) is not None,
    )


@dataclass(kw_only=True, slots=True)
class _Text:
    """The parts of a text, in whatever order they stand: a column of bins for each thread, and lines of the summary."""

    columns: list[dict[int, int]] = field(default_factory=list)
    limit: int = 0  # one more than the last bin
    summary: dict[str, list[int]] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)  # where each line of the summary stands
    cycles: dict[int, int] = field(default_factory=dict)  # by thread: how many overflows are listed by their cycle


def read_text(path: Path, text: str, *, command: str | None = None) -> tuple[Imported, ...]:
    """One histogram a thread. `command` is the command line where the caller knows it; the text does not tell it.

    Raises UsageError ``file:line: what is wrong``.
    """
    known = None if command is None else _read_command(command)
    parts = _parts(path, text, known.limit if known else None)
    threads = len(parts.summary["Min Latencies"])
    _check_shape(path, parts, threads)
    return tuple(_thread(path, parts, thread, known) for thread in range(threads))


def _check_shape(path: Path, parts: _Text, threads: int) -> None:
    """Refuse lines that disagree about the threads, and sums (of ``-H``, in a last column) that are none."""
    widths = {name: len(values) for name, values in parts.summary.items()}
    columns = widths["Max Latencies"]
    if not parts.columns and "Total" not in parts.summary:  # since 2.9 empty rows are left out
        parts.columns = [{} for _ in range(columns)]
    if "Total" not in parts.summary and threads == columns == 1 and len(parts.columns) == 2:
        # -H of one thread: since 2.9 its rows have a sum, the lines below them none.
        if parts.columns[0] != parts.columns[1]:
            raise UsageError(f"{path}:{parts.lines['Histogram']}: the last column is not the sum of the 1 threads")
        del parts.columns[1]
    place = f"{path}:{parts.lines['Max Latencies']}"
    expected = dict.fromkeys(widths, columns) | {"Min Latencies": threads, "Avg Latencies": threads}
    if not 0 < threads <= columns <= threads + 1 or widths != expected or len(parts.columns) != columns:
        told = ", ".join(f"{count} in {name}" for name, count in widths.items())
        raise UsageError(f"{place}: the number of threads differs: {len(parts.columns)} columns of bins, {told}")
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
        *each, last = parts.summary.get(name, [0])
        if last != (max(each) if name == "Max Latencies" else sum(each)):
            raise UsageError(f"{path}:{parts.lines[name]}: {name}: {last} does not sum up the threads")


def _parts(path: Path, text: str, limit: int | None) -> _Text:
    parts, started, number, rows, gap, bins = _Text(), False, 0, 0, 0, 0
    for number, raw in enumerate(lines_of(text, str(path)), start=1):
        line = raw.rstrip()
        if line.startswith("# Histogram") and ":" not in line:
            once(path, parts.lines, "Histogram", number)
            started = True
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


def _thread(path: Path, parts: _Text, thread: int, command: _Command | None) -> Imported:
    bins = parts.columns[thread]
    seen = sum(bins.values())
    if "Total" in parts.summary and (total := parts.summary["Total"][thread]) != seen:
        place = f"{path}:{parts.lines['Total']}"
        raise UsageError(f"{place}: thread {thread}: a total of {total}, but the bins hold {seen}")
    least, mean, most = (
        StatedSummary(place=f"{path}:{parts.lines[name]}: thread {thread}", value=parts.summary[name][thread])
        for name in ("Min Latencies", "Avg Latencies", "Max Latencies")
    )
    unknown = [] if command else ["the interval, and whether -N changed the unit: microseconds are assumed"]
    return _imported(
        str(thread),
        bins,
        command or _Command(),
        Statistics(least=least, mean=mean, most=most),
        overflow=parts.summary["Histogram Overflows"][thread],
        limit=parts.limit,
        unknown=unknown,
    )


def _imported(
    thread: str,
    bins: dict[int, int],
    command: _Command,
    printed: Statistics,
    *,
    overflow: int,
    limit: int,
    unknown: Sequence[str] = (),
) -> Imported:
    unit = "ns" if command.nanoseconds else "us"
    left_out = [NO_ORDER, *unknown]
    if overflow:
        left_out.append(f"{overflow} values of {limit} {unit} and more: only counted, the largest is known")
    return Imported(
        source="cyclictest",
        name=f"cyclictest-t{thread}",
        histogram=histogram(bins, printed, unit_ns=1 if command.nanoseconds else 1000, overflow=overflow, limit=limit),
        period_ns=1000.0 * command.interval_us if command.interval_us else None,
        left_out=tuple(left_out),
        parameters={},
    )


def read_json_results(path: Path, text: str) -> tuple[Imported, ...] | None:
    """One histogram a thread; None when the file is not cyclictest's, or of one without ``-h``.

    Raises UsageError naming file and key.
    """
    data = load(path, text)
    words = next((data[key] for key in ("cmdline:", "cmdline") if isinstance(data.get(key), str)), "")
    threads: Any = data.get("thread")
    if not isinstance(threads, dict) or not re.match(r"(?:\S*/)?cyclictest(?:\s|$)", words):
        return None
    command = _read_command(words)
    by_number = numbered(path, "thread", threads)
    if command.limit is None and not any(each.get("histogram") for each in by_number.values()):
        return None
    if (number := whole(path, "num_threads", data.get("num_threads"))) != len(by_number):
        raise UsageError(f"{path}: num_threads: {number}, but thread has {len(by_number)}")
    if (unit := whole(path, "resolution_in_ns", data.get("resolution_in_ns"))) != int(command.nanoseconds):
        asked = "nanoseconds (-N), expected 1" if command.nanoseconds else "microseconds (no -N), expected 0"
        raise UsageError(f"{path}: resolution_in_ns: {unit}, but its command line asks for {asked}")
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
                command,
                statistics_in(path, where, thread),
                overflow=overflow_of(path, f"{where}.cycles", thread.get("cycles"), bins),
                # Without the option the last filled bin is where knowledge ends.
                limit=max(bins, default=-1) + 1 if command.limit is None else command.limit,
            )
        )
    return tuple(imported)
