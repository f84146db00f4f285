"""Searches: the minimum of a function of several numbers, the zero of a function of one, the place where a ratio is
one."""

import math
from collections.abc import Callable, Sequence

_MOST_STEPS = 1500
_TINY = 1e-300
_Corner = tuple[float, list[float]]


def lowest_point(
    cost: Callable[[Sequence[float]], float], begin: Sequence[float], *, step: float, tolerance: float
) -> tuple[list[float], float]:
    """Where a cost is lowest, and how low: the simplex search of Nelder & Mead (1965), with first steps of this width.

    It ends when all corners of the simplex are within ten tolerances of the best, and their costs within one.
    """

    def moved(corner: Sequence[float], factor: float, other: Sequence[float]) -> _Corner:
        """The corner that lies `factor` times as far from `corner` as `other` does, on the same line."""
        place = [at + factor * (value - at) for at, value in zip(corner, other, strict=True)]
        return cost(place), place

    begins = ([value + step * (k == index) for k, value in enumerate(begin)] for index in range(len(begin)))
    simplex = sorted([(cost(place), place) for place in (list(begin), *begins)], key=_cost_of)
    for _ in range(_MOST_STEPS):
        least, best = simplex[0]
        farthest = max(abs(value - at) for _, place in simplex[1:] for value, at in zip(place, best, strict=True))
        if farthest <= 10 * tolerance and simplex[-1][0] - least <= tolerance:
            break
        worst_cost, worst = simplex[-1]
        middle = [sum(values) / len(best) for values in zip(*(place for _, place in simplex[:-1]), strict=True)]
        tried = moved(middle, -1, worst)
        is_better = True
        if tried[0] < least:
            tried = min(moved(middle, -2, worst), tried, key=_cost_of)
        elif tried[0] >= simplex[-2][0]:
            # Half as far, on the better side.
            at_most = min(tried[0], worst_cost)
            tried = moved(middle, -0.5 if tried[0] < worst_cost else 0.5, worst)
            is_better = tried[0] <= at_most
        following = [tried, *simplex[:-1]] if is_better else [moved(best, 0.5, place) for _, place in simplex]
        simplex = sorted(following, key=_cost_of)
    least, best = simplex[0]
    return best, least


def crossing(function: Callable[[float], float], low: float, high: float, *, tolerance: float) -> float:
    """Where a function crosses zero, to within a tolerance, between places where its signs differ.

    The rule of false position, which halves the height of an end that stays (Illinois; Dowell & Jarratt 1971).
    """
    at_low, at_high = function(low), function(high)
    while at_low and at_high and abs(high - low) > tolerance:
        middle = high - at_high * (high - low) / (at_high - at_low)
        height = function(middle)
        if (height < 0) != (at_high < 0):
            low, at_low = high, at_high
        else:
            at_low /= 2
        if abs(middle - high) <= tolerance / 2:
            return middle
        high, at_high = middle, height
    return high if not at_high else low if not at_low else (low + high) / 2


def where_one(ratio: Callable[[float], float], start: float) -> float:
    """Where a rising ratio is 1, by secants of its log, which should be nearly straight."""
    low, high, at = -math.inf, math.inf, start
    before, height_before = math.nan, math.nan
    for _ in range(_MOST_STEPS):
        height = math.log(max(ratio(at), _TINY))
        low, high = (max(low, at), high) if height < 0 else (low, min(high, at))
        slope = (height - height_before) / (at - before)
        # The first step is small. Where the ratio has no slope, each step is twice as wide as the one before.
        step = -height / slope if slope > 0 else math.copysign(max(0.001, 2 * abs(at - before)), -height)
        following = at + max(-2.0, min(2.0, step))
        is_outside = high - low < math.inf and not low < following < high
        before, height_before, at = at, height, (low + high) / 2 if is_outside else following
        # The error of a secant is about the product of the two steps before it.
        if abs(at - before) <= (1e-14 if is_outside else 1e-12) * max(1.0, abs(at)):
            break
    return at


def _cost_of(corner: _Corner) -> float:
    return corner[0]
