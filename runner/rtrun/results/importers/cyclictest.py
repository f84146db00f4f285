"""Reader of cyclictest's histograms: the text of ``-h`` and the file of ``--json`` (rt-tests 1.0 to 2.x)."""

import re
from pathlib import Path
from typing import Any

from rtfiles.errors import UsageError
from rtrun.results.importers.counts import NO_ORDER, bins_of, histogram, load, whole
from rtrun.results.importers.histogram_file import Imported

_ROW = re.compile(r"([0-9]{1,15})[ \t]+([0-9]{1,15}(?:[ \t]+[0-9]{1,15})*)[ \t]*", re.ASCII)
_SUMMARY = re.compile(r"# (Total|Min Latencies|Avg Latencies|Max Latencies|Histogram Overflows):([ \t0-9]*)", re.ASCII)
_LIMIT_OPTION = re.compile(r"(?:^|\s)(?:-h|-H|--histogram|--histofall)[= ]?([0-9]{1,9})(?=\s|$)")
_INTERVAL_OPTION = re.compile(r"(?:^|\s)(?:-i|--interval)[= ]?([0-9]{1,9})(?=\s|$)")


def read_text(path: Path, text: str) -> tuple[Imported, ...]:
    """One histogram a thread. Raises UsageError ``file:line: what is wrong``."""
    columns: list[dict[int, int]] = []
    summary: dict[str, tuple[list[int], int]] = {}
    limit, started, number = 0, False, 0
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("# Histogram") and ":" not in line:
            started = True
        elif found := _SUMMARY.fullmatch(line):
            summary[found[1]] = ([int(word) for word in found[2].split()], number)
        elif started and line and not line.startswith("#"):
            row = _ROW.fullmatch(line)
            if summary or not row:
                raise UsageError(f"{path}:{number}: expected a bin, 'value count count ...', got {line[:40]!r}")
            value, counts = int(row[1]), [int(word) for word in row[2].split()]
            columns = columns or [{} for _ in counts]
            if len(counts) != len(columns) or value < limit:
                wrong = f"{len(counts)} counts, {len(columns)} before" if value >= limit else f"{value} does not rise"
                raise UsageError(f"{path}:{number}: {wrong}")
            limit = value + 1
            for column, count in zip(columns, counts, strict=True):
                column[value] = count
    if not columns or "Total" not in summary:
        raise UsageError(f"{path}:{number}: cut off: no {'bins' if not columns else 'line # Total:'}")
    totals, line_of_totals = summary["Total"]
    # With -H the last column sums up the others.
    threads = len(summary["Max Latencies"][0]) if "Max Latencies" in summary else len(totals)
    if not 0 < threads <= min(len(columns), len(totals)):
        raise UsageError(
            f"{path}:{line_of_totals}: {threads} threads in the summary, {len(columns)} columns of bins, "
            f"{len(totals)} totals"
        )
    found_threads = []
    for k in range(threads):
        seen = sum(columns[k].values())
        if totals[k] != seen:
            raise UsageError(f"{path}:{line_of_totals}: thread {k}: a total of {totals[k]}, but the bins hold {seen}")
        overflow, most = _at(summary, "Histogram Overflows", k) or 0, _at(summary, "Max Latencies", k)
        left_out = [NO_ORDER, "the interval, and whether -N changed the unit: microseconds are assumed"]
        if overflow:
            left_out.append(f"{overflow} values of {limit} us and more: only counted, the largest is known")
        found_threads.append(
            Imported(
                source="cyclictest",
                name=f"cyclictest-t{k}",
                histogram=histogram(
                    columns[k], unit_ns=1000, width=1, overflow=overflow, overflow_from=limit, max_value=most
                ),
                period_ns=None,
                left_out=tuple(left_out),
                parameters={},
            )
        )
    return tuple(found_threads)


def _at(summary: dict[str, tuple[list[int], int]], name: str, k: int) -> int | None:
    values = summary.get(name, ([], 0))[0]
    return values[k] if k < len(values) else None


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
    found = []
    for name, thread in threads.items():
        where = f"thread.{name[:20]}"
        if not isinstance(thread, dict):
            raise UsageError(f"{path}: {where}: expected a mapping")
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
        found.append(
            Imported(
                source="cyclictest",
                name=f"cyclictest-t{name}",
                histogram=histogram(
                    bins, unit_ns=unit, width=1, overflow=overflow, overflow_from=limit, max_value=most
                ),
                period_ns=1000.0 * int(interval[1]) if interval else 1e6,
                left_out=tuple(left_out),
                parameters={},
            )
        )
    return tuple(found)
