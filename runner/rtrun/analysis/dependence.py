"""How much n dependent measurements are worth: bursts, and the number of independent ones they equal."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rtrun.analysis.histogram import Int64s

_LEAST_BLOCKS = 16
_LEAST_RUNS = 8
_CHANCE = 2.58


@dataclass(frozen=True, kw_only=True)
class Events:
    """Where events (misses, values above a level) lie in one or more runs, as sums over blocks of 2, 4, 8, ... loops.

    ``blocks[j]`` is (blocks, events in them, sum of squared events a block) for blocks of ``2 ** (j + 1)`` loops; an
    incomplete last block is left out. ``runs`` is (loops, events) of every run. Small, and sums of runs are sums.
    """

    blocks: tuple[tuple[int, int, int], ...]
    runs: tuple[tuple[int, int], ...]

    @property
    def loops(self) -> int:
        """Measurements in all runs."""
        return sum(loops for loops, _ in self.runs)

    @property
    def count(self) -> int:
        """Events in all runs."""
        return sum(count for _, count in self.runs)


def locate(positions: Int64s, loops: int) -> Events:
    """Events of one run from their ascending loop positions, int64 (k,), among `loops` measurements."""
    blocks = []
    for scale in range(1, max(1, loops.bit_length())):
        whole = loops >> scale
        inside = positions[: np.searchsorted(positions, whole << scale)] >> scale
        starts = np.flatnonzero(np.diff(inside, prepend=-1))
        sizes = np.diff(starts, append=inside.size)
        blocks.append((whole, int(inside.size), int(np.dot(sizes, sizes))))
    return Events(blocks=tuple(blocks), runs=((loops, int(positions.size)),))


def pool(parts: Iterable[Events]) -> Events:
    """The events of several runs together; no block spans two runs."""
    sums: dict[int, tuple[int, int, int]] = {}
    runs: list[tuple[int, int]] = []
    for part in parts:
        runs.extend(part.runs)
        for scale, (whole, count, squares) in enumerate(part.blocks):
            a, b, c = sums.get(scale, (0, 0, 0))
            sums[scale] = (a + whole, b + count, c + squares)
    return Events(blocks=tuple(sums[scale] for scale in sorted(sums)), runs=tuple(runs))


def design_effect(events: Events) -> float:
    """Variance of the number of events over that of independent ones (Kish 1965), at least 1.

    It is the largest index of dispersion of block counts over all block lengths that leave 16 blocks, and over whole
    runs where there are 8, among those that independent events (mean 1, standard error sqrt(2/m + 1/k)) would exceed
    only once in two hundred times. For independent bursts of size S it tends to E[S^2]/E[S].
    """
    n, k = events.loops, events.count
    if k < 2 or k >= n:
        return 1.0
    p = k / n
    worst = 1.0
    for scale, (whole, inside, squares) in enumerate(events.blocks):
        if whole < _LEAST_BLOCKS:
            continue
        mean = p * (2 << scale)
        scatter = squares - 2 * mean * inside + whole * mean * mean
        worst = max(worst, _beyond_chance(scatter / (mean * (1 - p)) / (whole - 1), whole, k))
    if len(events.runs) >= _LEAST_RUNS:
        chi2 = sum((count - loops * p) ** 2 / (loops * p * (1 - p)) for loops, count in events.runs if loops)
        worst = max(worst, _beyond_chance(chi2 / (len(events.runs) - 1), len(events.runs), k))
    return min(worst, float(n))


def _beyond_chance(dispersion: float, blocks: int, events: int) -> float:
    return dispersion if dispersion - 1 > _CHANCE * math.sqrt(2 / blocks + 1 / events) else 1.0


def extremal_index(positions: Int64s) -> float:
    """Share of exceedances that start a burst, from the gaps between them: the intervals estimator, 0 < theta <= 1.

    Ferro & Segers (2003), equations 8 and 9. Needs two exceedances; ascending positions, int64 (k,).
    """
    gaps = np.diff(positions).astype(np.float64)
    if gaps.size == 0:
        return 1.0
    if gaps.max() <= 2:
        theta = 2 * gaps.sum() ** 2 / (gaps.size * np.dot(gaps, gaps))
    else:
        theta = 2 * (gaps - 1).sum() ** 2 / (gaps.size * np.dot(gaps - 1, gaps - 2))
    return float(min(1.0, theta))


def burst_starts(positions: Int64s, theta: float) -> Int64s:
    """Indices into `positions` where a burst begins: after its ``theta * k`` longest gaps (Ferro & Segers 2003)."""
    if positions.size == 0:
        return np.empty(0, np.int64)
    gaps = np.diff(positions)
    between = min(gaps.size, max(0, math.floor(theta * positions.size) - 1))
    if between == 0:
        return np.zeros(1, np.int64)
    # A tie at the shortest gap between bursts would make the choice arbitrary: then only longer gaps count.
    shortest = np.partition(gaps, gaps.size - between)[gaps.size - between]
    if np.count_nonzero(gaps >= shortest) > between and shortest < gaps.max():
        shortest += 1
    return np.concatenate(([0], np.flatnonzero(gaps >= shortest) + 1)).astype(np.int64)
