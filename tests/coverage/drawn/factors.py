"""What makes a miss more or less probable: factors of mean 1 on the probability of a miss, at one level of a machine.

Each factor tells two things apart: what it is where the machine was measured (`of_...`), and what it is in the
population that the question is about (`population`), from which the truth is computed.
"""

import math
from dataclasses import dataclass

import numpy as np

Floats = np.ndarray
Rng = np.random.Generator


def strata(rng: Rng, size: int) -> Floats:
    """As many uniform numbers, one of each of so many equal parts of (0, 1), in random order."""
    return rng.permutation((np.arange(size) + rng.random(size)) / size)


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Moments of the population, arrays of one shape: the length of the run, the loop in it, and its index."""

    length: Floats
    loop: Floats


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where in the campaign an attempt is: run, boot and hour, of how many, and how much was measured before it."""

    run: int
    runs: int
    boot: int
    boots: int
    hour: float
    before: int
    total: int


class Factor:
    """One that changes nothing. `level` says for what one value is drawn: board, boot, run or none of them."""

    level: str

    def draw(self, rng: Rng) -> float:
        """Its value of one board, boot or attempt, by its level."""
        return 1.0

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        """What it is besides, in the loops of a run; an array of its length, or one number."""
        return 1.0

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        """What it is in the population."""
        return 1.0

    def until(self, place: Place) -> float:
        """What it still is after the run there, in parts of what it is in the population."""
        return 1.0

    def is_visible(self, values: list[float], places: list[Place]) -> bool:
        """Whether who looks at the files can see it, from its values in them."""
        return False


class OfLoops(Factor):
    """One that has a value of its own in each run, or in each loop."""

    level = ""


def _normal(uniform: Floats) -> Floats:
    from scipy.special import ndtri

    return np.asarray(ndtri(uniform))


@dataclass(frozen=True)
class Unlike(Factor):
    """Units that differ: lognormal, of mean 1."""

    level: str
    sd: float

    def draw(self, rng: Rng) -> float:
        return math.exp(self.sd * rng.standard_normal() - self.sd**2 / 2)

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return np.exp(self.sd * _normal(strata(rng, moments.loop.size)) - self.sd**2 / 2)

    def is_visible(self, values: list[float], places: list[Place]) -> bool:
        return len(values) > 1


@dataclass(frozen=True)
class TwoKinds(Factor):
    """Units of which a share is bad, and has a part of all misses."""

    level: str
    share: float
    part: float

    @property
    def kinds(self) -> tuple[float, float]:
        """Good and bad."""
        return (1 - self.part) / (1 - self.share), self.part / self.share

    def draw(self, rng: Rng) -> float:
        return self.kinds[int(rng.random() < self.share)]

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return np.where(strata(rng, moments.loop.size) < self.share, self.kinds[1], self.kinds[0])

    def is_visible(self, values: list[float], places: list[Place]) -> bool:
        return len(set(values)) > 1


@dataclass(frozen=True)
class SlowLoad(OfLoops):
    """A load that comes and goes within a run: it is there for a share of the time, each time for `mean` loops."""

    share: float
    part: float
    mean: float

    def states(self, rng: Rng, length: int) -> Floats:
        """Whether it is there, of each loop."""
        means = (self.mean * (1 - self.share) / self.share, self.mean)
        on = rng.random() < self.share
        ends: list[float] = []
        states: list[bool] = []
        passed = 0.0
        while passed < length:
            passed += max(1.0, rng.exponential(means[int(on)]))
            ends.append(passed)
            states.append(on)
            on = not on
        return np.asarray(states)[np.searchsorted(ends, np.arange(length), side="right").clip(max=len(states) - 1)]

    def of_states(self, states: Floats) -> Floats:
        return np.where(states, self.part / self.share, (1 - self.part) / (1 - self.share))

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return self.of_states(self.states(rng, length))

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return self.of_states(strata(rng, moments.loop.size) < self.share)


@dataclass(frozen=True)
class Beat(OfLoops):
    """Something else with a period of its own: a part of all misses comes while the two meet."""

    period: float
    share: float
    part: float

    def _of_phase(self, phase: Floats) -> Floats:
        return np.where(phase < self.share, self.part / self.share, (1 - self.part) / (1 - self.share))

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return self._of_phase((np.arange(length) / self.period + rng.random()) % 1.0)

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return self._of_phase(strata(rng, moments.loop.size))


@dataclass(frozen=True)
class Edge(OfLoops):
    """The first loops of each run, or its last ones, have a part of its misses; they fade in `loops` loops."""

    loops: float
    part: float
    is_end: bool

    def _of(self, loop: Floats, length: Floats) -> Floats:
        distance = length - 1 - loop if self.is_end else loop
        mass = self.loops * (1 - np.exp(-length / self.loops))
        return (1 - self.part) + self.part * length / mass * np.exp(-distance / self.loops)

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return self._of(np.arange(length), np.asarray(length))

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return self._of(moments.loop, moments.length)


@dataclass(frozen=True)
class Growing(OfLoops):
    """It climbs by so much in the logarithm."""

    climb: float

    def is_visible(self, values: list[float], places: list[Place]) -> bool:
        return self.climb > 4


@dataclass(frozen=True)
class Leak(Growing):
    """It climbs in each run; a process that lives a quarter longer is asked about."""

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return np.exp(self.climb * (np.arange(length) / length - 1))

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return np.exp(self.climb * strata(rng, moments.loop.size) / 4)


@dataclass(frozen=True)
class Ramp(Growing):
    """It climbs from the first loop of the campaign to the last; a twentieth of that time is asked about, after it."""

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return np.exp(self.climb * ((place.before + np.arange(length)) / place.total - 1))

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return np.exp(self.climb * strata(rng, moments.loop.size) * 0.05)


@dataclass(frozen=True)
class Climb(OfLoops):
    """Each boot is worse than the one before it; the next one is asked about."""

    climb: float

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return math.exp(self.climb * (place.boot / place.boots - 1))

    def is_visible(self, values: list[float], places: list[Place]) -> bool:
        return self.climb > 4 and max(place.boots for place in places) > 4


@dataclass(frozen=True)
class Step(OfLoops):
    """From one run on it is another machine; that one is asked about, by who asks then."""

    at_share: float
    before: float

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return self.until(place)

    def until(self, place: Place) -> float:
        return self.before if (place.run + 0.5) / place.runs < self.at_share else 1.0

    def is_visible(self, values: list[float], places: list[Place]) -> bool:
        return abs(math.log(self.before)) > 2 and len({place.run for place in places}) > 4


@dataclass(frozen=True)
class DayAndNight(OfLoops):
    """By day (8 to 20 o'clock) it has a part of its misses; all hours are asked about."""

    part: float

    def at(self, place: Place, rng: Rng, length: int) -> Floats | float:
        return 2 * (self.part if 8 <= place.hour < 20 else 1 - self.part)

    def population(self, moments: Moments, rng: Rng) -> Floats | float:
        return 2 * np.where(strata(rng, moments.loop.size) < 0.5, self.part, 1 - self.part)
