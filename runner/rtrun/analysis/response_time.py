"""How long periodic work can take at worst on one CPU with fixed priorities: the response-time analysis.

The bound holds if these assumptions do. Each task is released once a period, at most its jitter late. It takes at most
its cost of CPU time, and does not wait on its own. Tasks of lower priority give the CPU up after at most `blocking_ns`.
Nothing else runs on the CPU, not even the kernel and its interrupts.
"""

from collections.abc import Iterable
from dataclasses import dataclass

# Steps of the search for a bound. It takes more of them the less CPU time is left; if these are too few, hardly any is.
STEPS_MAX = 300_000  #: steps of the search for the bound of a response time
# Larger than the rounding error of a sum of some hundred shares.
_ROUNDING = 1e-12


@dataclass(frozen=True, kw_only=True, slots=True)
class PeriodicTask:
    """Work of `cost_ns` of CPU time, released every `period_ns`, late by `jitter_ns` at most; times in ns, whole.

    A larger priority comes first. Of two tasks with the same priority, either may come first, as with SCHED_FIFO and
    SCHED_RR.
    """

    name: str
    period_ns: int
    cost_ns: int
    priority: int
    jitter_ns: int = 0
    blocking_ns: int = 0


def response_bound(task: PeriodicTask, others: Iterable[PeriodicTask]) -> int | None:
    """The longest time from when a task was due to its end, in ns, on a CPU that it shares with others.

    None: there is no bound, because the task and those that come before it ask for nearly all of the CPU, or more.

    Joseph & Pandya 1986 ("Finding response times in a real-time system"): the least w with w = C + sum over the tasks
    that come before of ceil(w / T) C, where all are released at one instant. With jitter and blocking: Audsley et al.
    1993 ("Applying new scheduling theory to static priority pre-emptive scheduling"). Where w is longer than the
    period, each job of the busy period is examined: Lehoczky 1990, Tindell, Burns & Wellings 1994. This is the exact
    test of Davis, Zabos & Burns 2008. A task of the same priority may come before, so it counts as one that does.
    """
    before = [other for other in others if other.priority >= task.priority]
    taken = sum(other.cost_ns / other.period_ns for other in before)
    if taken + task.cost_ns / task.period_ns > 1 + _ROUNDING:
        return None
    worst, busy_ns, job, steps = 0, 0, 1, 0
    while steps < STEPS_MAX:
        own_ns = task.blocking_ns + job * task.cost_ns
        # At least as long as if the others took only their shares of it.
        busy_ns = max(busy_ns, own_ns, int(own_ns / (max(1 - taken, 0) + _ROUNDING)))
        while (longer_ns := own_ns + sum(_interference_ns(other, busy_ns) for other in before)) > busy_ns:
            busy_ns = longer_ns
            if (steps := steps + len(before)) > STEPS_MAX:
                return None
        # The first job comes as late as it may. The others are due one period apart, counted from when it was due.
        worst = max(worst, busy_ns + task.jitter_ns - (job - 1) * task.period_ns)
        if busy_ns + task.jitter_ns <= job * task.period_ns:
            return worst
        job, steps = job + 1, steps + 1 + len(before)
    return None


def _interference_ns(task: PeriodicTask, busy_ns: int) -> int:
    """The CPU time that a task takes in a busy time that begins with its release: of all jobs released in it."""
    return -(-(busy_ns + task.jitter_ns) // task.period_ns) * task.cost_ns
