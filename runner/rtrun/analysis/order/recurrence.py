"""Do late values come at a fixed distance of time or of loops?"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import binomial_above
from rtrun.kinds.values import Int64s

ALPHA = 0.002
LEAST_LOOPS = 20  # that a period has
# A period has at least this many cycles in a run. An eighth of the run has eight; the best fit may have a little less.
LEAST_CYCLES = 7.5
LEAST_COVERED = 0.6  # of the cycles have an event
# First this many of the highest values are tried, then twice as many each time, so that one number is near that of the
# cycles. The largest number keeps the search short.
_LEAST_COUNT = 8
_COUNT_MAX = 1 << 16  # values, so that the search is short
# With n events, periods are tried that fit n / 4 to 2 n times into the run.
_FEWER, _MORE = 4, 2
# If half of the cycles have an event, these are n / 8 events at least, with a power of n / 64. The width of bins takes
# some of it. Frequencies with less are not examined.
_LEAST_POWER = 0.01
# The transform is so many times as long as the data, filled with zeros. Without them, a frequency between two that are
# tried keeps only 40 % of its power.
_PADDED = 2
# A period of so many bins keeps most of its power.
_BINS_OF_PERIOD = 8
_ARCS = (1 / 2, 1 / 8, 1 / 32, 1 / 128)  # of a period
_NEAR = (0.15, 0.05, 0.02)  # of a period


@dataclass(frozen=True, kw_only=True, slots=True)
class Recurrence:
    """Events every `period`, in the unit of their positions; `covered` of `cycles` periods have one.

    They are among the `late` highest values. `p_value` is an upper bound of the probability that values without any
    period fit one of the tried periods as well.
    """

    period: float
    p_value: float
    late: int
    covered: int
    cycles: int


def counts_tried(values: int) -> Iterator[int]:
    """The numbers of highest values that are tried as the late ones, up to two for each cycle of the shortest
    period."""
    count = _LEAST_COUNT
    while count <= min(_COUNT_MAX, 2 * values // LEAST_LOOPS):
        yield count
        count *= 2


def find_recurrence(places: Int64s, *, begin: int, end: int, values: int, searches: int = 1) -> Recurrence | None:
    """The period of the highest of `values` values, from `begin` to `end`; None if none is significant.

    `places` (k,) are the places of the highest values, highest first, as many as the largest of `counts_tried`. This is
    one of `searches` searches.

    The frequency of the highest power |sum exp(2 pi i f t)|^2 / n is found by a fast Fourier transform, for each
    count in turn. Its test is the number of points within an arc of the circle of phases (`_chance_of_arc`): with eight
    events, the power could not be significant, however exactly they come. A point is the mean of the events of a
    period, because events that come in bursts depend on each other. The p-value is corrected after Bonferroni for
    counts, searches, arcs, and frequencies that an arc tells apart.
    """
    loop = max(1, (end - begin) // values)
    counts = list(counts_tried(values))
    found = [_find(np.sort(places[:count]) - begin, end - begin, loop) for count in counts]
    # Chances that are too small for a float are 0. Among these, the period with events in more of its cycles wins.
    best = min(filter(None, found), key=lambda result: (result.p_value, -result.covered / result.cycles), default=None)
    if best is None:
        return None
    p_value = min(1.0, best.p_value * len(counts) * searches)
    if p_value > ALPHA:
        return None
    # The count with the best chance may be lower than the number of cycles. The count that covers most of them is kept.
    alike = (result for result in found if result and abs(result.period - best.period) < min(_NEAR) * best.period)
    return replace(max(alike, key=lambda result: (result.covered / result.cycles, -result.late)), p_value=p_value)


def _find(late: Int64s, length: int, loop: int) -> Recurrence | None:
    """The period that fits best, corrected for frequencies and arcs.

    Values nearer than half of the shortest period to the one before belong to its burst, which counts once.
    """
    shortest = LEAST_LOOPS * loop
    events = late[np.diff(late, prepend=-shortest) > shortest // 2]
    lowest = max(LEAST_CYCLES, events.size / _FEWER)
    highest = min(_MORE * events.size, length / shortest)
    if lowest >= highest:
        return None
    # Entry k of the transform is the frequency k / (_PADDED * length).
    first, last = math.floor(_PADDED * lowest), math.ceil(_PADDED * highest)
    bins = 1 << math.ceil(math.log2(_BINS_OF_PERIOD * (highest + 1)))
    counts = np.bincount(np.minimum(events * bins // length, bins - 1), minlength=bins).astype(np.float64)
    power = np.abs(np.fft.rfft(counts, n=_PADDED * bins)[first : last + 1]) ** 2 / events.size
    best = int(np.argmax(power))
    if power[best] < _LEAST_POWER * events.size:
        return None
    frequency = _refine(events, (first + best) / (_PADDED * length), length)
    frequency = _fundamental(events, frequency, length, lowest)
    phases = _phases(events, frequency)
    tried = _PADDED * (highest - lowest + 1) * len(_ARCS)
    p_value = min(tried / arc * _chance_of_arc(phases, arc, loop * frequency) for arc in _ARCS)
    covered = int(np.count_nonzero(abs(phases) < 1 / 4))
    cycles = max(covered, round(length * frequency))
    if covered < LEAST_COVERED * cycles:
        return None
    period = _period(events, frequency)
    return Recurrence(period=period, p_value=p_value, late=late.size, covered=covered, cycles=cycles)


def _phases(events: Int64s, frequency: float) -> NDArray[np.float64]:
    """The mean direction of the events of each period that has any, in turns (-0.5 to 0.5) from the direction of all
    events: those of one period may depend on each other."""
    vectors = np.exp(2j * np.pi * frequency * events)
    common = vectors.sum()
    phase = float(np.angle(common)) / (2 * np.pi)
    _, cycle = np.unique(np.round(events * frequency - phase), return_inverse=True)
    sums = np.bincount(cycle, vectors.real) + 1j * np.bincount(cycle, vectors.imag)
    return np.asarray(np.angle(sums * np.conj(common)) / (2 * np.pi))


def _chance_of_arc(phases: NDArray[np.float64], arc: float, step: float) -> float:
    """An upper bound of the chance that some arc of a circle holds as many of n evenly distributed points as here.

    An arc that holds the most begins at one of the points: n P(Bin(n - 1, arc) >= most - 1), Boole's bound. If places
    come in steps (`step`, a part of the circle), an arc may hold as many as one that is a step longer.
    """
    ordered = np.sort(phases)
    around = np.concatenate((ordered, ordered + 1))
    inside = np.searchsorted(around, ordered + arc, side="right") - np.arange(ordered.size)
    most = min(ordered.size, int(inside.max()))
    return 1.0 if most < 2 else ordered.size * binomial_above(most - 2, ordered.size - 1, min(1.0, arc + step))


def _period(events: Int64s, frequency: float) -> float:
    """The median slope of events near the common phase against the number of their period: an event that belongs to no
    period would shift a mean.

    Each event of the first half is paired with its counterpart in the second half (Theil's incomplete method, 1950).
    The events used lie nearer and nearer to the phase.
    """
    phase = float(np.angle(np.exp(2j * np.pi * frequency * events).sum())) / (2 * np.pi)
    for near in _NEAR:
        turns = events * frequency - phase
        cycles = np.round(turns)
        chosen = abs(turns - cycles) < near
        half = int(chosen.sum()) // 2
        distance = cycles[chosen][-half:] - cycles[chosen][:half]
        slopes = (events[chosen][-half:] - events[chosen][:half])[distance > 0] / distance[distance > 0]
        if not slopes.size:
            break
        frequency = 1 / float(np.median(slopes))
        phase = float(np.median(events[chosen] * frequency - cycles[chosen]))
    return 1 / frequency


def _power(events: Int64s, frequency: float) -> float:
    return float(abs(np.exp(2j * np.pi * frequency * events).sum()) ** 2 / events.size)


def _refine(events: Int64s, frequency: float, length: int) -> float:
    """The frequency of the highest power near one of the transform's."""
    for width in (1 / (_PADDED * length), 0.1 / (_PADDED * length)):
        near: NDArray[np.float64] = np.linspace(frequency - width, frequency + width, 21)
        frequency = float(max(near, key=lambda candidate: _power(events, candidate)))
    return frequency


def _fundamental(events: Int64s, frequency: float, length: int, lowest: float) -> float:
    """The lowest frequency that explains as much, with at least `lowest` cycles in the run. Every multiple of it has
    much of its power, but no fraction of it has any."""
    power = _power(events, frequency)
    for parts in range(int(frequency * length / lowest), 1, -1):
        lower = frequency / parts
        if _power(events, lower) > 0.5 * power:
            return _refine(events, lower, length)
    return frequency
