"""Runs that hold the same counts: the same file under another name, for two measurements hardly ever make the same."""

import math
from collections.abc import Sequence
from itertools import pairwise

from rtrun.analysis.histogram import Histogram

# A run among ten thousand others has the same counts by chance less often than once in a thousand archives.
BY_CHANCE = 1e-12


def chance_of_same_counts(histogram: Histogram) -> float:
    """The highest chance with which any distribution makes just these counts: the multinomial one, at its own shares.

    1 where there is but one bin: a coarse clock says the same of every run.
    """
    counts = [*map(int, histogram.counts), histogram.overflow]
    n = sum(counts)
    log_chance = math.lgamma(n + 1) + sum(k * math.log(k / n) - math.lgamma(k + 1) for k in counts if k)
    return math.exp(min(0.0, log_chance))


def copies_among(histograms: Sequence[tuple[str, Histogram]]) -> dict[str, str]:
    """Which of these runs, by name, hold the same counts as another one: each with the name of that.

    A run has a histogram for each of its outputs.
    """
    alike: dict[tuple[bytes, bytes, int, int | None], list[str]] = {}
    for run, one in histograms:
        if chance_of_same_counts(one) < BY_CHANCE:
            key = (one.values_ns.tobytes(), one.counts.tobytes(), one.overflow, one.max_ns)
            alike.setdefault(key, []).append(run)
    copies: dict[str, str] = {}
    for runs in alike.values():
        for first, second in pairwise(dict.fromkeys(runs)):
            copies.setdefault(first, second)
            copies[second] = first
    return copies
