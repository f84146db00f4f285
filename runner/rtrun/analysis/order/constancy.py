"""Did the process stay the same? Within each boot, over its runs joined in the order of time, and from boot to boot.

Runs are pieces of one course: measuring in rounds must not hide what one long run would show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rtfiles.quantities import grouped
from rtrun.analysis.chance.intervals import chance_of_so_many
from rtrun.analysis.dependence.design_effect import design_effect, effect_of_few, pool
from rtrun.analysis.order.stationarity import (
    SIGNIFICANT,
    SIGNIFICANT_OF_MISSES,
    Change,
    Visits,
    count_until,
    find_change,
    find_visits,
    test_of_order,
)
from rtrun.analysis.order.trends import (
    Climb,
    Unit,
    changes_between,
    changes_laid_over,
    find_climb,
    runs_of,
)
from rtrun.analysis.trials import ENOUGH_MISSES, Trials, high_values
from rtrun.kinds.values import Int64s

# A level that was left and entered again this often is part of the process.
RETURNS = 5


def slowest_load(length: float) -> float:
    """The longest period of a load that joined runs of this length can judge. Wherever in its period they begin, they
    then see it left and entered again five times."""
    return length / (RETURNS + 1)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Boot:
    """The runs of one boot, joined in the order of time.

    `loops` counts the loops of a run once, however many subscribers measured in it. `missed_at` and `high_at` are the
    places of misses and of high values among these loops, `highest_at` those of the highest 200, at most a twentieth of
    all: int64 (k,), ascending. `missed_at` is None where a log kept no order.
    """

    board: str
    trials: tuple[Trials, ...]
    loops: int
    missed_at: Int64s | None
    high_at: Int64s
    highest_at: Int64s

    @property
    def measured(self) -> int:
        """Measurements of all outputs."""
        return sum(run.n for run in self.trials)

    @property
    def misses(self) -> int:
        """Misses of all outputs."""
        return sum(run.late + run.absent for run in self.trials)


@dataclass(frozen=True, kw_only=True, slots=True)
class Constancy:
    """The strongest sign that the process did not stay the same; None if there is none beyond chance.

    `in_time`: one of the signs is a change over time. `clusters` are (loops, misses) of each turn of a load that comes
    and goes, if there is one.
    """

    change: Change | None
    in_time: bool = False
    clusters: tuple[tuple[int, int], ...] = ()


def join_boots(runs: Sequence[Trials]) -> list[Boot]:
    """The boots of runs that are sorted by time. Runs of an unknown boot are a boot each."""
    by_boot: dict[tuple[str, str], list[Trials]] = {}
    for index, run in enumerate(runs):
        by_boot.setdefault((run.board, run.boot or run.run or str(index)), []).append(run)
    return [_join(board, trials) for (board, _), trials in by_boot.items()]


def _join(board: str, trials: Sequence[Trials]) -> Boot:
    outputs: dict[str, list[Trials]] = {}
    for index, run in enumerate(trials):
        outputs.setdefault(run.run or str(index), []).append(run)
    starts = np.cumsum([0, *(max(run.n for run in of_run) for of_run in outputs.values())])
    placed = [(run, int(start)) for of_run, start in zip(outputs.values(), starts, strict=False) for run in of_run]
    with_places = [(run, start) for run, start in placed if run.high_at.size]
    ordered = [run for run, _ in with_places]

    def high_at(limit: int) -> Int64s:
        return _ascending([run.high_at[run.high_ns >= limit] + start for run, start in with_places])

    limit = high_limit(ordered)
    heights = np.concatenate([np.empty(0, np.int64), *(run.high_ns for run in ordered)])
    most = min(heights.size, high_values(sum(run.n for run in ordered)))
    highest = int(np.partition(heights, heights.size - most)[heights.size - most]) if most else limit
    return Boot(
        board=board,
        trials=tuple(trials),
        loops=int(starts[-1]),
        missed_at=None
        if any(run.misses is None for run in trials)
        else _ascending([run.missed_at + start for run, start in placed]),
        high_at=high_at(limit),
        highest_at=high_at(max(limit, highest)),
    )


def _ascending(places: Sequence[Int64s]) -> Int64s:
    return np.unique(np.concatenate(places)) if places else np.empty(0, np.int64)


def high_limit(trials: Sequence[Trials]) -> int:
    """The height in ns from which on all values of all these runs are known.

    Each run keeps only its own highest values, so this is the largest of their minima.
    """
    return max((int(run.high_ns.min()) for run in trials if run.high_ns.size), default=0)


def examine_constancy(
    boots: Sequence[Boot], *, probability: float, confidence: float, deadline_ns: int | None = None
) -> Constancy:
    """Search for changes within runs, from run to run and from boot to boot, and for a boot that misses too often
    alone.

    While twice the highest value is below the deadline, heights do not matter and only misses are examined.
    """
    worst_ns = max((run.worst_ns for boot in boots for run in boot.trials if run.worst_ns is not None), default=0)
    of_heights = deadline_ns is None or 2 * worst_ns >= deadline_ns
    clusters: list[tuple[int, int]] = []
    within: list[Change] = []
    runs: list[list[Unit]] = []
    for boot in boots:
        visits, changes = _within(boot, of_heights)
        within += changes
        if visits is not None:
            clusters += _turns(boot, visits)
        else:
            # With a load that comes and goes, runs are not independent.
            runs.append(runs_of(boot.trials))
    levels = (
        within,
        [*changes_laid_over([run for of_boot in runs for run in of_boot], of_heights=of_heights)],
        [*changes_between(runs, "runs", of_heights=of_heights)],
        [*changes_between(_by_board(boots), "boots", of_heights=of_heights)],
    )
    # Each kind of test has an error rate of its own: many tests of one kind must not hide what another one sees.
    families = (
        [change for change in found if change.of_heights is of_heights]
        for found in levels
        for of_heights in (False, True)
    )
    in_time = [change for family in families if (change := _strongest(family)) is not None]
    alone = _strongest(_alone(boots, probability, confidence))
    seen = [*in_time, alone] if alone is not None else in_time
    strongest = min(seen, key=lambda change: change.p_value / change.significant, default=None)
    return Constancy(change=strongest, in_time=bool(in_time), clusters=tuple(clusters))


def find_climbs(boots: Sequence[Boot], deadline_ns: int) -> tuple[Climb, ...]:
    """How levels climb from boot to boot of each board, and from run to run of each boot, if there are several."""
    if not all(run.boot for boot in boots for run in boot.trials):
        # Each run of an unknown boot is a boot of its own here, so the units are called runs.
        climb = find_climb("run", _by_board(boots), deadline_ns)
        return () if climb is None else (climb,)
    of_boots = find_climb("boot", _by_board(boots), deadline_ns)
    of_runs = find_climb("run", [runs_of(boot.trials) for boot in boots], deadline_ns)
    return tuple(climb for climb in (of_boots, of_runs) if climb is not None)


def _by_board(boots: Sequence[Boot]) -> list[list[Unit]]:
    """The boots of each board, in the order of time."""
    boards: dict[str, list[Unit]] = {}
    for boot in boots:
        boards.setdefault(boot.board, []).append(boot.trials)
    return [*boards.values()]


def _strongest(changes: Sequence[Change]) -> Change | None:
    """The most significant change, if it is significant among so many tests (Bonferroni)."""
    strongest = min(changes, key=lambda change: change.p_value / change.significant, default=None)
    seen = strongest is not None and strongest.p_value * len(changes) < strongest.significant
    return strongest if seen else None


def _within(boot: Boot, of_heights: bool) -> tuple[Visits | None, list[Change]]:
    """The signs of change in the joined runs of a boot, and the visits of a level that came back often enough.

    Such a level is judged by its visits: whether they stayed the same.
    """
    found: list[Change] = []
    seen: Visits | None = None
    misses = (boot.missed_at, boot.missed_at, "misses", SIGNIFICANT_OF_MISSES, False)
    heights = (boot.highest_at, boot.high_at, "highest values", SIGNIFICANT, True)
    for tested, places, events, significant, is_of_heights in (misses, heights)[: 1 + of_heights]:
        change = None if tested is None else find_change(tested, boot.loops, events, significant)
        if change is None or places is None:
            continue
        if change.p_value < significant:
            visits = find_visits(places, boot.loops)
            if visits.returns >= RETURNS:
                seen = visits if seen is None or visits.returns > seen.returns else seen
                change = _among_visits(places, visits, boot.loops, events, significant)
            elif visits.returns:
                missing = (RETURNS - visits.returns) * boot.loops // visits.returns
                change = replace(change, missing_loops=missing)
        found.append(replace(change, of_heights=is_of_heights))
    return seen, found


def _among_visits(places: Int64s, visits: Visits, loops: int, events: str, significant: float) -> Change:
    ends = np.append(visits.starts[1:], loops)
    counts = count_until(places, ends)
    p_value, text = test_of_order(counts, np.diff(ends, prepend=0), events)
    return Change(p_value=p_value, significant=significant, text=f"{text} visits of a load that comes and goes")


def _turns(boot: Boot, visits: Visits) -> list[tuple[int, int]]:
    """(loops, misses) from the begin of each visit of a level to that of the next one."""
    ends = np.append(visits.starts[1:], boot.loops)
    stride = boot.misses / boot.missed_at.size if boot.missed_at is not None and boot.missed_at.size else 1.0
    counts = count_until(boot.missed_at, ends) if boot.missed_at is not None else 0 * ends
    lengths = np.diff(ends, prepend=0)
    return [(int(length), round(stride * count)) for length, count in zip(lengths, counts, strict=True)]


def _effect_alone(boot: Boot) -> float:
    """The design effect of the misses of one boot; 1 where a log kept no order."""
    if boot.missed_at is None or boot.missed_at.size < 2:
        return 1.0
    if boot.missed_at.size < ENOUGH_MISSES:
        return effect_of_few(boot.missed_at, boot.loops)
    return design_effect(pool(run.misses for run in boot.trials if run.misses is not None))


def _alone(boots: Sequence[Boot], probability: float, confidence: float) -> list[Change]:
    """Boots that miss more often than `probability` on their own: an average over all boots would hide them."""
    if len(boots) < 2:
        return []
    changes = []
    for boot in boots:
        effect = _effect_alone(boot)
        p_value = chance_of_so_many(boot.misses / effect, boot.measured / effect, probability)
        text = f"the worst of {len(boots)} boots missed {grouped(boot.misses)} of {grouped(boot.measured)}"
        sign = Change(
            p_value=p_value, significant=1 - confidence, text=text, what="a boot alone misses more often than asked"
        )
        changes.append(sign)
    return changes
