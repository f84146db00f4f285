"""Is a deadline met, with what probability, and how sure is that?"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from rtrun.analysis.dependence import Events, design_effect, locate, pool
from rtrun.analysis.histogram import Histogram, Int64s

# Beyond this a number of measurements is no plan: at 1 kHz it is 30 000 years.
_UNATTAINABLE = 10**15
# With this many misses their own bursts tell the design effect; with fewer a lower level has to help.
_ENOUGH_MISSES = 20
_LEVEL_EVENTS = 200


class Answer(StrEnum):
    """What can be said about a deadline."""

    PROVEN = "PROVEN"
    REFUTED = "REFUTED"
    NEEDS_MORE = "NEEDS MORE"
    NO_STATEMENT = "not a real-time statement"


@dataclass(frozen=True, kw_only=True)
class Trials:
    """What one run says about one deadline: how many came late or never, and where.

    ``late`` measurements exceeded the deadline, ``absent`` were not fired or went missing: they met no deadline
    either. ``misses`` holds both by position; None where a log kept no order. ``level`` holds where the run passed a
    lower level often enough (about 200 times) to show whether its high values come in bursts. ``worst_ns`` is the
    highest value seen.
    """

    n: int
    late: int
    absent: int
    misses: Events | None
    level: Events | None
    worst_ns: int | None


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The answer to one deadline. ``lower`` and ``upper`` bound P(miss) at ``confidence`` (two-sided).

    ``further`` measurements without any further miss would give PROVEN (0: it is given, None: no number would);
    ``further_at_rate`` gives (answer, measurements) if misses go on at the rate seen, None when that decides nothing.
    """

    answer: Answer
    deadline_ns: int
    probability: float
    confidence: float
    n: int
    late: int
    absent: int
    worst_ns: int | None
    p_miss: float
    lower: float
    upper: float
    design_effect: float
    n_effective: float
    further: int | None
    further_at_rate: tuple[Answer, int] | None
    period_ns: float | None
    assumes: tuple[str, ...]
    refused: str | None = None

    @property
    def misses(self) -> int:
        """Measurements that did not meet the deadline."""
        return self.late + self.absent

    def hours(self, measurements: int) -> float | None:
        """How long so many measurements take; None when the period is not known."""
        return None if self.period_ns is None else measurements * self.period_ns / 3.6e12


def clopper_pearson(k: float, n: float, confidence: float) -> tuple[float, float]:
    """The exact two-sided interval of a probability after k events in n trials (Clopper & Pearson 1934).

    k and n need not be whole: with effective numbers this is the interval of Korn & Graubard (1998) for dependent
    trials. No trial gives (0, 1).
    """
    from scipy.special import betaincinv

    if n <= 0:
        return 0.0, 1.0
    tail = (1 - confidence) / 2
    lower = 0.0 if k <= 0 else float(betaincinv(k, n - k + 1, tail))
    if k >= n:
        return lower, 1.0
    # For k = 0 the closed form keeps every digit where 1 - x would lose them.
    upper = -math.expm1(math.log(tail) / n) if k <= 0 else float(betaincinv(k + 1, n - k, 1 - tail))
    return lower, upper


def count_misses(values_ns: Int64s, deadline_ns: int, absent: Int64s | None = None) -> Trials:
    """Count what missed the deadline in one run's int64 samples, shape (n,) in loop order; late is above it.

    `absent` gives the ascending loop positions of what was not fired or went missing; the samples fill the others.
    """
    if absent is None:
        absent = np.empty(0, np.int64)
    loops = values_ns.size + absent.size
    late = np.flatnonzero(values_ns > deadline_ns).astype(np.int64)
    late_count = late.size
    if absent.size:
        late = np.sort(np.concatenate((_loop_positions(late, absent), absent)))
    level = None
    wanted = min(_LEVEL_EVENTS, values_ns.size // 20)
    if wanted >= 10:
        limit = np.partition(values_ns, values_ns.size - wanted)[values_ns.size - wanted]
        level = locate(np.flatnonzero(values_ns >= limit).astype(np.int64), values_ns.size)
    return Trials(
        n=loops,
        late=late_count,
        absent=absent.size,
        misses=locate(late, loops),
        level=level,
        worst_ns=int(values_ns.max()) if values_ns.size else None,
    )


def _loop_positions(of_samples: Int64s, absent: Int64s) -> Int64s:
    """Loop positions of samples given by their rank among those that came."""
    came_before = absent - np.arange(absent.size)
    return of_samples + np.searchsorted(came_before, of_samples, side="right")


def count_misses_in_histogram(histogram: Histogram, deadline_ns: int, absent: int = 0) -> Trials:
    """Count what missed the deadline in a histogram. Raises ValueError when the deadline lies in the overflow."""
    top = int(histogram.values_ns[-1]) if histogram.values_ns.size and not histogram.overflow else histogram.max_ns
    late = histogram.above(deadline_ns)
    return Trials(n=histogram.n + absent, late=late, absent=absent, misses=None, level=None, worst_ns=top)


def judge(
    runs: Sequence[Trials],
    *,
    deadline_ns: int,
    probability: float,
    confidence: float,
    period_ns: float | None = None,
    clock_step_ns: int | None = None,
    emulated: bool = False,
    measurements_per_event: int = 1,
) -> Verdict:
    """Answer for runs of one set of parameters: is P(miss) below `probability`, at this confidence?

    PROVEN: the interval's upper end is below it. REFUTED: the lower end is above it. Else NEEDS MORE, with how many.
    `measurements_per_event` measurements of one event (the subscribers of one message) count as one measurement.
    Numbers from an emulated board, or for a deadline below two clock steps, are no real-time statement.
    Raises ValueError when probability or confidence is not between 0 and 1.
    """
    if not 0 < probability < 1 or not 0 < confidence < 1:
        raise ValueError("probability and confidence must lie between 0 and 1, both ends excluded")
    n = sum(run.n for run in runs)
    late, absent = sum(run.late for run in runs), sum(run.absent for run in runs)
    misses = late + absent
    effect, assumes = _effect_of(runs, misses, confidence)
    effect *= measurements_per_event
    lower, upper = clopper_pearson(misses / effect, n / effect, confidence)
    refused = None
    if emulated:
        refused = "measured on an emulated board"
    elif clock_step_ns is not None and deadline_ns < 2 * clock_step_ns:
        refused = f"the deadline of {deadline_ns} ns is finer than two steps of the clock ({clock_step_ns} ns each)"
    if refused:
        answer = Answer.NO_STATEMENT
    elif n and upper < probability:
        answer = Answer.PROVEN
    elif n and lower > probability:
        answer = Answer.REFUTED
    else:
        answer = Answer.NEEDS_MORE

    def proven(total: int) -> bool:
        return clopper_pearson(misses / effect, total / effect, confidence)[1] < probability

    rate = misses / n if n else 0.0

    def decided(total: int) -> bool:
        low, high = clopper_pearson(rate * total / effect, total / effect, confidence)
        return high < probability if rate < probability else low > probability

    goal = _smallest(proven, n)
    at_rate = _smallest(decided, n) if misses and rate != probability else None
    return Verdict(
        answer=answer,
        deadline_ns=deadline_ns,
        probability=probability,
        confidence=confidence,
        n=n,
        late=late,
        absent=absent,
        worst_ns=max((run.worst_ns for run in runs if run.worst_ns is not None), default=None),
        p_miss=rate,
        lower=lower,
        upper=upper,
        design_effect=effect,
        n_effective=n / effect,
        further=None if goal is None else goal - n,
        further_at_rate=None
        if at_rate is None
        else (Answer.PROVEN if rate < probability else Answer.REFUTED, at_rate - n),
        period_ns=period_ns,
        assumes=assumes,
        refused=refused,
    )


def _effect_of(runs: Sequence[Trials], misses: int, confidence: float) -> tuple[float, tuple[str, ...]]:
    located = [run.misses for run in runs if run.misses is not None]
    if len(located) < len(runs):
        return 1.0, ("independent measurements: a log without samples keeps no order, bursts would not be seen",)
    own = _widened(pool(located), confidence)
    if misses >= _ENOUGH_MISSES:
        return own, ()
    levels = [run.level for run in runs if run.level is not None]
    if not levels:
        return own, ("independent measurements: too few to see bursts",)
    return max(own, _widened(pool(levels), confidence)), ()


def _widened(events: Events, confidence: float) -> float:
    """The design effect, larger where it rests on few bursts.

    The factor is the squared ratio of Student's t to the normal quantile, with the number of bursts seen as degrees
    of freedom, as Korn & Graubard (1998) adjust the effective sample size.
    """
    from scipy.special import ndtri, stdtrit

    effect = design_effect(events)
    if effect == 1:
        return 1.0
    middle = (1 + confidence) / 2
    return effect * float((stdtrit(max(1.0, events.count / effect), middle) / ndtri(middle)) ** 2)


def _smallest(holds: Callable[[int], bool], start: int) -> int | None:
    """The smallest total from `start` on for which a monotone condition holds; None beyond all plans."""
    if start and holds(start):
        return start
    low, high = start, max(1, start)
    while not holds(high):
        low, high = high, 2 * high
        if high > _UNATTAINABLE:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
