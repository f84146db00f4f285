"""Do runs, or boots, get worse one after the other? Each has a level of its own: steep trends are seen like flat ones.

The level of a unit is the height that a certain share of its values exceeds. The share is the same for all units, so
units can be compared however long each was measured.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rtrun.analysis.chance.distributions import Floats, student_quantile
from rtrun.analysis.order.stationarity import (
    PIECES,
    SIGNIFICANT,
    SIGNIFICANT_OF_MISSES,
    Change,
    beyond_even,
    count_until,
)
from rtrun.analysis.order.units_in_order import find_common_order, find_order, signs_looked_at
from rtrun.analysis.trials import Trials
from rtrun.kinds.values import Int64s

# Higher than for events, because units are few: five boots, each worse than the last, have the chance 2/120. The only
# bad boot of fifty is the first or the last with the chance 2/50.
_SIGNIFICANT_OF_LEVELS = 0.02
_SIGNIFICANT_OF_MISSES = 0.05
LEAST_UNITS = 5
# The chance of seeing a trend of the smallest size that an answer states.
_POWER = 0.9
_WORSE = ("last", "rising")
# By this factor the test of ranks needs a steeper climb than the test of a line's slope: simulated for 5 to 40 units in
# 1 to 6 strata.
_OF_RANKS, _OF_FEW_RANKS, _MANY = 1.25, 1.75, 8
# This many values exceed the level in a unit of the lower quartile of lengths; fewer, if more units then have a level.
# Among many, single misses matter little.
_EXCEEDED = (100, 20, 10, 5)
_LEAST_EXCEEDED = 5

Unit = Sequence[Trials]
"""The trials of all outputs of a run, or of all runs of a boot."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Climb:
    """How levels of units climb: `smallest_ns` per unit is the smallest climb that so many `units` would have shown.

    It would have been seen nine times in ten; None if the units are too few to show any. If the highest values climb,
    they reach the deadline after `reached_after` more such units at the pace seen.
    """

    unit: Literal["run", "boot"]
    units: int
    smallest_ns: float | None
    reached_after: float | None = None


def runs_of(trials: Sequence[Trials]) -> list[Unit]:
    """The runs of trials in their order, each with its outputs."""
    runs: dict[str, list[Trials]] = {}
    for index, output in enumerate(trials):
        runs.setdefault(output.run or str(index), []).append(output)
    return [*runs.values()]


def changes_between(strata: Sequence[Sequence[Unit]], name: str, *, of_heights: bool) -> Iterator[Change]:
    """Yield signs, in misses and in heights, that the order of units matters; units follow one another in a stratum.

    `name` is what the units are, in the plural.
    """
    strata = [units for units in strata if len(units) > 1]
    if order := find_order([_miss_rates(units) for units in strata], by_height=True):
        text = f"misses come more often {order.words(name)}"
        yield Change(p_value=order.p_value, significant=_SIGNIFICANT_OF_MISSES, text=text)
    order = find_order(levels_ns(strata), by_height=False) if of_heights else None
    # Falling heights do not weaken a proof.
    if order is not None and order.where in _WORSE:
        text = f"high values are higher {order.words(name)}"
        yield Change(p_value=order.p_value, significant=_SIGNIFICANT_OF_LEVELS, text=text, of_heights=True)


def changes_laid_over(runs: Sequence[Unit], *, of_heights: bool) -> Iterator[Change]:
    """Yield the signs that runs, laid over one another, are worse at the end than before, as a leak makes them."""
    runs = [run for run in runs if all(output.n >= PIECES for output in run)]
    of_misses = [sum(_in_pieces(output.missed_at, output.n) for output in run) for run in runs]
    of_high = [sum(_in_pieces(output.high_at, output.n) for output in run) for run in runs] if of_heights else []
    for counts, events, significant, is_of_heights in (
        (of_misses, "misses come more often", SIGNIFICANT_OF_MISSES, False),
        (of_high, "high values come more often", SIGNIFICANT, True),
    ):
        order = find_common_order(np.array(counts, np.float64)) if counts else None
        # An effect at the start of each run fades, so longer runs have less of it.
        if order is not None and order.where in _WORSE:
            text = f"{events} {order.words('pieces')} of each run, cut into {PIECES}"
            yield Change(p_value=order.p_value, significant=significant, text=text, of_heights=is_of_heights)


def _in_pieces(places: Int64s, loops: int) -> Int64s:
    return count_until(places, np.arange(1, PIECES + 1) * loops // PIECES)


def _loops(unit: Unit) -> int:
    return sum(output.n for output in unit)


def _misses(unit: Unit) -> int:
    return sum(output.late + output.absent for output in unit)


def _miss_rates(units: Sequence[Unit]) -> Floats:
    return beyond_even(np.array([_misses(unit) for unit in units]), np.array([_loops(unit) for unit in units]))


def levels_ns(strata: Sequence[Sequence[Unit]]) -> list[Floats]:
    """The level in ns of each unit that has one, by stratum; empty where more than a quarter of the units have none."""
    every = [unit for units in strata for unit in units]
    usual = float(np.quantile([_loops(unit) for unit in every], 0.25)) if every else 0.0
    best: list[Floats] = []
    for exceeded in _EXCEEDED if usual else ():
        found = [[_level_ns(unit, exceeded / usual) for unit in units] for units in strata]
        known = [np.array([level for level in levels if level is not None], np.float64) for levels in found]
        if sum(map(np.size, known)) > sum(map(np.size, best)):
            best = known
    return best if 4 * sum(map(np.size, best)) >= 3 * len(every) else []


def _level_ns(unit: Unit, share: float) -> int | None:
    """The height that this share of a unit's values reaches; None if these are too few, or not all of them were
    kept."""
    number = round(share * _loops(unit))
    known = [output.high_ns for output in unit if output.high_ns.size]
    if number < _LEAST_EXCEEDED or len(known) < len(unit):
        return None
    highest = np.concatenate(known)
    if highest.size < number:
        return None
    level = int(np.partition(highest, highest.size - number)[highest.size - number])
    # Below the lowest of the high values of a run, its values are not known.
    return level if level >= max(int(high.min()) for high in known) else None


def find_climb(unit: Literal["run", "boot"], strata: Sequence[Sequence[Unit]], deadline_ns: int) -> Climb | None:
    """How the levels of runs or boots climb; None where no stratum has two."""
    strata = [units for units in strata if len(units) > 1]
    if not strata:
        return None
    levels = levels_ns(strata)
    return Climb(
        unit=unit,
        units=sum(map(len, strata)),
        smallest_ns=_smallest_ns(levels),
        reached_after=_reached_after(strata, deadline_ns),
    )


def _smallest_ns(strata: Sequence[Floats]) -> float | None:
    """The slope in ns per unit that this many units show nine times in ten, from the power of the test of a slope."""
    units, spread = sum(levels.size for levels in strata), sum(_of_places(levels.size) for levels in strata)
    degrees = units - len(strata) - 1
    if units < LEAST_UNITS or degrees < 1:
        return None
    slope = _slope(strata)
    rest = sum(float(((levels - levels.mean() - slope * _places(levels.size)) ** 2).sum()) for levels in strata)
    significant = _SIGNIFICANT_OF_LEVELS / signs_looked_at(min(levels.size for levels in strata if levels.size))
    reach = student_quantile(1 - significant, degrees) + student_quantile(_POWER, degrees)
    return reach * (_OF_RANKS if units >= _MANY else _OF_FEW_RANKS) * float(np.sqrt(rest / degrees / spread))


def _reached_after(strata: Sequence[Sequence[Unit]], deadline_ns: int) -> float | None:
    """After how many more units the highest values reach the deadline, where they climb beyond chance."""
    highest = [
        np.array([max((output.worst_ns or 0 for output in unit), default=0) for unit in units], np.float64)
        for units in strata
    ]
    order, slope = find_order(highest, by_height=False), _slope(highest)
    if order is None or order.p_value >= _SIGNIFICANT_OF_MISSES or order.where not in _WORSE or slope <= 0:
        return None
    last = max(float(values.mean() + slope * _places(values.size)[-1]) for values in highest)
    after = (deadline_ns - last) / slope
    return after if after > 0 else None


def _places(size: int) -> Floats:
    return np.asarray(np.arange(size) - (size - 1) / 2)


def _of_places(size: int) -> float:
    return float((_places(size) ** 2).sum())


def _slope(strata: Sequence[Floats]) -> float:
    spread = sum(_of_places(values.size) for values in strata)
    return sum(float(_places(values.size) @ values) for values in strata) / spread if spread else 0.0
