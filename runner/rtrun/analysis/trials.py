"""What a run says about a deadline: how many values came late or never, and where."""

import bisect
import itertools
from dataclasses import dataclass, replace

import numpy as np

from rtrun.analysis.dependence.design_effect import Events, locate
from rtrun.analysis.dependence.episodes import FoundEpisodes, find_episodes
from rtrun.analysis.histogram import Histogram
from rtrun.kinds.lateness import are_late, first_late_ns
from rtrun.kinds.values import Int64s
from rtrun.plan.question import NONE_TOLERATED, Tolerance

# With this many misses normal theory on blocks holds for their bursts; fewer are tested exactly.
ENOUGH_MISSES = 20
_LEVEL_EVENTS = 200
# How many places of misses are kept per run: enough for every test of their places.
_MOST_PLACES = 4096
# So many of the highest values are tried first to find what decides windows.
_HIGHEST = 4096
_NEVER = np.iinfo(np.int64).max
_NONE = np.empty(0, np.int64)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Trials:
    """What one output of one run says about one deadline: how many came late or never, and where.

    ``late`` measurements exceeded the deadline; ``absent`` ones did not fire or went missing, so they did not meet it
    either. ``misses`` holds both by position; None where a log kept no order. ``missed_at`` are their loop positions,
    int64 (k,); of many, only every ``stride``-th is kept. ``level`` has the events above a lower level, which the run
    exceeds often enough (about 200 times) to show whether high values come in bursts. ``high_at`` and ``high_ns`` are
    the places and the heights of these values, int64 (h,); without an order there are no places. ``worst_ns`` is the
    highest value seen. ``unclear`` of the late ones may have met the deadline: they lie in the same bin of a histogram,
    or within a step of the clock below it. ``episodes`` join misses that are near one another; None where no order was
    kept. ``run``, ``boot``, ``board`` and ``start_time`` say where the trials belong; "" where that is not known.
    """

    n: int
    late: int
    absent: int
    misses: Events | None
    missed_at: Int64s
    level: Events | None
    high_at: Int64s
    high_ns: Int64s
    worst_ns: int | None
    stride: int = 1
    unclear: int = 0
    episodes: FoundEpisodes | None = None
    run: str = ""
    boot: str = ""
    board: str = ""
    start_time: str = ""


def high_values(loops: int) -> int:
    """How many of so many values count as high."""
    return min(_LEVEL_EVENTS, loops // 20)


def windowed(values_ns: Int64s, absent: Int64s, deadline_ns: int, tolerance: Tolerance) -> tuple[Int64s, Int64s]:
    """The value that decides each window of `tolerance.among` loops, and the windows that have none.

    A window ends at each loop. It holds more misses than are tolerated if its (misses + 1)-th highest value is late.
    That value, an order statistic (David & Nagaraja 2003), stands for the window, so methods for values apply to
    windows. An absent value is above all others. Values are int64 (n,), `absent` (a,) loop positions as in
    `count_misses`. There are among - 1 fewer windows than loops, because incomplete windows are not judged.

    Only the highest windows get their exact value. The values of the others tell only whether the deadline is met.
    """
    loops, size = values_ns.size + absent.size, tolerance.among
    if loops < size:
        return _NONE, _NONE
    every = np.full(loops, _NEVER)
    came = np.ones(loops, bool)
    came[absent] = False
    every[came] = values_ns
    late = np.concatenate(([0], np.cumsum(are_late(every, deadline_ns))))
    is_late = late[size:] - late[:-size] > tolerance.misses
    # Try more of the highest values until they decide enough windows.
    for many in (_HIGHEST * 8**power for power in itertools.count()):
        floor = int(np.partition(every, -many)[-many]) if many < loops else -_NEVER
        decides = _decided_by(every, floor, tolerance)
        if many >= loops or np.count_nonzero(decides >= floor) > high_values(is_late.size):
            break
    first_late = first_late_ns(deadline_ns)
    low = min(floor, first_late) - 1
    decides = np.where(decides >= floor, decides, np.where(is_late, np.maximum(low, first_late), low))
    never = decides == _NEVER
    return decides[~never], np.flatnonzero(never).astype(np.int64)


def _decided_by(every: Int64s, floor: int, tolerance: Tolerance) -> Int64s:
    """The (misses + 1)-th highest value of each window, where it is at least `floor`; less for the others."""
    size = tolerance.among
    entering = np.flatnonzero(every >= floor)
    # A value is in all windows from its own place on, for the length of a window.
    places = np.concatenate((entering, entering + size))
    order = np.argsort(places, kind="stable")
    heights = np.tile(every[entering], 2)[order].tolist()
    held: list[int] = []
    decides = [floor - 1]
    for height, enters in zip(heights, (order < entering.size).tolist(), strict=True):
        if enters:
            bisect.insort(held, height)
        else:
            del held[bisect.bisect_left(held, height)]
        decides.append(held[-tolerance.misses - 1] if len(held) > tolerance.misses else floor - 1)
    ends = np.concatenate(([0], np.minimum(places[order], every.size), [every.size]))
    return np.repeat(np.array(decides, np.int64), np.diff(ends))[size - 1 :]


def count_misses(
    values_ns: Int64s,
    deadline_ns: int,
    absent: Int64s | None = None,
    tolerance: Tolerance = NONE_TOLERATED,
    period_ns: float | None = None,
    step_ns: int = 1,
) -> Trials:
    """Count what missed the deadline in one run's int64 samples, shape (n,) in loop order.

    A value above the deadline is late, one that equals it is not. A clock that steps by `step_ns` may read up to
    `step_ns` - 1 ns too little: a value that may be late counts as late, and as unclear where it may also be in time.
    `absent` gives the ascending loop positions of values that did not fire or went missing; the samples fill the
    others.
    With a `tolerance` the trials are windows (`windowed`); the highest value seen is still that of a loop.
    `period_ns` says how far apart loops are; None if not known.
    """
    if absent is None:
        absent = np.empty(0, np.int64)
    if tolerance != NONE_TOLERATED:
        decides, never = windowed(values_ns, absent, deadline_ns - (step_ns - 1), tolerance)
        return replace(
            count_misses(decides, deadline_ns, never, period_ns=period_ns, step_ns=step_ns),
            worst_ns=int(values_ns.max()) if values_ns.size else None,
        )
    loops = values_ns.size + absent.size
    misses = np.flatnonzero(are_late(values_ns, deadline_ns, step_ns)).astype(np.int64)
    late = misses.size
    unclear = late - int(np.count_nonzero(are_late(values_ns, deadline_ns))) if step_ns > 1 else 0
    if absent.size:
        misses = np.sort(np.concatenate((loop_positions(misses, absent), absent)))
    level, high = None, _NONE
    level_events = high_values(values_ns.size)
    if level_events:
        limit = np.partition(values_ns, values_ns.size - level_events)[values_ns.size - level_events]
        high = np.flatnonzero(values_ns >= limit).astype(np.int64)
        level = locate(high, values_ns.size) if level_events >= 10 else None
        # If a quarter of all values reach the level, they are no high ones.
        if 4 * high.size >= values_ns.size:
            high = _NONE
    stride = max(1, -(-misses.size // _MOST_PLACES))
    return Trials(
        n=loops,
        late=late,
        absent=absent.size,
        misses=locate(misses, loops),
        missed_at=misses[::stride],
        level=level,
        high_at=high,
        high_ns=values_ns[high],
        stride=stride,
        episodes=find_episodes(misses, loops, period_ns),
        worst_ns=int(values_ns.max()) if values_ns.size else None,
        unclear=unclear,
    )


def loop_positions(of_samples: Int64s, absent: Int64s) -> Int64s:
    """Loop positions of samples given by their rank among those that came."""
    came_before = absent - np.arange(absent.size)
    return of_samples + np.searchsorted(came_before, of_samples, side="right")


def count_misses_in_histogram(histogram: Histogram, deadline_ns: int, absent: int = 0) -> Trials:
    """Count what missed the deadline in a histogram: all in the bin that holds the deadline, unless it ends the bin.

    Its high values have heights but no places. Raises ValueError when the deadline lies in the overflow.
    """
    top = int(histogram.values_ns[-1]) if histogram.values_ns.size and not histogram.overflow else histogram.max_ns
    return Trials(
        n=histogram.n + absent,
        late=histogram.above(deadline_ns),
        absent=absent,
        misses=None,
        missed_at=_NONE,
        level=None,
        high_at=_NONE,
        high_ns=_highest_of(histogram, _LEVEL_EVENTS),
        worst_ns=top,
        unclear=histogram.unclear(deadline_ns),
    )


def _highest_of(histogram: Histogram, number: int) -> Int64s:
    """The highest values of a histogram, int64 of shape (at most `number`,): each as the lower edge of its bin."""
    beyond = min(number, histogram.overflow)
    edges, counts = histogram.values_ns[::-1], histogram.counts[::-1]
    inside = np.minimum(np.cumsum(counts), number - beyond)
    overflown = np.full(beyond, histogram.overflow_from_ns or histogram.max_ns or 0, np.int64)
    return np.concatenate((overflown, np.repeat(edges, np.diff(inside, prepend=0))))
