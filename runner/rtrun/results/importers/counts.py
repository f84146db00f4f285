"""What all the histogram formats share: counts of bins checked, plain JSON read with limits."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.errors import UsageError
from rtfiles.untrusted import parse_json, whole_number
from rtrun.analysis.histogram import Histogram
from rtrun.plan.limits import COUNT_MAX

NO_ORDER = "the order of the measurements: bursts and trends cannot be seen"
MAX_BINS = 1_000_000  # that hold a value, of all histograms in a file; cyclictest has at most as many
_KEY = re.compile(r"[0-9]{1,9}", re.ASCII)


def load(path: Path, text: str) -> dict[str, Any]:
    """The JSON object in a text. Raises UsageError naming the file."""
    data = parse_json(text, str(path))
    if not isinstance(data, dict):
        raise UsageError(f"{path}: expected a JSON object")
    return data


def numbered(path: Path, where: str, data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The members of a JSON object that holds one object for each thread or CPU, by its number."""
    for key, value in data.items():
        if not _KEY.fullmatch(key) or not isinstance(value, dict):
            raise UsageError(f"{path}: {where}.{key[:20]!r}: expected a number, and a mapping behind it")
    return data


def numbers_in(path: Path, line: int, text: str) -> list[int]:
    """The whole numbers in a line. Raises UsageError ``file:line: what is wrong``."""
    try:
        return [whole_number(word, lowest=0, highest=COUNT_MAX) for word in text.split()]
    except ValueError as error:
        raise UsageError(f"{path}:{line}: {error}") from error


def check_bins(path: Path, number: int) -> None:
    """Refuse a file with more bins than it can have."""
    if number > MAX_BINS:
        raise UsageError(f"{path}: more than {MAX_BINS} bins that hold a value")


def whole(path: Path, where: str, value: object) -> int:
    """A whole number from 0 on. Raises UsageError naming file and place."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= COUNT_MAX:
        raise UsageError(f"{path}: {where}: expected a whole number from 0 to {COUNT_MAX}, got {str(value)[:40]!r}")
    return value


def bins_of(path: Path, where: str, data: object) -> dict[int, int]:
    """Bins from a JSON mapping of value to count."""
    if not isinstance(data, dict):
        raise UsageError(f"{path}: {where}: expected a mapping of value to count")
    check_bins(path, len(data))
    bins: dict[int, int] = {}
    for key, count in data.items():
        if not (key.isascii() and key.isdigit() and len(key) <= 15):
            raise UsageError(f"{path}: {where}: {key[:40]!r} is no bin")
        bins[int(key)] = whole(path, f"{where}.{key}", count)
    return bins


def mean_of(path: Path, where: str, value: object) -> float | None:
    """A mean as it is printed, None where there is none. Raises UsageError naming file and place."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= COUNT_MAX:
        raise UsageError(f"{path}: {where}: expected a number from 0 to {COUNT_MAX}, got {str(value)[:40]!r}")
    return float(value)


def check_statistics(
    place: str,
    bins: Mapping[int, int],
    *,
    width: int = 1,
    overflow: int,
    limit: int,
    least: int | None,
    mean: float | None,
    most: int | None,
) -> None:
    """Refuse least, mean and most that contradict the bins, all in the unit of the bins.

    `limit` is a lower bound of the values that are only counted. Means may be truncated to whole numbers. Raises
    UsageError that starts with `place`.
    """
    filled = {value: count for value, count in bins.items() if count}
    n = sum(filled.values()) + overflow
    if n == 0:
        return
    lowest = min(filled, default=limit)
    if least is not None and (least < lowest or (filled and least >= lowest + width)):
        raise UsageError(f"{place}: a smallest value of {least}, but the lowest bin is {lowest}")
    last = max(filled, default=0)
    if most is not None and overflow and most < limit:
        raise UsageError(f"{place}: a largest value of {most}, but {overflow} values are {limit} and more")
    if most is not None and not overflow and not last <= most < last + width:
        raise UsageError(f"{place}: a largest value of {most}, but the last bin is {last}")
    if mean is None:
        return
    top = limit if most is None else most
    inside = sum(value * count for value, count in filled.items())
    low = inside + (overflow - 1) * limit + top if overflow else inside  # one of those above is the largest
    high = inside + (width - 1) * (n - overflow) + overflow * top
    # The hundredth is that of a mean printed with two decimals.
    if mean <= low / n - 1 or (mean > high / n + 0.01 and not (overflow and most is None)):
        raise UsageError(f"{place}: a mean of {mean:g}, but the bins allow {low / n:.2f} to {high / n:.2f}")


def histogram(
    bins: Mapping[int, int],
    *,
    unit_ns: int,
    width: int,
    overflow: int,
    overflow_from: int,
    max_value: int | None,
    mean_value: float | None,
) -> Histogram:
    """A histogram from bins in units of `unit_ns`, each `width` units wide."""
    filled = sorted((value, count) for value, count in bins.items() if count)
    return Histogram(
        values_ns=np.array([value * unit_ns for value, _ in filled], dtype=np.int64),
        counts=np.array([count for _, count in filled], dtype=np.int64),
        bin_ns=unit_ns * width,
        overflow=overflow,
        overflow_from_ns=overflow_from * unit_ns if overflow else None,
        max_ns=None if max_value is None else max_value * unit_ns,
        mean_ns=None if mean_value is None else mean_value * unit_ns,
    )
