"""How many independent measurements n dependent ones equal, because misses come in bursts."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from rtrun.kinds.values import Int64s

_LEAST_BLOCKS = 16
_CHANCE = 2.58  # standard errors: exceeded once in two hundred times
_CHANCE_OF_GAPS = 0.05


@dataclass(frozen=True, kw_only=True)
class Events:
    """Events (misses, values above a level) of one or more runs, as sums over blocks of 2, 4, 8, ... loops.

    ``blocks[j]`` is (blocks, events in them, sum of squared events a block) for blocks of ``2 ** (j + 1)`` loops; an
    incomplete last block is left out. ``loops`` and ``count`` are measurements and events in all runs.
    """

    blocks: tuple[tuple[int, int, int], ...]
    loops: int
    count: int


def locate(positions: Int64s, loops: int) -> Events:
    """Events of one run from their ascending loop positions, int64 (k,), among `loops` measurements."""
    blocks = []
    for scale in range(1, max(1, loops.bit_length())):
        whole = loops >> scale
        inside = positions[: np.searchsorted(positions, whole << scale)] >> scale
        starts = np.flatnonzero(np.diff(inside, prepend=-1))
        sizes = np.diff(starts, append=inside.size)
        blocks.append((whole, int(inside.size), int(np.dot(sizes, sizes))))
    return Events(blocks=tuple(blocks), loops=loops, count=int(positions.size))


def pool(parts: Iterable[Events]) -> Events:
    """The events of several runs together; no block spans two runs."""
    sums: dict[int, tuple[int, int, int]] = {}
    loops = events = 0
    for part in parts:
        loops, events = loops + part.loops, events + part.count
        for scale, (whole, count, squares) in enumerate(part.blocks):
            a, b, c = sums.get(scale, (0, 0, 0))
            sums[scale] = (a + whole, b + count, c + squares)
    return Events(blocks=tuple(sums[scale] for scale in sorted(sums)), loops=loops, count=events)


def design_effect(*parts: Events) -> float:
    """The variance of the number of events, divided by that of independent ones (Kish 1965); at least 1.

    The scatter of events is measured in each part against its own share; pool parts whose shares are the same. The
    index of dispersion of block counts is taken for each block length that leaves 16 blocks. The effect is the largest
    of those that independent events (mean 1, standard error sqrt(2/m + 1/k)) would exceed only once in two hundred
    times. For independent bursts of size S it tends to E[S^2]/E[S].
    """
    parts = tuple(part for part in parts if 0 < part.count < part.loops)
    n, k = sum(part.loops for part in parts), sum(part.count for part in parts)
    if k < 2:
        return 1.0
    worst = 1.0
    for scale in range(max(len(part.blocks) for part in parts)):
        scatter = expected = 0.0
        whole = used = 0
        for part in parts:
            blocks, inside, squares = part.blocks[scale] if scale < len(part.blocks) else (0, 0, 0)
            if blocks:
                share = part.count / part.loops
                mean = share * (2 << scale)
                scatter += squares - 2 * mean * inside + blocks * mean * mean
                expected += blocks * mean * (1 - share)
                whole, used = whole + blocks, used + 1
        if whole - used < _LEAST_BLOCKS - 1:
            continue
        dispersion = scatter / expected * whole / (whole - used)
        if dispersion - 1 > _CHANCE * math.sqrt(2 / whole + 1 / k):
            worst = max(worst, dispersion)
    return min(worst, float(n))


def cluster_effect(clusters: Sequence[tuple[float, float]]) -> float:
    """The variance of the pooled share, divided by that of independent trials, from (loops, events) of each cluster
    (boot, run).

    Ratio estimator over clusters (Cochran 1977, section 11.8), the design effect of Rao & Scott (1992). It is 0 if all
    clusters have the same share; 1 if there are no events, fewer than two clusters, or nothing but events.
    """
    n, k = (sum(numbers) for numbers in zip(*clusters, strict=True)) if clusters else (0, 0)
    if len(clusters) < 2 or not 0 < k < n:
        return 1.0
    p = k / n
    squares = sum((events - p * loops) ** 2 for loops, events in clusters)
    return len(clusters) / (len(clusters) - 1) * squares / (n * p * (1 - p))


def chance_of_gaps(n: int, k: int, gap: int, short: int) -> float:
    """P(at least `short` of the k - 1 distances between k events are at most `gap`), for k of n places chosen at
    random.

    Exact: i given distances are all longer in C(n - i gap, k) of C(n, k) cases, joined by inclusion and exclusion
    (Feller 1968, sections II.12 and IV.5).
    """
    longer = k - short
    cases = sum(
        (-1) ** (i - longer) * math.comb(i - 1, longer - 1) * math.comb(k - 1, i) * math.comb(max(0, n - i * gap), k)
        for i in range(longer, k)
    )
    return float(1 - Fraction(cases, math.comb(n, k)))


def effect_of_few(positions: Int64s, loops: int) -> float:
    """Design effect of a few events at ascending positions (k,): the sum of S^2 divided by that of S, the sizes of
    their bursts.

    Events belong to one burst if they are near enough. The limit is the longest distance, below half the mean distance,
    for which the number of distances as short is beyond chance (`chance_of_gaps`, 5 % after Bonferroni). The effect is
    that of a compound Poisson process (Adelson 1966).
    """
    gaps = np.diff(positions)
    ordered = np.sort(gaps)
    longest = 0
    for gap in np.unique(ordered[2 * ordered * positions.size <= loops]).tolist():
        short = int(np.searchsorted(ordered, gap, side="right"))
        if chance_of_gaps(loops, positions.size, gap, short) < _CHANCE_OF_GAPS / gaps.size:
            longest = gap
    starts = np.flatnonzero(np.concatenate(([True], gaps > longest)))
    sizes = np.diff(starts, append=positions.size)
    return float((sizes**2).sum() / sizes.sum()) if positions.size else 1.0


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
    # Several gaps may be as long as the shortest one between bursts. Choosing among them would be arbitrary: none is
    # taken.
    shortest = np.partition(gaps, gaps.size - between)[gaps.size - between]
    if np.count_nonzero(gaps >= shortest) > between and shortest < gaps.max():
        shortest += 1
    return np.concatenate(([0], np.flatnonzero(gaps >= shortest) + 1)).astype(np.int64)
