"""Did the process stay the same over a run? The tests use the places of events, not their heights."""

from dataclasses import dataclass, replace

import numpy as np

from rtrun.analysis.chance.distributions import Floats, binomial_above, chi_squared_above
from rtrun.analysis.order.units_in_order import find_order
from rtrun.kinds.values import Int64s

# Below this chance something counts as a change within runs. Few misses tell little, so for them it may be higher.
SIGNIFICANT = 0.01
SIGNIFICANT_OF_MISSES = 0.02
PARTS = 8
UNSTEADY = "the system changed while it was measured"
# Events are also compared from piece to piece. A piece is longer than any burst, so a change is not taken for a burst.
PIECES = 64
# Cochran (1954): the chi-squared test needs about five expected events in each part.
_LEAST_FOR_PARTS = 5 * PARTS


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """A sign that it did not stay the same, seen if ``p_value`` is below ``significant``.

    ``what`` says that in words. ``p_value`` is corrected for all tests made in the run. It is a change of how high
    values are, or of how often misses come. If a load comes and goes, ``missing_loops`` more would show whether it
    continues to.
    """

    p_value: float
    significant: float
    text: str
    what: str = UNSTEADY
    of_heights: bool = False
    missing_loops: int | None = None


def test_of_parts(positions: Int64s, loops: int) -> tuple[float, Int64s]:
    """P-value of the chi-squared test that events come as often in each eighth of the loops, and their counts (8,)."""
    counts = np.bincount(positions * PARTS // loops, minlength=PARTS)
    mean = positions.size / PARTS
    return chi_squared_above(float(((counts - mean) ** 2).sum() / mean), PARTS - 1), counts


def test_of_ends(positions: Int64s, loops: int) -> tuple[float, int, float]:
    """The p-value of gathering events at one end of a run, how many gather there, and in what fraction of the run.

    For uniform places the j-th event from an end lies within a fraction f of it with the chance P(Bin(k, f) >= j).
    That is exact (order statistics; David & Nagaraja 2003, section 2.1), taken at j = 1, 2, 4, ... from both ends and
    corrected after Bonferroni. A negative fraction is one at the start of the run.
    """
    k = positions.size
    j = 2 ** np.arange(k.bit_length())
    at_end = (loops - positions[k - j]) / loops
    at_start = (positions[j - 1] + 1) / loops
    within = np.concatenate((at_end, at_start)).tolist()
    chances = [binomial_above(count - 1, k, part) for count, part in zip(np.tile(j, 2).tolist(), within, strict=True)]
    best = int(np.argmin(chances))
    fraction = np.concatenate((at_end, -at_start))[best]
    return min(1.0, chances[best] * len(chances)), int(np.tile(j, 2)[best]), float(fraction)


def find_change(positions: Int64s, loops: int, events: str, significant: float = SIGNIFICANT) -> Change | None:
    """The strongest sign that `events` at ascending positions, int64 (k,), come unevenly; None with fewer than 2.

    Three tests: do events gather at an end, do they come as often in each eighth, and are the first or last pieces of
    the run worse than others (`test_of_order`)? In the first two, events nearer to the one before than 1/500 of the run
    count once, so that a burst is not taken for a change (runs declustering, Smith & Weissman 1994; the intervals
    estimator would take a change for one long burst). The last test needs no such rule, and sees changes that the rule
    hides.
    """
    if positions.size < 2 or loops < PIECES:
        return None
    found = [*_in_pieces(positions, loops, events, significant), *_by_places(positions, loops, events, significant)]
    strongest = min(found, key=lambda change: change.p_value, default=None)
    return strongest and replace(strongest, p_value=min(1.0, len(found) * strongest.p_value))


def count_until(positions: Int64s, ends: Int64s) -> Int64s:
    """How many events at ascending positions, int64 (k,), lie between each of ascending ends (m,) and the previous
    one."""
    return np.diff(np.searchsorted(positions, ends), prepend=0).astype(np.int64)


def _in_pieces(positions: Int64s, loops: int, events: str, significant: float) -> list[Change]:
    ends = np.arange(1, PIECES + 1) * loops // PIECES
    counts = count_until(positions, ends)
    if np.count_nonzero(counts) < 2:
        return []  # it may be one burst
    p_value, text = test_of_order(counts, np.diff(ends, prepend=0), events)
    return [Change(p_value=p_value, significant=significant, text=f"{text} pieces of a run")]


def _by_places(positions: Int64s, loops: int, events: str, significant: float) -> list[Change]:
    starts = positions[np.diff(positions, prepend=-loops) > loops // 500]
    if starts.size < 2:
        return []
    ends_p, count, fraction = test_of_ends(starts, loops)
    where = "last" if fraction > 0 else "first"
    if starts.size < positions.size:
        events = f"bursts of {events}"
    ends = Change(
        p_value=ends_p,
        significant=significant,
        text=f"{_out_of(count, starts.size)} {events} lie in the {where} {100 * abs(fraction):.2g} % of a run",
    )
    if starts.size < _LEAST_FOR_PARTS:
        return [ends]
    parts_p, counts = test_of_parts(starts, loops)
    return [ends, Change(p_value=parts_p, significant=significant, text=_uneven(counts, events))]


def _out_of(count: int, total: int) -> str:
    return f"all {total}" if count == total else f"{count} of the {total}"


def _uneven(counts: Int64s, events: str) -> str:
    """Where a run has more events than elsewhere, from their counts in its eighths, in words."""
    more = np.flatnonzero(counts > counts.mean())
    first, last = (int(more[0]), int(more[-1])) if more.size else (0, PARTS)
    if more.size != last - first + 1:
        return f"{events} do not come evenly, in eighths of a run: {', '.join(map(str, counts))}"
    inside = f"{_out_of(counts[more].sum(), counts.sum())} {events} lie in"
    if not first or last == PARTS - 1:
        return f"{inside} the {'last' if first else 'first'} {100 * more.size / PARTS:.3g} % of a run"
    return f"{inside} {100 * more.size / PARTS:.3g} % of a run, after {100 * first / PARTS:.3g} % of it"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Visits:
    """The visits of a higher level of events: the loops at which each began, int64 (v,), ascending."""

    starts: Int64s

    @property
    def returns(self) -> int:
        """How often it was left and entered again."""
        return max(0, self.starts.size - 1)


def find_visits(positions: Int64s, loops: int) -> Visits:
    """When events at ascending positions, int64 (k,), came more often than on average, and then less often again.

    The number of events so far, minus that of an even rate, rises while events are frequent and falls while they are
    rare. A rise or fall of at least a quarter of its range is a change of level if it is beyond chance: events at an
    even rate rise and fall k / h^2 times by h (a random walk of k steps). So a drift or a step is one rise and one
    fall, and a load that comes and goes has one of each per turn.
    """
    k = positions.size
    even = positions * (k / loops)
    # The course just before and just after each event.
    course = np.stack((np.arange(k) - even, np.arange(1, k + 1) - even), axis=1).ravel()
    least = max(np.ptp(course) / 4, k**0.5) if k else 0.0
    starts: list[int] = []
    low = high = 0.0
    low_at, rising = 0, False
    for place, height in zip(np.repeat(positions, 2).tolist(), course.tolist(), strict=True):
        if height < low:
            low, low_at = height, place
        if rising:
            high = max(high, height)
            if high - height >= least:
                rising, low, low_at = False, height, place
        elif height - low >= least:
            rising, high = True, height
            starts.append(low_at)
    return Visits(starts=np.array(starts, np.int64))


def beyond_even(counts: Int64s, loops: Int64s) -> Floats:
    """By how many standard deviations of independent events each unit has more than at an even rate, (m,)."""
    return np.asarray((counts - counts.sum() * (loops / loops.sum())) / np.sqrt(np.maximum(loops, 1)))


def test_of_order(counts: Int64s, loops: Int64s, events: str) -> tuple[float, str]:
    """P-value of the test that the order of units does not matter to their events, and the strongest sign in words.

    `counts` and `loops` are int64 (m,), events and loops of units (pieces, visits of a load) in the order of time. The
    words end before the name of the units.
    """
    order = find_order([beyond_even(counts, loops)], by_height=True)
    if order is None:
        return 1.0, f"{events} come as often in each of {counts.size}"
    number = order.count or counts.size // 2
    where = "last" if order.where in ("last", "rising") else "first"
    inside = int(counts[counts.size - number :].sum() if where == "last" else counts[:number].sum())
    return order.p_value, f"{_out_of(inside, counts.sum())} {events} lie in the {where} {number} of {counts.size}"
