"""Misses that lie near one another are one episode: how many there are, how long they last, and how often they come.

P(miss) does not tell how often they come. A bound on that needs no assumption about their length.
"""

import math
from dataclasses import dataclass

import numpy as np

from rtrun.analysis.dependence.design_effect import Events, locate
from rtrun.kinds.values import Int64s
from rtrun.plan.question import STALL_NS

_NS_PER_HOUR = 3.6e12
# A single loop on time between two misses ends neither a burst nor an episode, whatever the period is.
_LEAST_GAP = 2
# How many starts of episodes are kept: enough for the exact test of few.
_FEW = 20


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FoundEpisodes:
    """The episodes of one output of a run: where they begin, and the longest, in misses and from end to end in loops.

    ``begun_at`` are the loop positions of the first ones, int64 (e,). ``most_in_a_row`` is the longest burst: misses
    that follow one another; a single loop on time between two of them does not count.
    """

    begun: Events
    begun_at: Int64s
    longest_misses: int
    longest_loops: int
    most_in_a_row: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Episodes:
    """The episodes of all runs of a verdict: how many were ``seen``, the longest, and the most that may come.

    ``most_in_a_row`` is the longest burst (`FoundEpisodes`). ``longest_ns`` is None where the period is not known.
    ``per_hour_at_most`` bounds the episodes in an hour of a stream at the confidence asked for, however often somebody
    looks; None where there is no bound.
    """

    seen: int
    longest_misses: int
    most_in_a_row: int
    longest_ns: float | None
    per_hour_at_most: float | None


def gap_loops(period_ns: float | None) -> int:
    """The most loops from one miss to the next of the same episode: 10 ms, but at least two.

    A stall that a proof covers by default (`STALL_NS`) is then one episode, even if loops within it are on time.
    """
    return _LEAST_GAP if period_ns is None else max(_LEAST_GAP, math.floor(STALL_NS / max(period_ns, 1.0) + 0.5))


def find_episodes(misses: Int64s, loops: int, period_ns: float | None) -> FoundEpisodes:
    """Join misses, ascending loop positions int64 (k,) among `loops`, to episodes."""
    distances = np.diff(misses, prepend=np.iinfo(np.int64).min // 2)
    starts, rows = (np.flatnonzero(distances > gap) for gap in (gap_loops(period_ns), _LEAST_GAP))
    begun_at = misses[starts]
    sizes = np.diff(starts, append=misses.size)
    spans = misses[starts + sizes - 1] - begun_at + 1
    return FoundEpisodes(
        begun=locate(begun_at, loops),
        begun_at=begun_at[:_FEW],
        longest_misses=int(sizes.max(initial=0)),
        longest_loops=int(spans.max(initial=0)),
        most_in_a_row=int(np.diff(rows, append=misses.size).max(initial=0)),
    )


def per_hour(per_loop: float, period_ns: float) -> float:
    """The number per hour, from the number per loop."""
    return per_loop * _NS_PER_HOUR / period_ns
