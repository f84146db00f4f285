"""Boots count alike however long each was measured, and so do boards: P(miss) is that of a boot like these.

Otherwise a boot that was measured a hundred times as long as the others would decide alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median_low

from rtrun.analysis.trials import Trials

Cluster = tuple[float, float]
"""Loops and misses of a unit."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CountedRun:
    """What a run counts for: `share` of its measurements and of its misses."""

    n: float
    misses: float
    share: float = 1.0

    def cut(self, part: float) -> "CountedRun":
        """A part of it, 0 to 1."""
        return replace(self, n=part * self.n, misses=part * self.misses, share=part * self.share)


def boots_of(runs: Sequence[Trials]) -> list[str]:
    """The boot of each run; a run of an unknown boot is a boot of its own."""
    return [f"{run.board} {run.boot}" if run.boot else f" {run.run or index}" for index, run in enumerate(runs)]


def count_alike(runs: Sequence[Trials]) -> list[CountedRun]:
    """What each run counts for: a boot with more measurements than the median boot counts for as many as that one.

    The same holds for boards. Shorter ones count in full. Lengths say nothing about rates, so all weights that depend
    on lengths alone estimate the same mean.
    """
    counted = [CountedRun(n=run.n, misses=run.late + run.absent) for run in runs]
    for keys in (boots_of(runs), [run.board for run in runs]):
        lengths = [n for n, _ in sums(counted, keys).values() if n]
        most = median_low(lengths) if lengths else 0.0
        of_key = {key: min(1.0, most / n) if n else 1.0 for key, (n, _) in sums(counted, keys).items()}
        counted = [run.cut(of_key[key]) for run, key in zip(counted, keys, strict=True)]
    return counted


def shorter(runs: Sequence[Trials], keys: Sequence[str]) -> int:
    """How many units, given by the key of each run, have fewer than half of the median unit's measurements.

    They hardly count beside the others. So if units of another kind end early, the misses of that kind hardly count,
    either.
    """
    lengths = [n for n, _ in sums([CountedRun(n=run.n, misses=0) for run in runs], keys).values()]
    return sum(2 * n < median_low(lengths) for n in lengths)


def sums(counted: Sequence[CountedRun], keys: Sequence[str]) -> dict[str, Cluster]:
    """Loops and misses of the runs of each key."""
    found: dict[str, Cluster] = {}
    for run, key in zip(counted, keys, strict=True):
        n, misses = found.get(key, (0.0, 0.0))
        found[key] = (n + run.n, misses + run.misses)
    return found
