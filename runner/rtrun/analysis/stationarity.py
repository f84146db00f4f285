"""Did the process stay the same over a run? Tests on where events lie; independent of how high they are."""

from dataclasses import dataclass, replace

import numpy as np

from rtrun.analysis.histogram import Int64s

# Below this chance a change counts as seen; a few misses tell little, so that theirs is seen sooner.
SIGNIFICANT = 0.01
SIGNIFICANT_OF_MISSES = 0.05
PARTS = 8
# Cochran (1954): the chi-squared test needs about five expected events in each part.
_LEAST_FOR_PARTS = 5 * PARTS


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """The strongest sign in one run that it did not stay the same, seen if ``p_value`` is below ``significant``.

    ``p_value`` is corrected for all tests made in the run.
    """

    p_value: float
    significant: float
    text: str


def test_of_parts(positions: Int64s, loops: int) -> tuple[float, Int64s]:
    """P-value of the chi-squared test that events come as often in each eighth of the loops, and their counts (8,)."""
    from scipy.special import chdtrc

    counts = np.bincount(positions * PARTS // loops, minlength=PARTS)
    mean = positions.size / PARTS
    return float(chdtrc(PARTS - 1, float(((counts - mean) ** 2).sum() / mean))), counts


def test_of_ends(positions: Int64s, loops: int) -> tuple[float, int, float]:
    """P-value of the test that events do not gather at one end of a run; the number that does, and in what fraction.

    For uniform places the j-th event from an end lies within a fraction f of it with the chance P(Bin(k, f) >= j).
    That is exact (order statistics; David & Nagaraja 2003, section 2.1), taken at j = 1, 2, 4, ... from both ends and
    corrected after Bonferroni. A negative fraction is one at the start of the run.
    """
    from scipy.special import bdtrc

    k = positions.size
    j = 2 ** np.arange(k.bit_length())
    at_end = (loops - positions[k - j]) / loops
    at_start = (positions[j - 1] + 1) / loops
    chances = np.concatenate((bdtrc(j - 1, k, at_end), bdtrc(j - 1, k, at_start)))
    best = int(chances.argmin())
    fraction = np.concatenate((at_end, -at_start))[best]
    return min(1.0, float(chances[best]) * chances.size), int(np.tile(j, 2)[best]), float(fraction)


def find_change(positions: Int64s, loops: int, events: str, significant: float = SIGNIFICANT) -> Change | None:
    """The strongest sign that `events` at ascending positions, int64 (k,), do not come evenly; None with fewer than 2.

    Events nearer to the one before than 1/500 of the run count once, so that a burst is not taken for a change (runs
    declustering, Smith & Weissman 1994; the intervals estimator would take a change for one long burst).
    """
    starts = positions[np.diff(positions, prepend=-loops) > loops // 500]
    if starts.size < 2:
        return None
    ends_p, count, fraction = test_of_ends(starts, loops)
    where = "last" if fraction > 0 else "first"
    ends = Change(
        p_value=ends_p,
        significant=significant,
        text=f"{count} of {starts.size} {events} lie in the {where} {100 * abs(fraction):.2g} % of a run",
    )
    if starts.size < _LEAST_FOR_PARTS:
        return ends
    parts_p, counts = test_of_parts(starts, loops)
    text = f"{events} in eighths of a run: {', '.join(map(str, counts))}"
    parts = Change(p_value=parts_p, significant=significant, text=text)
    strongest = min(ends, parts, key=lambda change: change.p_value)
    return replace(strongest, p_value=min(1.0, 2 * strongest.p_value))
