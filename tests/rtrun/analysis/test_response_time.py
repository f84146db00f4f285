"""The bound on response times: worked examples of the literature, and a scheduler of fixed priorities, simulated."""

import random
from dataclasses import replace

import pytest

from rtrun.analysis.response_time import PeriodicTask, response_bound


def tasks(*rows):
    """Tasks of (period, cost), the first one comes first."""
    return [
        PeriodicTask(name=str(number), period_ns=period, cost_ns=cost, priority=len(rows) - number)
        for number, (period, cost) in enumerate(rows)
    ]


def bounds(task_set):
    return [response_bound(task, [other for other in task_set if other is not task]) for task in task_set]


# Burns & Wellings, Real-Time Systems and Programming Languages: 3, 6 and 20.
BURNS = tasks((7, 3), (12, 3), (20, 5))
# Lehoczky 1990: the second task's jobs of the busy period take 114, 102, 116, 104, 118, 106 and 94.
LEHOCZKY = tasks((70, 26), (100, 62))


def test_worked_examples_of_the_literature():
    assert bounds(BURNS) == [3, 6, 20]
    assert bounds(LEHOCZKY) == [26, 118]
    # Lehoczky, Sha & Ding 1989, schedulable with 95 % of the CPU: the third one ends at 300 of 350.
    assert bounds(tasks((100, 40), (150, 40), (350, 100))) == [40, 80, 300]
    # With jitter and blocking, by hand: w = 2 + 5 + ceil((w + 4) / 10) 3 = 13, and 1 of jitter of its own.
    task = PeriodicTask(name="a", period_ns=50, cost_ns=5, priority=1, jitter_ns=1, blocking_ns=2)
    other = PeriodicTask(name="b", period_ns=10, cost_ns=3, priority=2, jitter_ns=4)
    assert response_bound(task, [other]) == 14


def test_no_bound_where_all_of_the_cpu_is_asked_for_and_more():
    assert bounds(tasks((10, 6), (10, 5))) == [6, None]
    assert bounds(tasks((10, 5), (20, 10))) == [5, 20], "all of it, and no more, is enough"
    late = [replace(task, jitter_ns=1) for task in tasks((10, 5), (20, 10))]
    assert bounds(late) == [6, None], "once late, such a set is late for ever"


@pytest.mark.parametrize("left", [10**-5, 10**-9, 0])
def test_little_time_that_is_left_is_no_reason_to_look_for_ever(left):
    """Of two tasks with odd periods that are late at times the second one has a bound, or none is found soon."""
    first = PeriodicTask(name="a", period_ns=10**9 + 7, cost_ns=5 * 10**8, priority=2, jitter_ns=10**6)
    rest = int((1 - first.cost_ns / first.period_ns - left) * 10**9)
    bound = response_bound(PeriodicTask(name="b", period_ns=10**9, cost_ns=rest, priority=1, jitter_ns=10**6), [first])
    assert bound is None if left < 10**-6 else 10**9 < bound < 10**10


def simulated(task_set, offsets, until, costs=lambda _task, cost: cost):
    """The longest response of each task by name: a CPU that runs the job of the highest priority, the oldest first."""
    releases = sorted((at, task.name) for task in task_set for at in range(offsets[task.name], until, task.period_ns))
    by_name = {task.name: task for task in task_set}
    ready, longest, now = [], dict.fromkeys(by_name, 0), 0
    while releases or ready:
        if not ready:
            now = max(now, releases[0][0])
        while releases and releases[0][0] <= now:
            at, name = releases.pop(0)
            ready.append([-by_name[name].priority, at, name, costs(name, by_name[name].cost_ns)])
        job = min(ready)
        runs_until = min(now + job[3], releases[0][0]) if releases else now + job[3]
        job[3] -= runs_until - now
        now = runs_until
        if not job[3]:
            ready.remove(job)
            longest[job[2]] = max(longest[job[2]], now - job[1])
    return longest


def some_tasks(draw, priorities):
    """Random tasks that ask for less than all of the CPU."""
    while True:
        periods = [draw.choice([5, 6, 8, 10, 12, 15, 20, 30, 50]) for _ in range(draw.randint(1, 5))]
        task_set = [
            PeriodicTask(name=str(number), period_ns=period, cost_ns=draw.randint(1, period),
                         priority=priorities(draw, number))
            for number, period in enumerate(periods)
        ]  # fmt: skip
        if sum(task.cost_ns / task.period_ns for task in task_set) <= 1:
            return task_set


def test_the_bound_is_met_exactly_where_all_are_released_at_once_and_never_exceeded():
    draw, longer = random.Random(1), 0
    for _ in range(300):
        task_set = some_tasks(draw, lambda _draw, number: number)
        bound = dict(zip([task.name for task in task_set], bounds(task_set), strict=True))
        # All periods divide 600.
        assert simulated(task_set, dict.fromkeys(bound, 0), 1200) == bound
        longer += any(bound[task.name] > task.period_ns for task in task_set)
        offsets = {task.name: draw.randrange(task.period_ns) for task in task_set}
        measured = simulated(task_set, offsets, 1200, lambda _name, cost: draw.randint(1, cost))
        assert all(measured[name] <= bound[name] for name in bound)
    assert longer > 10, "sets in which a response is longer than its period are among them"


def test_the_bound_covers_tasks_of_one_priority_served_in_the_order_of_their_release():
    draw, met = random.Random(2), 0
    for _ in range(300):
        task_set = some_tasks(draw, lambda draw, _number: draw.randint(1, 2))
        bound = dict(zip([task.name for task in task_set], bounds(task_set), strict=True))
        offsets = {task.name: draw.randrange(task.period_ns) for task in task_set}
        measured = simulated(task_set, offsets, 1200)
        assert all(measured[name] <= bound[name] for name in bound)
        met += measured == bound
    assert met > 10, "it is no further away than needed"


@pytest.mark.parametrize("task", BURNS[1:], ids=["second", "third"])
def test_without_the_time_of_others_it_would_be_exceeded(task):
    longest = simulated(BURNS, dict.fromkeys("012", 0), 420)
    assert longest[task.name] > response_bound(task, []) == task.cost_ns
