"""Reader of the text of ``rtla timerlat hist`` (Linux tools 5.17 and later)."""

import math
import re
from functools import reduce
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.untrusted import lines_of
from rtrun.results.importers.counts import NO_ORDER, check_bins, check_statistics, histogram
from rtrun.results.importers.histogram_file import Imported

_COLUMN = re.compile(r"(IRQ|Thr|Usr)-[0-9]{3,5}", re.ASCII)
_CONTEXTS = {"IRQ": "interrupt", "Thr": "thread", "Usr": "user"}
_FIELDS = ("over:", "count:", "min:", "avg:", "max:")
_NUMBER = re.compile(r"[0-9]{1,15}", re.ASCII)


def read_text(path: Path, text: str) -> tuple[Imported, ...]:
    """One histogram a column (a context on a CPU). Raises UsageError ``file:line: what is wrong``."""
    unit_ns, columns, rows = 1000, [], list[tuple[int, list[int]]]()
    summary: dict[str, list[int | None]] = {}
    number = 0
    for number, line in enumerate(lines_of(text, str(path)), start=1):
        words = line.split()
        if "Time unit is nanoseconds" in line:
            unit_ns = 1
        elif words[:1] == ["Index"]:
            columns = words[1:]
            if not columns or not all(_COLUMN.fullmatch(word) for word in columns):
                raise UsageError(f"{path}:{number}: expected columns IRQ-000, Thr-000 or Usr-000")
        elif words[:1] == ["ALL:"]:
            break  # the same again, summed up
        elif columns and words and words[0] in _FIELDS:
            _expect(path, number, len(words) - 1, len(columns))
            summary[words[0]] = [int(w) if _NUMBER.fullmatch(w) else None for w in words[1:]]
        elif columns and words and _NUMBER.fullmatch(words[0]):
            _expect(path, number, len(words) - 1, len(columns))
            if not all(_NUMBER.fullmatch(word) for word in words):
                raise UsageError(f"{path}:{number}: expected whole numbers, got {line.strip()[:40]!r}")
            if rows and int(words[0]) <= rows[-1][0]:
                raise UsageError(f"{path}:{number}: {words[0]} does not rise")
            rows.append((int(words[0]), [int(word) for word in words[1:]]))
            check_bins(path, len(rows) * len(columns))
    if missing := [name for name in ("Index", *_FIELDS) if name not in (summary | {"Index": 0} if columns else {})]:
        raise UsageError(f"{path}:{number}: cut off: no line {missing[0]}")
    # The bucket size (-b) is not printed: it divides every index.
    width = reduce(math.gcd, (value for value, _ in rows), 0)
    if not width:  # only the first bucket is filled: it holds at least every largest value that is not over
        inside = zip(summary["max:"], summary["over:"], strict=True)
        width = 1 + max((most or 0 for most, over in inside if not over), default=0)
    return tuple(_column(path, k, name, rows, summary, unit_ns, width) for k, name in enumerate(columns))


def _expect(path: Path, line: int, count: int, columns: int) -> None:
    if count != columns:
        raise UsageError(f"{path}:{line}: {count} values for {columns} columns")


def _column(
    path: Path,
    k: int,
    name: str,
    rows: list[tuple[int, list[int]]],
    summary: dict[str, list[int | None]],
    unit_ns: int,
    width: int,
) -> Imported:
    bins = {value: counts[k] for value, counts in rows}
    over, count = summary["over:"][k] or 0, summary["count:"][k] or 0
    if sum(bins.values()) + over != count:
        raise UsageError(
            f"{path}: {name}: a count of {count}, but the bins hold {sum(bins.values())} and {over} are over"
        )
    limit = max((value for value, _ in rows), default=-width) + width
    least, mean, most = (summary[field][k] for field in ("min:", "avg:", "max:"))
    check_statistics(
        f"{path}: {name}", bins, width=width, overflow=over, limit=limit, least=least, mean=mean, most=most
    )
    left_out = [NO_ORDER, "the period and the bucket size (taken as the largest that divides every index)"]
    if over:
        left_out.append(f"{over} values beyond the last bin: only the largest is known")
    return Imported(
        source="timerlat",
        name=f"timerlat-{name}",
        histogram=histogram(
            bins,
            unit_ns=unit_ns,
            width=width,
            overflow=over,
            overflow_from=limit,
            max_value=most,
            mean_value=mean,
        ),
        period_ns=None,
        left_out=tuple(left_out),
        parameters={"context": _CONTEXTS[name[:3]]},
    )
