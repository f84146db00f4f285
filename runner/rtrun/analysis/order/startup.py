"""Where a start-up ends: the first loops are worse, then this fades (caches, page faults, a governor that ramps up).

Blocks of consecutive loops are compared by their ranks. In a run that stays the same, however dependent its values are,
each of m blocks is the worst one with the chance 1/m. So only the place of the bad blocks is a sign: one burst or one
load at the start of one run is not, bad first blocks in most runs are.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import Floats, binomial_above
from rtrun.analysis.trials import Trials, count_misses, loop_positions
from rtrun.kinds.lateness import are_late, first_late_ns
from rtrun.kinds.values import Int64s

# Below this chance the first loops are a start-up, after Bonferroni for all lengths, patterns and kinds of events.
SIGNIFICANT = 0.001
# At most this fraction (1 / MOST) of the shortest run is left out.
MOST = 5
# The shortest blocks, in loops. Longer ones have twice, four times, ... as many.
BLOCK = 32
# For each length, this many first blocks are kept, and this many others: pairs of neighbours from all of the run.
_FIRST, _OTHERS = 16, 112
# Patterns: the first 1, 2 or 3 blocks are the worst ones, each worse than the next.
_PATTERNS = 3
# If neighbours correlate more than this, the order of blocks means nothing.
_ALIKE = 0.25
# Ends of a start-up that are tried, in blocks; 2 and 3 only for the shortest blocks.
_ENDS = (2, 3, 4, 5, 6, 7)
# Faded: between an end and twice the end, the excess over the rest is at most so many standard errors.
_FADED = 1.64
# The limit for all longer ends; it is higher because these are many.
_SURELY_FADED = 4.0
# Or it is at most this part of the excess before the end. For the chosen end, this counts only at the longest one.
_REST = 0.2
_QUANTILES_OF = 16384
# An eighth of all values exceed the lowest level, half as many each further one, at least so many the highest.
_LOWEST, _LEAST_ABOVE = 3, 50


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Head:
    """How much worse the first blocks of one output of a run are than all others, for each length of blocks.

    Tables are float64 (kinds, lengths), for each kind of events (high values, misses) and each length. ``blocks`` is
    the number of blocks compared, 0 where there is no event; ``worst`` of them are the worst ones. The first
    ``leading`` are worse than all others, each worse than the next; where this is 1, the first may share the worst
    count with others. ``variance`` is that of the blocks behind the first ones, ``covariance`` that of neighbours.
    ``before`` and ``behind`` (kinds, lengths, ends) are the excess of events over the mean of those blocks: before each
    end, and between it and twice the end. ``loops`` are those of the run.
    """

    loops: int
    blocks: Floats
    worst: Floats
    leading: Floats
    variance: Floats
    covariance: Floats
    before: Floats
    behind: Floats


@dataclass(frozen=True, kw_only=True, slots=True)
class StartUp:
    """The first `loops` of each run are worse than what follows (by chance with ``p_value``); then it has faded."""

    loops: int
    p_value: float


@dataclass(frozen=True, kw_only=True, slots=True)
class LeftOut:
    """What a verdict leaves out as start-up: the first `loops` of each run, with the misses in all of them."""

    loops: int
    late: int
    absent: int
    worst_ns: int | None
    p_value: float


def left_out(startup: StartUp, heads: Sequence[Trials]) -> LeftOut:
    """What is left out, from the trials of the first loops of every output."""
    return LeftOut(
        loops=startup.loops,
        late=sum(head.late for head in heads),
        absent=sum(head.absent for head in heads),
        worst_ns=max((head.worst_ns for head in heads if head.worst_ns is not None), default=None),
        p_value=startup.p_value,
    )


def split(values_ns: Int64s, absent: Int64s, deadline_ns: int, loops: int) -> tuple[Trials, Int64s, Int64s]:
    """The trials of the first loops of an output, and the values and absent places of what follows, as in `head_of`."""
    missing = int(np.searchsorted(absent, loops))
    came = min(loops - missing, values_ns.size)
    return count_misses(values_ns[:came], deadline_ns, absent[:missing]), values_ns[came:], absent[missing:] - loops


def head_of(values_ns: Int64s, absent: Int64s, deadline_ns: int) -> Head:
    """What is kept of the start of one output: values are int64 (n,) in loop order, `absent` (a,) the ascending loop
    positions of values that never came. These count as above all levels."""
    loops = values_ns.size + absent.size
    # The longest blocks still fit 4 times into a fifth of the run, thus 20 times into the run.
    lengths = max(0, (loops // (4 * MOST * BLOCK)).bit_length())
    whole = loops // BLOCK
    tables = [np.zeros((2, lengths)) for _ in range(5)]
    excess = np.zeros((2, 2, lengths, len(_ENDS)))
    if lengths:
        for kind, (places, weights) in enumerate(_events(values_ns, absent, deadline_ns)):
            counts = np.bincount(places // BLOCK, weights=weights, minlength=whole)[:whole].astype(np.float64)
            for length in range(lengths if counts.any() else 0):
                mean, *figures = _compare(counts)
                for table, figure in zip(tables, figures, strict=True):
                    table[kind, length] = figure
                so_far = np.cumsum(counts[: 2 * _FIRST] - mean)
                ends = np.array(_ENDS)
                before = so_far[ends - 1]
                excess[:, kind, length] = before, so_far[2 * ends - 1] - before
                counts = counts[: counts.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    blocks, worst, leading, variance, covariance = tables
    return Head(
        loops=loops,
        blocks=blocks,
        worst=worst,
        leading=leading,
        variance=variance,
        covariance=covariance,
        before=excess[0],
        behind=excess[1],
    )


def _events(values_ns: Int64s, absent: Int64s, deadline_ns: int) -> Iterator[tuple[Int64s, Int64s]]:
    """High values with the number of levels that each passes, then misses: their loop positions and weights."""
    levels = _levels(values_ns)
    high = np.flatnonzero(values_ns > levels[0])
    heights = values_ns[high]
    # Misses are among the high values, unless more values than these are late.
    late = (
        high[are_late(heights, deadline_ns)]
        if first_late_ns(deadline_ns) > levels[0]
        else np.flatnonzero(are_late(values_ns, deadline_ns))
    )
    for places, weights, most in (
        (high, np.searchsorted(levels, heights), levels.size),
        (late, np.ones(late.size, np.int64), 1),
    ):
        if absent.size:
            every = np.concatenate((loop_positions(places, absent), absent))
            yield every, np.concatenate((weights, np.full(absent.size, most)))
        else:
            yield places, weights


def _levels(values_ns: Int64s) -> Int64s:
    """The levels of high values, ascending, int64 (l,), from an even sample of the values.

    The lowest level of the second half is one of them: a long start-up must not hide its own end.
    """
    sample = values_ns[:: max(1, values_ns.size // _QUANTILES_OF)]
    if not sample.size:
        return np.zeros(1, np.int64)
    highest = max(_LOWEST, (sample.size // _LEAST_ABOVE).bit_length() - 1)
    levels = _passed_by(sample, sample.size >> np.arange(_LOWEST, highest + 1))
    later = sample[sample.size // 2 :]
    return np.unique(np.append(levels, _passed_by(later, np.array([later.size >> _LOWEST]))))


def _passed_by(values_ns: Int64s, counts: Int64s) -> Int64s:
    """The values that are exceeded by as many others as `counts` names."""
    return np.sort(values_ns)[values_ns.size - 1 - counts]


def _compare(counts: Floats) -> tuple[float, ...]:
    """The mean of the blocks behind the first ones, and the figures of `Head` in their order."""
    pairs = counts[_FIRST : counts.size // 2 * 2].reshape(-1, 2)
    if pairs.shape[0] > _OTHERS // 2:
        pairs = pairs[np.linspace(0, pairs.shape[0] - 1, _OTHERS // 2).astype(int)]
    others = pairs.ravel()
    compared = np.concatenate((counts[:_FIRST], others))
    leading = 0
    while leading < _PATTERNS and compared[leading] > compared[leading + 1 :].max():
        leading += 1
    highest = compared.max()
    mean = float(others.mean())
    apart = pairs - mean
    return (
        mean,
        compared.size,
        float(np.count_nonzero(compared == highest)),
        float(max(leading, compared[0] == highest)),
        float(others.var(ddof=1)),
        float((apart[:, 0] * apart[:, 1]).mean()),
    )


def find_startup(runs: Sequence[Sequence[Head]]) -> StartUp | None:
    """The start-up that runs have in common; None if there is none, or if it does not fade.

    `runs` has the outputs of each run. Outputs of one run count as one: they are late together.

    For each length of blocks: in how many runs are the first j blocks the j worst ones, each worse than the next? In a
    run whose blocks come in any order the chance of that is 1 / (m (m - 1) ... (m - j + 1)), and the number of such
    runs is binomial (with unlike chances it is narrower: Hoeffding 1956). For j = 1 stationarity is enough. For j > 1,
    without which a single run shows nothing, neighbouring blocks must not be alike.

    The start-up ends at the first length tried after which as many loops again are no worse than the rest, except by
    chance; or at the longest one, if at most a fifth of the excess is left after it.
    """
    runs = [run for run in runs if run]
    lengths = min((head.blocks.shape[1] for run in runs for head in run), default=0)
    if not lengths:
        return None
    # Each table (runs, kinds, lengths): the mean of a run's outputs.
    blocks, worst, variance, covariance, before, behind = (
        np.array([np.mean([getattr(head, name)[:, :lengths] for head in run], axis=0) for run in runs])
        for name in ("blocks", "worst", "variance", "covariance", "before", "behind")
    )
    alike = covariance.sum(axis=0) > _ALIKE * variance.sum(axis=0)
    chances = _chances(runs, blocks, worst, alike)
    p_value = min(1.0, float(chances.min()) * chances.size)
    if p_value >= SIGNIFICANT:
        return None
    kinds = np.flatnonzero(chances.min(axis=(1, 2)) * chances.size < SIGNIFICANT)
    most = min(head.loops for run in runs for head in run) // MOST
    loops = _end(most, *(table[:, kinds] for table in (blocks, variance, before, behind)))
    return None if loops is None else StartUp(loops=loops, p_value=p_value)


def _chances(runs: Sequence[Sequence[Head]], blocks: Floats, worst: Floats, alike: NDArray[np.bool_]) -> Floats:
    """The chance of so many runs that begin with their worst blocks: (kinds, lengths, patterns)."""
    lengths = alike.shape[1]
    chances = np.ones((2, lengths, _PATTERNS))
    tells = blocks > 0
    for pattern in range(1, _PATTERNS + 1):
        begins = np.array([np.mean([head.leading[:, :lengths] >= pattern for head in run], axis=0) for run in runs])
        seen = np.floor(begins.sum(axis=0) + 1e-9)
        telling = tells.sum(axis=0)
        steps = np.maximum(blocks[..., None] - np.arange(pattern), 1).prod(axis=-1)
        chance = np.where(tells, (worst if pattern == 1 else 1) / steps, 0)
        mean_chance = chance.sum(axis=0) / np.maximum(telling, 1)
        for kind, length in np.argwhere((seen > 0) & ~(alike & (pattern > 1))).tolist():
            count, p = int(seen[kind, length]), float(mean_chance[kind, length])
            if count > telling[kind, length] * p + 1 or telling[kind, length] == 1:
                chances[kind, length, pattern - 1] = binomial_above(count - 1, int(telling[kind, length]), p)
    return chances


def _end(most: int, blocks: Floats, variance: Floats, before: Floats, behind: Floats) -> int | None:
    """The end of a start-up in loops, at most `most`; None where it does not fade.

    Tables are (runs, kinds, lengths); the last two also have (ends).
    """
    end = np.array(_ENDS)
    others = np.maximum(blocks - _FIRST, 1)[..., None]
    error = np.sqrt((end * variance[..., None] * (1 + end / others)).sum(axis=0))
    before, behind = before.sum(axis=0), behind.sum(axis=0)
    small = behind <= _REST * before
    tried = [
        (BLOCK * (number << length), length, place)
        for length in range(blocks.shape[-1])
        for place, number in enumerate(_ENDS)
        if (length == 0 or number >= _ENDS[-1] / 2) and BLOCK * (number << length) <= most
    ]
    lengths, places = np.array(tried).T[1:]
    # (kinds, tried): whether nothing is left after an end, by the limit for the chosen end and by that for longer ones.
    faded, over = (
        (behind <= most * error)[:, lengths, places] | (small[:, lengths, places] & is_enough)
        for most, is_enough in ((_FADED, np.arange(len(tried)) == len(tried) - 1), (_SURELY_FADED, True))
    )
    stays = np.flip(np.logical_and.accumulate(np.flip(over.all(axis=0))))
    ends = np.flatnonzero(faded.all(axis=0) & stays)
    return tried[ends[0]][0] if ends.size else None
