"""The axes of plots: their division, and the labels at their places."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

import numpy as np

from rtfiles.quantities import grouped, time
from rtrun.analysis.scale import Division, Scale

_TICKS = 5  # this many can be told apart on a phone
_PARTS = 4  # of a stretched axis, of about equal size: an even number, so that there is a middle
_APART = 0.19  # of an axis: closer labels would overlap
Unit = Literal["ns", "count", "share", "date"]
"""What the numbers of an axis mean: times in ns, counts, shares of a whole, or seconds since 1970."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Axis:
    """An axis named after what is measured along it; `ticks` are (value, text)."""

    title: str
    unit: Unit
    scale: Scale
    ticks: tuple[tuple[float, str], ...]


def times(title: str, scale: Scale) -> Axis:
    """An axis of times in ns."""
    return _axis(title, "ns", scale, time)


def counts(title: str, low: float, high: float) -> Axis:
    """A linear axis of integers."""
    return _axis(title, "count", Scale(division=Division.LINEAR, low=low, high=high), grouped)


def many(title: str, low: float, high: float) -> Axis:
    """A logarithmic axis of counts."""
    return _axis(title, "count", Scale(division=Division.LOG, low=low, high=high), grouped)


def shares(title: str, low: float, *, division: Division = Division.LOG, high: float = 1.0) -> Axis:
    """An axis of shares."""
    return _axis(title, "share", Scale(division=division, low=low, high=high), lambda value: f"{value:.3g}")


def dates(title: str, low: float, high: float) -> Axis:
    """A linear axis of days; seconds since 1970."""
    around = 0 if high > low else 30  # a single moment is in the middle of a minute
    scale = Scale(division=Division.LINEAR, low=low - around, high=max(high, low + 30))
    first, span = datetime(1970, 1, 1) + timedelta(seconds=low - around), scale.high - scale.low
    form = "%Y-%m-%d" if span >= 3 * 86400 else "%m-%d %H:%M"
    marks = [first + timedelta(seconds=span * part) for part in ((1 / 2,) if around else (0, 1 / 2, 1))]
    ticks = [((mark - datetime(1970, 1, 1)).total_seconds(), f"{mark:{form}}") for mark in marks]
    return Axis(title=title, unit="date", scale=scale, ticks=tuple(ticks))


def _axis(title: str, unit: Unit, scale: Scale, text: Callable[[float], str]) -> Axis:
    return Axis(
        title=title, unit=unit, scale=scale, ticks=tuple((value, text(value)) for value in _round_values(scale))
    )


def _round_values(scale: Scale) -> list[float]:
    """Round numbers on an axis, ascending: at equal distances, powers of ten, or those nearest to equal distances."""
    if scale.division is Division.LINEAR:
        return _multiples(scale.low, scale.high)
    if scale.division is Division.LOG:
        first, last = math.ceil(math.log10(scale.low) - 1e-9), math.floor(math.log10(scale.high) + 1e-9)
        powers = [10.0**k for k in range(first, last + 1)]
        if len(powers) > 2:
            return powers[:: math.ceil(len(powers) / _TICKS)]
        finer = [factor * 10.0**k for k in range(first - 1, last + 1) for factor in (1, 2, 5)]
        finer = [value for value in finer if scale.low <= value <= scale.high]
        return _spread(scale, finer if len(finer) > 2 else _multiples(scale.low, scale.high))
    values = []
    for k in range(_PARTS + 1):
        low, value, high = scale.values_at(np.clip([k - 0.2, k, k + 0.2], 0, _PARTS) / _PARTS).tolist()
        values.append(_roundest(low, value, high))
    return _spread(scale, values)


def _spread(scale: Scale, values: Iterable[float]) -> list[float]:
    """The ascending values without those whose labels would overlap."""
    kept: list[float] = []
    for value in values:
        if not kept or float(scale.at(value)) - float(scale.at(kept[-1])) >= _APART:
            kept.append(value)
    return kept


def _multiples(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten."""
    least = (high - low) / _TICKS or 1.0
    power = 10.0 ** math.floor(math.log10(least))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * (1 - 1e-9))
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _roundest(low: float, value: float, high: float) -> float:
    """Of the numbers with the fewest digits between two others, the one nearest to `value`."""
    if low <= 0 <= high:
        return 0.0
    for digits in range(1, 16):
        unit = 10.0 ** (math.floor(math.log10(max(abs(low), abs(high)))) + 1 - digits)
        below = math.floor(value / unit)
        inside = [k * unit for k in (below, below + 1) if low <= k * unit <= high]
        if inside:
            return min(inside, key=lambda candidate: abs(candidate - value))
    return value
