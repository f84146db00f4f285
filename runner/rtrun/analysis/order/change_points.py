"""When did the level of a figure change? Each boot has one value of the figure; boots are in the order of time.

The values include the differences between boots, so a single boot that was a little slower is no change.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import normal_quantiles, student_quantile
from rtrun.analysis.chance.ranks import ranks
from rtrun.analysis.chance.welch import standard_error

Floats = NDArray[np.float64]

LEAST_UNITS = 3  # of a level
SEED = 20140715
_PERMUTATIONS = 499
_RESAMPLES = 199


@dataclass(frozen=True, kw_only=True, slots=True)
class ChangePoint:
    """A level that ends before the unit `index`, where the next one begins.

    `earliest` and `latest` are the ends of an interval for `index`. `before` and `after` are the means of the two
    levels, `low` and `high` an interval of their difference (Welch 1947), in the unit of the figure.
    """

    index: int
    earliest: int
    latest: int
    before: float
    after: float
    low: float
    high: float


def means_of_units(values: Floats, units: Sequence[str]) -> Floats:
    """The mean of the values (n,) of each unit (boot), shape (u,), in the order of their first values."""
    numbers = {unit: k for k, unit in enumerate(dict.fromkeys(units))}
    places = [numbers[unit] for unit in units]
    sums = np.bincount(places, weights=values, minlength=len(numbers))
    return np.asarray(sums / np.bincount(places, minlength=len(numbers)))


def find_changes(values: Floats, *, confidence: float = 0.95) -> tuple[ChangePoint, ...]:
    """Change points of values of units, shape (n,), in the order of time.

    PELT (Killick, Fearnhead & Eckley 2012) on the normal scores of the ranks, so that an outlier does not count for
    more than its rank. The penalty of a change comes from random orders of the same values: in all but 1 - confidence
    of them, the best change gains no more, alone or as one of two around a stretch. So the penalty does not depend on
    how the values are distributed, and a course without a change shows one with a chance of at most 1 - confidence.
    """
    ends = _ends_of_levels(values, confidence)
    rng = np.random.default_rng(SEED)
    starts = [0, *ends[:-1]]
    return tuple(
        _change(values[start:stop], index - start, start, confidence, rng)
        for start, index, stop in zip(starts[:-1], ends[:-1], ends[1:], strict=True)
    )


def levels(values: Floats, *, confidence: float = 0.95) -> list[slice]:
    """The stretches of values between changes."""
    ends = [0, *_ends_of_levels(values, confidence)]
    return [slice(start, stop) for start, stop in pairwise(ends)]


def _ends_of_levels(values: Floats, confidence: float) -> list[int]:
    if values.size < 2 * LEAST_UNITS or np.ptp(values) == 0:
        return [values.size]
    import ruptures

    ranked = ranks(values)
    penalty = _penalty(np.sort(ranked).tobytes(), confidence)
    search = ruptures.KernelCPD(kernel="linear", min_size=LEAST_UNITS).fit(_normal_scores(ranked)[:, None])
    return [int(end) for end in search.predict(pen=penalty)]


@functools.lru_cache(maxsize=1024)
def _penalty(sorted_ranks: bytes, confidence: float) -> float:
    """What the best change gains in random order. It depends on the ranks alone; without ties, on their number alone.

    `sorted_ranks` are float64.
    """
    rng = np.random.default_rng(SEED)
    scores = _normal_scores(np.frombuffer(sorted_ranks))
    shuffled = rng.permuted(np.tile(scores, (_PERMUTATIONS, 1)), axis=1)
    most = np.maximum(_gains(shuffled).max(axis=1), _gains_of_stretches(shuffled) / 2)
    return max(1e-9, float(np.quantile(most, confidence, method="higher")))


def _normal_scores(ranked: Floats) -> Floats:
    """Standard normal quantiles of ranks (van der Waerden); ties have the mean of their ranks. The mean score is 0."""
    scores = normal_quantiles(ranked / (ranked.size + 1))
    return np.asarray(scores - scores.mean())


def _gains(rows: Floats) -> Floats:
    """How much the sum of squares of each row (r, n) falls if it is split before each place, shape (r, s).

    The places leave LEAST_UNITS on both sides. Rows need not have the mean 0.
    """
    n = rows.shape[1]
    first = np.arange(LEAST_UNITS, n - LEAST_UNITS + 1)
    sums = np.cumsum(rows - rows.mean(axis=1, keepdims=True), axis=1)[:, first - 1]
    return np.asarray(sums**2 * (n / (first * (n - first))))


def _gains_of_stretches(rows: Floats) -> Floats:
    """How much the sum of squares of each row (r, n) falls if the best stretch gets its own level, shape (r,).

    The lengths of stretches that are tried grow by a third each time: lengths between these gain hardly more.
    """
    n = rows.shape[1]
    sums = np.cumsum(np.pad(rows - rows.mean(axis=1, keepdims=True), ((0, 0), (1, 0))), axis=1)
    most = np.zeros(len(rows))
    length = LEAST_UNITS
    while length <= n - 2 * LEAST_UNITS:
        inside = sums[:, length:] - sums[:, :-length]
        most = np.maximum(most, (inside**2).max(axis=1) * (n / (length * (n - length))))
        length = max(length + 1, length * 4 // 3)
    return most


def _change(values: Floats, place: int, start: int, confidence: float, rng: np.random.Generator) -> ChangePoint:
    """A change at `place` of the values of two neighbouring levels, which begin at unit `start`.

    The interval of its place: both levels are resampled with replacement, and each sample gives its best split.
    """
    before, after = values[:place], values[place:]
    draws = np.concatenate(
        [rng.choice(level, (_RESAMPLES, level.size)) for level in (before, after)],
        axis=1,
    )
    places = _gains(draws).argmax(axis=1) + LEAST_UNITS
    tail = (1 - confidence) / 2
    low_place, high_place = np.quantile(places, [tail, 1 - tail], method="nearest")
    low, high = _welch(before, after, confidence)
    return ChangePoint(
        index=start + place,
        earliest=start + min(place, int(low_place)),
        latest=start + max(place, int(high_place)),
        before=float(before.mean()),
        after=float(after.mean()),
        low=low,
        high=high,
    )


def _welch(a: Floats, b: Floats, confidence: float) -> tuple[float, float]:
    shift = float(b.mean() - a.mean())
    error, degrees = standard_error(a, b)
    reach = student_quantile((1 + confidence) / 2, degrees) * error
    return shift - reach, shift + reach
