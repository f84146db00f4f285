"""Does the order of units matter: are the first or the last of them worse, or is each a little worse than the last?

If the order of units does not matter, a p-value below x has the chance x, however much units differ (permutation test;
Westfall & Young 1993 for the largest of several statistics).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rtrun.analysis.chance.distributions import Floats
from rtrun.analysis.chance.ranks import ranks

SEED = 20140715
_PERMUTATIONS = 999
# How many random orders are made at a time: for ten thousand units they take 9 MiB.
_AT_A_TIME = 111
# Fewer standard deviations than this are no sign, and need no permutations.
_LEAST = 1.5


@dataclass(frozen=True, kw_only=True, slots=True)
class Order:
    """The strongest sign that the order of units matters; `p_value` is corrected for all signs that were examined.

    The `count` first or last units are higher than the others; or units get higher (lower) with time.
    """

    p_value: float
    where: Literal["first", "last", "rising", "falling"]
    count: int = 0

    def words(self, units: str) -> str:
        """Where it is higher, of `units` in the plural."""
        if not self.count:
            return f"in {'later' if self.where == 'rising' else 'earlier'} {units}"
        return f"in the {self.where} {f'{self.count} {units}' if self.count > 1 else units.removesuffix('s')}"


def find_order(strata: Sequence[Floats], *, by_height: bool) -> Order | None:
    """The strongest sign of an order in the values (m,) of the units of each stratum, which follow one another.

    The means of the first and the last 1, 2, 4, ... units are compared with all others, and values with their places
    (Spearman 1904). Ranks are compared, so that one high value does not hide what the others show; with `by_height`
    also the values themselves. None if no stratum holds two values that differ.
    """
    strata = [values for values in strata if values.size > 1 and np.ptp(values) > 0]
    if not strata:
        return None
    numbers = _numbers(min(values.size for values in strata))
    scores = [_scores(values, by_height) for values in strata]
    weights = [_weights(values.size, numbers) for values in strata]
    observed = np.ravel(sum(score @ weight for score, weight in zip(scores, weights, strict=True)))
    scale = sum(values.size - 1 for values in strata) ** 0.5
    best = int(observed.argmax())
    higher = _PERMUTATIONS
    if observed[best] > _LEAST * scale:
        rng = np.random.default_rng(SEED)
        highest = np.concatenate([_highest(scores, weights, rng) for _ in range(_PERMUTATIONS // _AT_A_TIME)])
        higher = int(np.count_nonzero(highest >= observed[best] - 1e-9))
    return _sign(best, numbers, (1 + higher) / (1 + _PERMUTATIONS))


def find_common_order(runs: Floats) -> Order | None:
    """The strongest sign that runs, whose pieces have the values (r, m), are higher in the same pieces of all of them.

    The signs are those of `find_order`; each run has one vote. Within a run neighbours may depend on one another. If
    nothing ties its course to its begin, any circular shift of its pieces is equally likely. None if fewer than two
    runs have values that differ.
    """
    runs = runs[np.ptp(runs, axis=1) > 0]
    r, m = runs.shape
    if r < 2:
        return None
    runs = runs - runs.mean(axis=1, keepdims=True)
    runs = runs / np.sqrt((runs**2).sum(axis=1, keepdims=True))
    numbers = _numbers(m)
    # Each sign of each run, in each shift of the run: (m shifts, r, signs).
    shifted = np.stack([np.roll(runs, shift, axis=1) for shift in range(m)]) @ _weights(m, numbers)
    observed = shifted[0].sum(axis=0)
    best = int(observed.argmax())
    higher = _PERMUTATIONS
    if observed[best] > _LEAST * np.sqrt(shifted.var(axis=0).sum(axis=0)[best]):
        rng = np.random.default_rng(SEED)
        drawn = rng.integers(0, m, (_PERMUTATIONS, r))
        highest = np.array([shifted[shifts, np.arange(r)].sum(axis=0).max() for shifts in drawn])
        higher = int(np.count_nonzero(highest >= observed[best] - 1e-9))
    return _sign(best, numbers, (1 + higher) / (1 + _PERMUTATIONS))


def signs_looked_at(m: int) -> int:
    """How many signs `m` units have: the p-value of the strongest is at most this many times that of a single one."""
    return 2 + 2 * len(_numbers(m))


def _numbers(m: int) -> list[int]:
    """1, 2, 4, ... up to half of so many."""
    return [2**power for power in range((m // 2).bit_length())]


def _sign(best: int, numbers: Sequence[int], p_value: float) -> Order:
    """The sign at index `best` of the columns of `_weights`, which repeat for each row of scores."""
    signs: list[tuple[Literal["first", "last", "rising", "falling"], int]] = [("rising", 0), ("falling", 0)]
    signs += [(where, number) for where in ("first", "last") for number in numbers]
    where, count = signs[best % len(signs)]
    return Order(p_value=p_value, where=where, count=count)


def _scores(values: Floats, by_height: bool) -> Floats:
    """Ranks, and `by_height` the values, shape (1 or 2, m): of mean 0 and standard deviation sqrt(m - 1)."""
    kinds = np.stack([ranks(values), values] if by_height else [ranks(values)])
    kinds = kinds - kinds.mean(axis=1, keepdims=True)
    return np.asarray(kinds * ((values.size - 1) / np.sqrt((kinds**2).sum(axis=1, keepdims=True))))


def _weights(m: int, numbers: Sequence[int]) -> Floats:
    """The weight of each unit in each sign, shape (m, signs), such that all have the same standard deviation."""
    place, j = np.arange(m)[:, None], np.array(numbers)
    rising = place - (m - 1) / 2
    first = np.where(place < j, 1.0, 0.0)
    columns = np.concatenate((rising, -rising, first, first[::-1]), axis=1)
    columns = columns - columns.mean(axis=0)
    return np.asarray(columns / np.sqrt((columns**2).sum(axis=0)))


def _highest(scores: Sequence[Floats], weights: Sequence[Floats], rng: np.random.Generator) -> Floats:
    """The strongest sign of each of some random orders."""
    sums: Floats | float = 0.0
    for score, weight in zip(scores, weights, strict=True):
        orders = rng.permuted(np.tile(np.arange(score.shape[1]), (_AT_A_TIME, 1)), axis=1)
        sums = sums + score[:, orders] @ weight
    return np.asarray(np.max(sums, axis=(0, 2)))
