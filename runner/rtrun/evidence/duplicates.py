"""Runs that hold the measurements of another run: the same counts, or the same values in the same places."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from rtrun.analysis.histogram import Histogram
from rtrun.analysis.trials import Trials
from rtrun.kinds.values import Int64s

# With this chance for each pair, fewer than one in a thousand archives of ten thousand runs has equal counts by chance.
BY_CHANCE = 1e-12
# How many of the highest values of a run are compared, and how many must lie at the same distances in two runs. Two
# separate measurements of 10 000 loops with a clock of 1 us share two or three.
_COMPARED = 64
SHARED_LEAST = 10
_PLACES_MAX = 1000  # a value at more places comes from a coarse clock, and tells nothing


def chance_of_same_counts(histogram: Histogram) -> float:
    """The highest chance of exactly these counts under any distribution: multinomial, with the shares of the counts.

    It is 1 if there is only one bin: with a coarse clock all runs have the same counts.
    """
    counts = [*map(int, histogram.counts), histogram.overflow]
    n = sum(counts)
    log_chance = math.lgamma(n + 1) + sum(k * math.log(k / n) - math.lgamma(k + 1) for k in counts if k)
    return math.exp(min(0.0, log_chance))


def copies_among(histograms: Sequence[tuple[str, Histogram]]) -> dict[str, str]:
    """Find runs whose counts are equal: the name of each, with that of the other run.

    A run has a histogram for each of its outputs.
    """
    alike: dict[tuple[bytes, bytes, int, int | None], list[str]] = {}
    for run, histogram in histograms:
        if chance_of_same_counts(histogram) < BY_CHANCE:
            key = (histogram.values_ns.tobytes(), histogram.counts.tobytes(), histogram.overflow, histogram.max_ns)
            alike.setdefault(key, []).append(run)
    copies: dict[str, str] = {}
    for runs in alike.values():
        for first, second in pairwise(dict.fromkeys(runs)):
            copies.setdefault(first, second)
            copies[second] = first
    return copies


def overlaps_among(trials: Sequence[tuple[str, Trials]]) -> dict[str, str]:
    """Find runs that share values with another run: the name of each, with that of the other run.

    A log that was appended to, cut off, shifted or edited is another file, but its highest values have the same
    distances. The start-ups of two measurements may be alike, so the tenth with most of the shared values does not
    count. A run with periodic values resembles itself some time later, so two runs must share twice as many values as
    that.
    """
    if not trials:
        return {}
    names = list(dict.fromkeys(run for run, _ in trials))
    number_of = {name: number for number, name in enumerate(names)}
    numbers = [number_of[run] for run, _ in trials]
    highest = [np.argsort(-output.high_ns, kind="stable")[:_COMPARED] for _, output in trials]
    heights_ns = np.concatenate([output.high_ns[chosen] for (_, output), chosen in zip(trials, highest, strict=True)])
    places = np.concatenate([output.high_at[chosen] for (_, output), chosen in zip(trials, highest, strict=True)])
    runs = np.repeat(numbers, [chosen.size for chosen in highest])
    loops = np.zeros(len(names), np.int64)
    np.maximum.at(loops, numbers, [output.n for _, output in trials])

    first, second = _each_two_alike(heights_ns)
    # Subscribers of one run measure the same moments.
    distinct = (runs[first] != runs[second]) | (places[first] != places[second])
    first, second = first[distinct], second[distinct]
    if not first.size:
        return {}
    run, other, distance = runs[first], runs[second], places[first] - places[second]
    order = np.lexsort((distance, other, run))
    run, other, distance, first = run[order], other[order], distance[order], first[order]
    is_new = (np.diff(run) != 0) | (np.diff(other) != 0) | (np.diff(distance) != 0)
    begins = np.concatenate(([0], np.flatnonzero(is_new) + 1))
    counts = np.diff(begins, append=run.size)
    like_itself = np.zeros(len(names), np.int64)
    own = run[begins] == other[begins]
    np.maximum.at(like_itself, run[begins[own]], counts[own])
    overlaps: dict[str, str] = {}
    many = np.flatnonzero(~own & (counts >= SHARED_LEAST))
    for begin, count in zip(begins[many].tolist(), counts[many].tolist(), strict=True):
        a, b, ahead = int(run[begin]), int(other[begin]), int(distance[begin])
        start, end = max(0, ahead), min(int(loops[a]), int(loops[b]) + ahead)
        tenths = (places[first[begin : begin + count]] - start) * 10 // (end - start)
        count -= int(np.bincount(tenths).max())
        if count >= max(SHARED_LEAST, 2 * int(like_itself[[a, b]].max())):
            overlaps.setdefault(names[a], names[b])
            overlaps.setdefault(names[b], names[a])
    return overlaps


def _each_two_alike(values: Int64s) -> tuple[Int64s, Int64s]:
    """The places of all pairs of equal values, the earlier ones first; both int64 of shape (pairs,)."""
    order = np.argsort(values, kind="stable")
    alike = np.split(order, np.flatnonzero(np.diff(values[order])) + 1)
    pairs = [group[np.stack(np.triu_indices(group.size, 1))] for group in alike if 1 < group.size <= _PLACES_MAX]
    first, second = np.concatenate(pairs, axis=1) if pairs else np.empty((2, 0), np.int64)
    return first, second
