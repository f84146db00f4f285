"""Reader of the text of ``rtla timerlat hist`` (Linux tools 5.17 and later)."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.untrusted import lines_of
from rtrun.results.importers.counts import (
    NO_INTERVAL,
    NO_ORDER,
    StatedSummary,
    Statistics,
    check_bins,
    histogram,
    once,
)
from rtrun.results.importers.histogram_file import Imported

_COLUMN = re.compile(r"(IRQ|Thr|Usr)-[0-9]{3,5}", re.ASCII)
_CONTEXTS = {"IRQ": "interrupt", "Thr": "thread", "Usr": "user"}
_UNITS = {"# Time unit is nanoseconds (ns)": 1, "# Time unit is microseconds (us)": 1000}
_HEADER = ("# RTLA timerlat histogram", "# Duration:")
_OF_ALL = ("count:", "min:", "avg:", "max:")
_FIELDS = ("over:", *_OF_ALL)
_NUMBER = re.compile(r"[0-9]{1,15}", re.ASCII)


@dataclass(kw_only=True, slots=True)
class _TimerlatText:
    """The parts of a text: bins and a summary for each column; newer versions add a summary of all CPUs."""

    unit_ns: int = 1000
    columns: list[str] = field(default_factory=list)
    rows: list[tuple[int, list[int]]] = field(default_factory=list)
    summary: dict[str, list[int | None]] = field(default_factory=dict)
    contexts: list[str] | None = None  # the columns of the summary of all CPUs
    of_all: dict[str, list[int | None]] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)  # where each line stands, except those of the bins


def read_text(path: Path, text: str) -> tuple[Imported, ...]:
    """Read one histogram per column (a context on a CPU). Raises UsageError ``file:line: what is wrong``."""
    parts = _parts(path, text)
    # The bucket size (-b) is not printed, but every index is a multiple of it.
    width = reduce(math.gcd, (value for value, _ in parts.rows), 0)
    if not width:  # only the first bucket is filled: it holds every maximum of a column without overflow
        inside = zip(parts.summary["max:"], parts.summary["over:"], strict=True)
        width = 1 + max((most or 0 for most, over in inside if not over), default=0)
    columns = tuple(_column(path, parts, k, width) for k in range(len(parts.columns)))
    for k, context in enumerate(parts.contexts or ()):
        _check_of_all(path, parts, k, context)
    return columns


def _parts(path: Path, text: str) -> _TimerlatText:
    parts, number = _TimerlatText(), 0
    for number, line in enumerate(lines_of(text, str(path)), start=1):
        words = line.split()
        if line.startswith(_HEADER):
            once(path, parts.lines, next(name for name in _HEADER if line.startswith(name)), number)
        elif line.startswith("# Time unit"):
            once(path, parts.lines, "# Time unit", number)
            if line.rstrip() not in _UNITS:
                raise UsageError(f"{path}:{number}: expected one of {', '.join(_UNITS)}, got {line[:60]!r}")
            parts.unit_ns = _UNITS[line.rstrip()]
        elif words[:1] == ["Index"]:
            once(path, parts.lines, "Index", number)
            parts.columns = words[1:]
            if not parts.columns or not all(_COLUMN.fullmatch(word) for word in parts.columns):
                raise UsageError(f"{path}:{number}: expected columns IRQ-000, Thr-000 or Usr-000")
            if len(set(parts.columns)) < len(parts.columns):
                raise UsageError(f"{path}:{number}: a column stands twice")
        elif words[:1] == ["ALL:"]:
            once(path, parts.lines, "ALL:", number)
            parts.contexts = words[1:]
        elif parts.columns and words and words[0] in _FIELDS:
            _summarise(path, parts, number, words)
        elif parts.columns and words and _NUMBER.fullmatch(words[0]) and "over:" not in parts.lines:
            _expect(path, number, len(words) - 1, len(parts.columns))
            if not all(_NUMBER.fullmatch(word) for word in words):
                raise UsageError(f"{path}:{number}: expected whole numbers, got {line.strip()[:40]!r}")
            if parts.rows and int(words[0]) <= parts.rows[-1][0]:
                raise UsageError(f"{path}:{number}: {words[0]} does not rise")
            parts.rows.append((int(words[0]), [int(word) for word in words[1:]]))
            check_bins(path, len(parts.rows) * len(parts.columns))
    needed = [*_HEADER, "# Time unit", "Index", *_FIELDS]
    if parts.contexts is not None:
        needed += [f"{name} below ALL:" for name in _OF_ALL]
    if missing := [name for name in needed if name not in parts.lines]:
        raise UsageError(f"{path}:{number}: cut off: no line {missing[0]}")
    if parts.contexts not in (None, seen := [name for name in _CONTEXTS if any(c[:3] == name for c in parts.columns)]):
        place = f"{path}:{parts.lines['ALL:']}"
        raise UsageError(f"{place}: ALL: expected columns {' '.join(seen)}, as Index has them")
    return parts


def _summarise(path: Path, parts: _TimerlatText, number: int, words: Sequence[str]) -> None:
    """Keep a summary line, of the columns or below ``ALL:``."""
    values = [int(word) if _NUMBER.fullmatch(word) else None for word in words[1:]]
    if parts.contexts is None:
        once(path, parts.lines, words[0], number)
        _expect(path, number, len(values), len(parts.columns))
        parts.summary[words[0]] = values
    else:
        once(path, parts.lines, f"{words[0]} below ALL:", number)
        _expect(path, number, len(values), len(parts.contexts))
        parts.of_all[words[0]] = values


def _expect(path: Path, line: int, count: int, columns: int) -> None:
    if count != columns:
        raise UsageError(f"{path}:{line}: {count} values for {columns} columns")


def _check_of_all(path: Path, parts: _TimerlatText, k: int, context: str) -> None:
    """Refuse a summary of all CPUs that does not match their columns."""
    of_cpus = [column for column, name in enumerate(parts.columns) if name.startswith(context)]
    counts = [_whole(path, parts, "count:", column) for column in of_cpus]
    n = sum(counts)
    allowed = {"count:": (n, n)}
    if n:
        least, mean, most = (
            [_whole(path, parts, name, column) for column, count in zip(of_cpus, counts, strict=True) if count]
            for name in ("min:", "avg:", "max:")
        )
        counts = [count for count in counts if count]
        # Each mean was truncated: the true sum may be higher by up to count - 1.
        total = sum(average * count for average, count in zip(mean, counts, strict=True))
        allowed |= {
            "min:": (min(least), min(least)),
            "avg:": (total // n, (total + n - len(counts)) // n),
            "max:": (max(most), max(most)),
        }
    for name, (low, high) in allowed.items():
        value = parts.of_all[name][k]
        if value is None or not low <= value <= high:
            place = f"{path}:{parts.lines[f'{name} below ALL:']}"
            expected = str(low) if low == high else f"{low} to {high}"
            raise UsageError(f"{place}: {context}: {name} {value} of all, but the columns give {expected}")


def _column(path: Path, parts: _TimerlatText, k: int, width: int) -> Imported:
    column = parts.columns[k]
    bins = {value: counts[k] for value, counts in parts.rows}
    over, count = (_whole(path, parts, name, k) for name in ("over:", "count:"))
    if sum(bins.values()) + over != count:
        raise UsageError(
            f"{path}:{parts.lines['count:']}: {column}: a count of {count}, but the bins hold {sum(bins.values())} "
            f"and {over} are over"
        )
    least, mean, most = (_printed(path, parts, name, k) for name in ("min:", "avg:", "max:"))
    left_out = [NO_ORDER, NO_INTERVAL, "the bucket size (taken as the largest that divides every index)"]
    if over:
        left_out.append(f"{over} values beyond the last bin: only the largest is known")
    return Imported(
        source="timerlat",
        name=f"timerlat-{column}",
        histogram=histogram(
            bins,
            Statistics(least=least, mean=mean, most=most),
            unit_ns=parts.unit_ns,
            width=width,
            overflow=over,
            # The bucket size may be smaller than the width, so it is only known that they lie beyond the last row.
            limit=parts.rows[-1][0] + 1 if parts.rows else 0,
        ),
        period_ns=None,
        left_out=tuple(left_out),
        parameters={"context": _CONTEXTS[column[:3]]},
        unit_ns=parts.unit_ns,
    )


def _printed(path: Path, parts: _TimerlatText, name: str, k: int) -> StatedSummary:
    """A number of a column; where nothing was measured, the text has a ``-``, or something else in older versions."""
    value = _whole(path, parts, name, k) if parts.summary["count:"][k] else None
    return StatedSummary(place=f"{path}:{parts.lines[name]}: {parts.columns[k]}", value=value)


def _whole(path: Path, parts: _TimerlatText, name: str, k: int) -> int:
    value = parts.summary[name][k]
    if value is None:
        raise UsageError(f"{path}:{parts.lines[name]}: {parts.columns[k]}: {name} expected a whole number")
    return value
