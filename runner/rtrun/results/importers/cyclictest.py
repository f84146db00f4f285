"""Reader of cyclictest's histograms: the text of ``-h`` and the file of ``--json`` (rt-tests 1.0 to 2.10)."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rtfiles.errors import UsageError
from rtfiles.untrusted import lines_of
from rtrun.results.importers.counts import (
    NO_ORDER,
    bins_of,
    check_bins,
    check_statistics,
    histogram,
    load,
    mean_of,
    numbered,
    numbers_in,
    whole,
)
from rtrun.results.importers.histogram_file import Imported

_ROW = re.compile(r"[0-9]+([ \t]+[0-9]+)+", re.ASCII)
_SUMMARY = re.compile(r"# (Total|Min Latencies|Avg Latencies|Max Latencies|Histogram Overflows):(.*)", re.ASCII)
_CYCLES = re.compile(r"# Thread ([0-9]{1,5}):((?:[ \t]+[0-9]+)*)(?:[ \t]+# ([0-9]{1,15}) others)?[ \t]*", re.ASCII)
_ALWAYS = ("Min Latencies", "Avg Latencies", "Max Latencies", "Histogram Overflows")  # 2.9 dropped Total
_LIMIT_OPTION = re.compile(r"(?:^|\s)(?:-h|-H|--histogram|--histofall)[= ]?([0-9]{1,9})(?=\s|$)")
_INTERVAL_OPTION = re.compile(r"(?:^|\s)(?:-i|--interval)[= ]?([0-9]{1,9})(?=\s|$)")


@dataclass(kw_only=True, slots=True)
class _Text:
    """The parts of a text, in whatever order they stand: a column of bins for each thread, and lines of the summary."""

    columns: list[dict[int, int]] = field(default_factory=list)
    limit: int = 0  # one more than the last bin
    summary: dict[str, list[int]] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)  # where each line of the summary stands
    cycles: dict[int, int] = field(default_factory=dict)  # by thread: how many overflows are listed by their cycle


def read_text(path: Path, text: str, *, interval_us: int | None = None) -> tuple[Imported, ...]:
    """One histogram a thread. `interval_us` is the interval where the caller set it; the text does not tell it.

    Raises UsageError ``file:line: what is wrong``.
    """
    parts = _parts(path, text)
    threads = len(parts.summary["Min Latencies"])
    _check_shape(path, parts, threads)
    return tuple(_thread(path, parts, thread, interval_us) for thread in range(threads))


def _check_shape(path: Path, parts: _Text, threads: int) -> None:
    """Refuse lines that disagree about the threads, and sums (of ``-H``, in a last column) that are none."""
    widths = {name: len(values) for name, values in parts.summary.items()}
    columns = widths["Max Latencies"]
    if not parts.columns and "Total" not in parts.summary:  # since 2.9 empty rows are left out
        parts.columns = [{} for _ in range(columns)]
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
            raise UsageError(f"{path}: # Thread {thread}: lists {listed} overflows, # Histogram Overflows: {overflow}")
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


def _parts(path: Path, text: str) -> _Text:
    parts, started, number, bins = _Text(), False, 0, 0
    for number, raw in enumerate(lines_of(text, str(path)), start=1):
        line = raw.rstrip()
        if line.startswith("# Histogram") and ":" not in line:
            started = True
        elif match := _SUMMARY.fullmatch(line):
            parts.summary[match[1]] = numbers_in(path, number, match[2])
            parts.lines[match[1]] = number
        elif match := _CYCLES.fullmatch(line):
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
            parts.limit = value + 1
            for column, count in zip(parts.columns, counts, strict=True):
                if count:
                    column[value] = count
                    bins += 1
            check_bins(path, bins)
    if not started or (not parts.columns and "Total" in parts.summary):
        raise UsageError(f"{path}:{number}: cut off: no bins")
    for name in _ALWAYS:
        if name not in parts.summary:
            raise UsageError(f"{path}:{number}: cut off: no line # {name}:")
    return parts


def _thread(path: Path, parts: _Text, thread: int, interval_us: int | None) -> Imported:
    bins = parts.columns[thread]
    seen = sum(bins.values())
    if "Total" in parts.summary and (total := parts.summary["Total"][thread]) != seen:
        place = f"{path}:{parts.lines['Total']}"
        raise UsageError(f"{place}: thread {thread}: a total of {total}, but the bins hold {seen}")
    least, mean, most, overflow = (parts.summary[name][thread] for name in _ALWAYS)
    check_statistics(
        f"{path}:{parts.lines['Max Latencies']}: thread {thread}",
        bins,
        overflow=overflow,
        limit=parts.limit,
        least=least,
        mean=mean,
        most=most,
    )
    left_out = [NO_ORDER]
    if interval_us is None:
        left_out.append("the interval, and whether -N changed the unit: microseconds are assumed")
    if overflow:
        left_out.append(f"{overflow} values of {parts.limit} us and more: only counted, the largest is known")
    return Imported(
        source="cyclictest",
        name=f"cyclictest-t{thread}",
        histogram=histogram(
            bins,
            unit_ns=1000,
            width=1,
            overflow=overflow,
            overflow_from=parts.limit,
            max_value=most,
            mean_value=mean,
        ),
        period_ns=None if interval_us is None else 1000.0 * interval_us,
        left_out=tuple(left_out),
        parameters={},
    )


def read_json_results(path: Path, text: str) -> tuple[Imported, ...] | None:
    """One histogram a thread; None when the file is not cyclictest's. Raises UsageError naming file and place."""
    data = load(path, text)
    command = next((data[key] for key in ("cmdline:", "cmdline") if isinstance(data.get(key), str)), "")
    threads: Any = data.get("thread")
    if not isinstance(threads, dict) or "cyclictest" not in command:
        return None
    nanoseconds = data.get("resolution_in_ns") == 1 or re.search(r"\s(-N|--nsecs)(\s|$)", command) is not None
    unit = 1 if nanoseconds else 1000
    asked = _LIMIT_OPTION.search(command)
    interval = _INTERVAL_OPTION.search(command)
    imported = []
    for name, thread in numbered(path, "thread", threads).items():
        where = f"thread.{name}"
        bins = bins_of(path, f"{where}.histogram", thread.get("histogram", {}))
        cycles, most = (
            whole(path, f"{where}.cycles", thread.get("cycles")),
            whole(path, f"{where}.max", thread.get("max")),
        )
        overflow = cycles - sum(bins.values())
        if overflow < 0:
            raise UsageError(f"{path}: {where}.cycles: {cycles}, but the bins hold {sum(bins.values())}")
        # Without the option the last filled bin is where knowledge ends.
        limit = int(asked[1]) if asked else max(bins, default=-1) + 1
        left_out = [NO_ORDER]
        if overflow:
            left_out.append(
                f"{overflow} values of {limit} {'ns' if unit == 1 else 'us'} and more: only the largest is known"
            )
        imported.append(
            Imported(
                source="cyclictest",
                name=f"cyclictest-t{name}",
                histogram=histogram(
                    bins,
                    unit_ns=unit,
                    width=1,
                    overflow=overflow,
                    overflow_from=limit,
                    max_value=most,
                    mean_value=mean_of(path, f"{where}.avg", thread.get("avg")),
                ),
                period_ns=(1000.0 * int(interval[1]) if interval else 1e6) or None,
                left_out=tuple(left_out),
                parameters={},
            )
        )
    return tuple(imported)
