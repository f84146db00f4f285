"""Do late values come at a fixed distance of time or of loops?"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.histogram import Int64s

ALPHA = 0.01
# Fewer events fit some period whatever they are.
LEAST_EVENTS = 12
# A period is seen this often at least, is this many times a loop at least, and most of its cycles have an event.
LEAST_CYCLES = 8
LEAST_LOOPS = 20
LEAST_COVERED = 0.5
_BINS_MAX = 1 << 20
# Zeros behind the data: without them a frequency between two that are tried keeps only 40 % of its power.
_PADDED = 2
# The width of a bin takes little of the power of a period that has this many.
_BINS_OF_PERIOD = 8
_PARTS_TRIED = 1000
_NEAR = (0.15, 0.05, 0.02)  # of a period


@dataclass(frozen=True, kw_only=True, slots=True)
class Recurrence:
    """Events every `period`, in the unit of their positions; `covered` of `cycles` periods have one.

    `p_value` is the probability that events without any period fit one of those tried as well.
    """

    period: float
    p_value: float
    events: int
    covered: int
    cycles: int


def find_recurrence(positions: Int64s, *, begin: int, end: int, loop: int, tried: int = 1) -> Recurrence | None:
    """The period of events at ascending positions between `begin` and `end`; None where none is significant.

    `loop` is the distance of two measurements. Events nearer than half of the shortest period to the one before are of
    one burst, which counts once. `tried` is the number of searches of which this is one.

    The frequency of the highest power |sum exp(2 pi i f t)|^2 / n is looked for by a fast Fourier transform. Its test
    is Rayleigh's (Mardia & Jupp 2000, section 6.3.1): without a period the power is exponential with mean 1. The phases
    are those of whole periods, because events that come in bursts depend on each other. The p-value is corrected after
    Bonferroni for all frequencies and searches.
    """
    length = end - begin
    shortest = LEAST_LOOPS * max(1, loop)
    events = positions[np.diff(positions, prepend=begin - shortest) > shortest // 2] - begin
    if events.size < LEAST_EVENTS or length < LEAST_CYCLES * shortest:
        return None
    bins = int(min(_BINS_MAX, length // max(1, loop)))
    counts = np.bincount(np.minimum(events * bins // length, bins - 1), minlength=bins).astype(np.float64)
    power = np.abs(np.fft.rfft(counts, n=_PADDED * bins)) ** 2 / events.size
    # Entry k is the frequency k / (_PADDED * length).
    first, last = _PADDED * LEAST_CYCLES, _PADDED * min(length // shortest, bins // _BINS_OF_PERIOD)
    if last <= first:
        return None
    best = first + int(np.argmax(power[first : last + 1]))
    frequency = _fundamental(events, _refine(events, best / (_PADDED * length), length), length)
    directions = _directions(events, frequency)
    p_value = min(1.0, (last - first + 1) * tried * float(np.exp(-(abs(directions.sum()) ** 2) / directions.size)))
    cycles = max(directions.size, round(length * frequency))
    if p_value > ALPHA or directions.size < max(LEAST_EVENTS, LEAST_COVERED * cycles):
        return None
    return Recurrence(
        period=_period(events, frequency),
        p_value=p_value,
        events=events.size,
        covered=directions.size,
        cycles=cycles,
    )


def _directions(events: Int64s, frequency: float) -> NDArray[np.complex128]:
    """The mean direction of the events of each period that has some: several of one period may depend on each other."""
    vectors = np.exp(2j * np.pi * frequency * events)
    phase = float(np.angle(vectors.sum())) / (2 * np.pi)
    _, cycle = np.unique(np.round(events * frequency - phase), return_inverse=True)
    sums = np.bincount(cycle, vectors.real) + 1j * np.bincount(cycle, vectors.imag)
    return np.asarray(sums / np.maximum(abs(sums), 1e-12))


def _period(events: Int64s, frequency: float) -> float:
    """The median distance of two events near the common phase, in periods: one of no period would shift a mean.

    Theil's and Sen's slope of the events against the number of their period, of those nearer and nearer to the phase.
    """
    phase = float(np.angle(np.exp(2j * np.pi * frequency * events).sum())) / (2 * np.pi)
    for near in _NEAR:
        turns = events * frequency - phase
        cycles = np.round(turns)
        chosen = abs(turns - cycles) < near
        first, second = np.triu_indices(int(chosen.sum()), 1)
        apart = cycles[chosen][second] - cycles[chosen][first]
        slopes = (events[chosen][second] - events[chosen][first])[apart > 0] / apart[apart > 0]
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
        frequency = float(max(near, key=lambda one: _power(events, one)))
    return frequency


def _fundamental(events: Int64s, frequency: float, length: int) -> float:
    """The lowest frequency that explains as much: every multiple of it has much of its power, no part any."""
    power = _power(events, frequency)
    for parts in range(min(_PARTS_TRIED, int(frequency * length / LEAST_CYCLES)), 1, -1):
        lower = frequency / parts
        if _power(events, lower) > 0.5 * power:
            return _refine(events, lower, length)
    return frequency
