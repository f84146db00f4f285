"""Shared by all histogram formats: checks of the bins' counts, and plain JSON read with limits."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.errors import UsageError
from rtfiles.untrusted import parse_json, whole_number
from rtrun.analysis.histogram import Histogram
from rtrun.kinds.limits import COUNT_MAX

NO_INTERVAL = "the interval: a proof takes it for 1 ms; --interval states it"
NO_ORDER = "the order of the measurements: bursts and trends cannot be seen"
MAX_BINS = 1_000_000  #: bins with values, in all histograms of an imported file; cyclictest has no more
_KEY = re.compile(r"0|[1-9][0-9]{0,14}", re.ASCII)  # as %u prints it: different keys are different numbers
_NO_MEAN = re.compile(r'"avg"\s*:\s*-?nan\b')
_NUMBERED = re.compile(r'"([0-9]{1,15})"\s*:\s*\{', re.ASCII)


@dataclass(frozen=True, kw_only=True, slots=True)
class StatedSummary:
    """A number that a program printed about all values, None where it printed none; and the line or key of it."""

    place: str
    value: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Statistics:
    """The numbers that a program printed about all values, in the unit of its bins.

    A mean without `decimals` was truncated; otherwise it was rounded.
    """

    least: StatedSummary
    mean: StatedSummary
    most: StatedSummary
    decimals: int = 0


def load(path: Path, text: str) -> dict[str, Any]:
    """The JSON object in a text. Raises UsageError naming the file."""
    if match := _NO_MEAN.search(text):
        # The mean of no values divides zero by zero, and C prints that as something that is not JSON.
        line = text.count("\n", 0, match.start()) + 1
        number = next((found[1] for found in reversed([*_NUMBERED.finditer(text, 0, match.start())])), "?")
        raise UsageError(
            f"{path}:{line}: {match[0]}: thread or CPU {number} made no measurement, expected one at least of each; "
            "measure longer, or start fewer threads"
        )
    data = parse_json(text, str(path))
    if not isinstance(data, dict):
        raise UsageError(f"{path}: expected a JSON object")
    return data


def numbered(path: Path, where: str, data: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The members of a JSON object that holds one object per thread or CPU, by its number, counted from 0."""
    for key, value in data.items():
        if not _KEY.fullmatch(key) or not isinstance(value, dict):
            raise UsageError(f"{path}: {where}.{key[:20]!r}: expected a number, and a mapping behind it")
    if missing := [number for number in range(len(data)) if str(number) not in data]:
        raise UsageError(f"{path}: {where}.{missing[0]}: missing, but there are {len(data)} from 0 on")
    return data


def once(path: Path, lines: dict[str, int], name: str, number: int) -> None:
    """Record the line of something that a program prints once. Raises UsageError for a second line, naming both."""
    if name in lines:
        raise UsageError(f"{path}:{number}: a second line {name}, the first one is line {lines[name]}")
    lines[name] = number


def numbers_in(path: Path, line: int, text: str) -> list[int]:
    """The whole numbers in a line. Raises UsageError ``file:line: what is wrong``."""
    try:
        return [whole_number(word, lowest=0, highest=COUNT_MAX) for word in text.split()]
    except ValueError as error:
        raise UsageError(f"{path}:{line}: {error}") from error


def check_bins(path: Path, number: int) -> None:
    """Refuse a file with too many bins."""
    if number > MAX_BINS:
        raise UsageError(f"{path}: more than {MAX_BINS} bins that hold a value")


def whole(path: Path, where: str, value: object) -> int:
    """A whole number, 0 or more. Raises UsageError naming file and place."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= COUNT_MAX:
        raise UsageError(f"{path}: {where}: expected a whole number from 0 to {COUNT_MAX}, got {str(value)[:40]!r}")
    return value


def words_in(path: Path, where: str, value: object, *, most: int) -> str:
    """A printable line of at most `most` characters. Raises UsageError naming file and place."""
    if not isinstance(value, str) or len(value) > most or not value.isprintable():
        raise UsageError(
            f"{path}: {where}: expected one line of at most {most} printable characters, got {str(value)[:40]!r}"
        )
    return value


def bins_of(path: Path, where: str, data: object, *, limit: int | None) -> dict[int, int]:
    """Bins from a JSON mapping of value to count, all below `limit` where it is known."""
    if not isinstance(data, dict):
        raise UsageError(f"{path}: {where}: expected a mapping of value to count")
    check_bins(path, len(data))
    bins: dict[int, int] = {}
    for key, count in data.items():
        if not _KEY.fullmatch(key):
            raise UsageError(f"{path}: {where}: {key[:40]!r} is no bin")
        bins[int(key)] = whole(path, f"{where}.{key}", count)
        if limit is not None and int(key) >= limit:
            raise UsageError(f"{path}: {where}.{key}: a bin of {key}, but the histogram ends below {limit}")
    return bins


def overflow_of(path: Path, where: str, count: object, bins: Mapping[int, int]) -> int:
    """How many of `count` values are in no bin. Raises UsageError naming the key."""
    measured, inside = whole(path, where, count), sum(bins.values())
    if measured < inside:
        raise UsageError(f"{path}: {where}: {measured}, but the bins hold {inside}")
    return measured - inside


def statistics_in(path: Path, where: str, data: Mapping[str, Any]) -> Statistics:
    """The ``min``, ``avg`` and ``max`` of a JSON object, with two decimals. Raises UsageError naming the key."""
    mean = data.get("avg")
    if isinstance(mean, bool) or not isinstance(mean, int | float) or not 0 <= mean <= COUNT_MAX:
        raise UsageError(f"{path}: {where}.avg: expected a number from 0 to {COUNT_MAX}, got {str(mean)[:40]!r}")
    least, most = (whole(path, f"{where}.{key}", data.get(key)) for key in ("min", "max"))
    return Statistics(
        least=StatedSummary(place=f"{path}: {where}.min", value=least),
        mean=StatedSummary(place=f"{path}: {where}.avg", value=mean),
        most=StatedSummary(place=f"{path}: {where}.max", value=most),
        decimals=2,
    )


def check_statistics(
    bins: Mapping[int, int], printed: Statistics, *, width: int = 1, overflow: int, limit: int
) -> None:
    """Refuse a minimum, mean or maximum that contradicts the bins.

    `limit` is a lower bound of the `overflow` values, which are only counted. Raises UsageError that starts with the
    place of the wrong number.
    """
    least, mean, most, decimals = printed.least, printed.mean, printed.most, printed.decimals
    filled = {value: count for value, count in sorted(bins.items()) if count}
    n = sum(filled.values()) + overflow
    if n == 0:
        for printed_value in (mean, most):
            if printed_value.value:
                raise UsageError(f"{printed_value.place}: {printed_value.value:g}, but nothing was measured")
        return
    lowest_bin, last_bin = min(filled, default=limit), max(filled, default=limit)
    if least.value is not None and not (lowest_bin <= least.value and (not filled or least.value < lowest_bin + width)):
        raise UsageError(f"{least.place}: a smallest value of {least.value}, but the lowest bin is {lowest_bin}")
    if most.value is not None and overflow and most.value < limit:
        raise UsageError(f"{most.place}: a largest value of {most.value}, but {overflow} values are {limit} and more")
    if most.value is not None and not overflow and not last_bin <= most.value < last_bin + width:
        raise UsageError(f"{most.place}: a largest value of {most.value}, but the last bin is {last_bin}")
    low = lowest_bin if least.value is None else least.value
    high = most.value if most.value is not None else math.inf if overflow else last_bin + width - 1
    if low > high:
        raise UsageError(f"{least.place}: a smallest value of {low}, but the largest one is {high}")
    if mean.value is None:
        return
    # How small and how large each value can be; one of them is the minimum, and one the maximum.
    groups: list[tuple[float, float, int]] = [(value, value + width - 1, count) for value, count in filled.items()]
    groups += [(limit, math.inf, overflow)] if overflow else []
    groups = [(max(first, low), min(last, high), count) for first, last, count in groups]
    smallest_sum = sum(first * count for first, _, count in groups)
    largest_sum = sum(last * count for _, last, count in groups)
    smallest_sum += high - groups[-1][0] if most.value is not None else 0
    largest_sum -= groups[0][1] - low if least.value is not None and largest_sum < math.inf else 0
    half = 0.5 / 10**decimals if decimals else 0.0
    slack = 1e-9 * max(1.0, mean.value)  # floating-point rounding
    from_mean = smallest_sum / n - half if decimals else smallest_sum // n
    if not from_mean - slack <= mean.value <= largest_sum / n + half + slack:
        allowed = f"{smallest_sum / n:.2f} to {largest_sum / n:.2f}"
        raise UsageError(f"{mean.place}: a mean of {mean.value:.{decimals}f}, but the bins allow {allowed}")


def histogram(
    bins: Mapping[int, int], printed: Statistics, *, unit_ns: int, width: int = 1, overflow: int, limit: int
) -> Histogram:
    """A histogram from bins in units of `unit_ns`, each `width` units wide; every reader makes it here, checked.

    Raises UsageError where the printed numbers contradict the bins, as `check_statistics` does.
    """
    check_statistics(bins, printed, width=width, overflow=overflow, limit=limit)
    most, mean = printed.most.value, printed.mean.value
    filled = sorted((value, count) for value, count in bins.items() if count)
    return Histogram(
        values_ns=np.array([value * unit_ns for value, _ in filled], dtype=np.int64),
        counts=np.array([count for _, count in filled], dtype=np.int64),
        bin_ns=unit_ns * width,
        overflow=overflow,
        overflow_from_ns=limit * unit_ns if overflow else None,
        max_ns=None if most is None else int(most) * unit_ns,
        mean_ns=None if mean is None else float(mean) * unit_ns,
    )
