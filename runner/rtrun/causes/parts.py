"""The parts of the time between when a thread should have run and when it did, and what takes them."""

from dataclasses import dataclass
from enum import StrEnum

from rtrun.causes.timeline import State


class Kind(StrEnum):
    """What took a part of the time."""

    TIMER_LATE = "timer interrupt late during"
    TIMER_SLACK = "timer slack"
    INTERRUPT = "interrupt"
    SOFTIRQ = "softirq"
    HIGHER = "thread of higher priority"
    DEADLINE = "thread at SCHED_DEADLINE"
    EQUAL = "thread of the same priority"
    NOT_PREEMPTED = "thread of lower priority, not preempted"
    THROTTLED = "throttled: a thread of lower priority was chosen"
    SHARED = "thread that shares the CPU without real-time priority"
    GROUP = "throttled by the limit of control group"
    IDLE_EXIT = "idle CPU woke up late"
    CONSOLE = "printk to a console by"
    SLOWED = "CPU slowed down"
    LOCK = "lock held by"
    FAULT = "page fault"
    STOPPED = "stopped by"
    LET_GO_ON = "stopped until it was let go on by"
    FROZEN = "frozen until it was let go on by"
    BLOCKED = "blocked in the kernel, woken by"
    CALLBACK = "earlier callback of its thread"
    OTHER_THREAD = "thread of the measured programs"
    PROGRAM = "the measured thread itself"
    OWN_SLEEP = "asleep by its own timer"
    OUTSIDE = "nothing to do before the interrupt"
    UNEXPLAINED = "unexplained"


NAMELESS = frozenset({Kind.UNEXPLAINED, Kind.PROGRAM, Kind.OUTSIDE, Kind.OWN_SLEEP})
"""Kinds that name nobody."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Cause:
    """What took time: the name and id of a thread if there is one, and its priority as the kernel counts it.

    `above` is the priority of the waiting thread, if it waited for one of higher priority.
    """

    kind: Kind
    name: str = ""
    pid: int | None = None
    prio: int | None = None
    above: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """A piece of the time and what took it, from `begin_ns` to `end_ns` on the clock of the trace.

    `pid` is the thread that is followed, and `state` what it does; None between one thread and the next.
    """

    begin_ns: int
    end_ns: int
    cause: Cause
    cpu: int | None = None
    pid: int | None = None
    state: State | None = None

    @property
    def length_ns(self) -> int:
        """How long it took."""
        return self.end_ns - self.begin_ns
