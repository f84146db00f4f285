"""Reader of cyclictest's histograms: the text of ``-h`` and the file of ``--json`` (rt-tests 1.0 to 2.x)."""

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
_LIMIT_OPTION = re.compile(r"(?:^|\s)(?:-h|-H|--histogram|--histofall)[= ]?([0-9]{1,9})(?=\s|$)")
_INTERVAL_OPTION = re.compile(r"(?:^|\s)(?:-i|--interval)[= ]?([0-9]{1,9})(?=\s|$)")


@dataclass(kw_only=True, slots=True)
class _Text:
    """The parts of a text, in whatever order they stand: a column of bins for each thread, and lines of the summary."""

    columns: list[dict[int, int]] = field(default_factory=list)
    limit: int = 0  # one more than the last bin
    summary: dict[str, list[int]] = field(default_factory=dict)
    line_of_totals: int = 0

    def of_thread(self, name: str, thread: int) -> int | None:
        values = self.summary.get(name, [])
        return values[thread] if thread < len(values) else None


def read_text(path: Path, text: str, *, interval_us: int | None = None) -> tuple[Imported, ...]:
    """One histogram a thread. `interval_us` is the interval where the caller set it; the text does not tell it.

    Raises UsageError ``file:line: what is wrong``.
    """
    parts = _parts(path, text)
    totals = parts.summary["Total"]
    # With -H the last column sums up the others.
    threads = len(parts.summary.get("Max Latencies", totals))
    if not 0 < threads <= min(len(parts.columns), len(totals)):
        raise UsageError(
            f"{path}:{parts.line_of_totals}: {threads} threads in the summary, {len(parts.columns)} columns of bins, "
            f"{len(totals)} totals"
        )
    return tuple(_thread(path, parts, thread, interval_us) for thread in range(threads))


def _parts(path: Path, text: str) -> _Text:
    parts, started, number, bins = _Text(), False, 0, 0
    for number, raw in enumerate(lines_of(text, str(path)), start=1):
        line = raw.rstrip()
        if line.startswith("# Histogram") and ":" not in line:
            started = True
        elif match := _SUMMARY.fullmatch(line):
            parts.summary[match[1]] = numbers_in(path, number, match[2])
            parts.line_of_totals = number if match[1] == "Total" else parts.line_of_totals
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
    if not parts.columns or "Total" not in parts.summary:
        raise UsageError(f"{path}:{number}: cut off: no {'bins' if not parts.columns else 'line # Total:'}")
    return parts


def _thread(path: Path, parts: _Text, thread: int, interval_us: int | None) -> Imported:
    bins, total = parts.columns[thread], parts.summary["Total"][thread]
    seen = sum(bins.values())
    if total != seen:
        place = f"{path}:{parts.line_of_totals}"
        raise UsageError(f"{place}: thread {thread}: a total of {total}, but the bins hold {seen}")
    overflow = parts.of_thread("Histogram Overflows", thread) or 0
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
            max_value=parts.of_thread("Max Latencies", thread),
            mean_value=parts.of_thread("Avg Latencies", thread),
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
