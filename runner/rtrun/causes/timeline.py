"""A trace in order: what each CPU did at each moment, and the states of each thread."""

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import NamedTuple

from rtrun.causes.events import Callback, Context, Frequency, Lost, Raise, Signal

IDLE_PID = 0


class Occupant(NamedTuple):
    """What has a CPU: a thread, or an interrupt or softirq within it. The priority of a thread is None if not known.

    `throttled`: the scheduler chose a thread without a real-time priority, or no thread, though a real-time thread was
    queued on the CPU. `passed_over`: the threads without a real-time priority that were queued when none was chosen.
    """

    context: Context
    name: str
    pid: int
    prio: int | None
    throttled: bool = False
    passed_over: frozenset[int] = frozenset()


class Span(NamedTuple):
    """Who had a CPU, and from when to when; `occupant` is None if events were lost."""

    begin_ns: int
    end_ns: int
    occupant: Occupant | None


class State(Enum):
    """What a thread does. WAITING: it could run, but has no CPU."""

    RUNNING = auto()
    WAITING = auto()
    ASLEEP = auto()


class Why(Enum):
    """What a sleeping thread waits for, if events show that."""

    UNKNOWN = auto()
    LOCK = auto()
    FAULT = auto()
    STOPPED = auto()
    FROZEN = auto()
    UNINTERRUPTIBLE = auto()


class Expiry(NamedTuple):
    """A timer that expired on a CPU, and the times from which it could and had to expire (None: not in the trace)."""

    soft_ns: int | None
    hard_ns: int | None
    cpu: int


class Waker(NamedTuple):
    """What woke a thread: a thread, an interrupt or a softirq, which began at `began_ns`.

    `held` is STOPPED or FROZEN if the thread was released rather than woken; `held_ns`, if known, is when it would have
    woken otherwise. `stops`: it was woken to be stopped, not to get work.
    """

    cpu: int
    pid: int
    context: Context
    name: str
    began_ns: int
    expiry: Expiry | None
    raised: Raise | None
    held: Why = Why.UNKNOWN
    held_ns: int | None = None
    stops: bool = False


class StateChange(NamedTuple):
    """From this moment on a thread is in a state. `cpu` is that of its run queue; `waker` is set if it was woken."""

    at_ns: int
    state: State
    cpu: int
    waker: Waker | None = None
    why: Why = Why.UNKNOWN


@dataclass(frozen=True, kw_only=True, slots=True)
class Timeline:
    """A trace in order: spans by CPU and changes by thread, both by time."""

    begin_ns: int
    cpus: Mapping[int, Sequence[Span]]
    threads: Mapping[int, Sequence[StateChange]]
    names: Mapping[int, str]
    prios: Mapping[int, int]
    """The latest priority of each thread that a switch names."""
    lost: Sequence[Lost]
    stops: Sequence[Signal]
    """The signals that stop a program."""
    faults_ns: Mapping[int, Sequence[int]]
    """When each thread had page faults."""
    consoles_ns: Mapping[int, Sequence[int]]
    """When each thread printed a line for the console."""
    frequencies: Mapping[int, Sequence[Frequency]]
    """The changes of the frequency of each CPU."""
    late_ns: Mapping[int, Sequence[tuple[int, int]]]
    """For each CPU, in order: from when a timer should have expired until its interrupt came."""
    refills_ns: Mapping[bool, Sequence[int]]
    """When throttled threads could go on: those with a real-time priority (True), and those without (False)."""
    callbacks: Mapping[int, Sequence[Callback]] = field(default_factory=dict)
    """The callbacks of each thread, in order."""

    def spans(self, cpu: int, begin_ns: int, end_ns: int) -> Iterator[Span]:
        """What a CPU did between two moments, without gaps."""
        spans = self.cpus.get(cpu, ())
        # A span begins with its time, as a change does: so tuples are compared, which needs no key function.
        place = max(0, bisect_left(spans, (begin_ns + 1,)) - 1)
        while begin_ns < end_ns:
            while place < len(spans) and spans[place].end_ns <= begin_ns:
                place += 1
            if place == len(spans) or spans[place].begin_ns >= end_ns:
                yield Span(begin_ns, end_ns, None)
                return
            span = spans[place]
            if span.begin_ns > begin_ns:
                yield Span(begin_ns, span.begin_ns, None)
                begin_ns = span.begin_ns
            is_whole = span.begin_ns == begin_ns and span.end_ns <= end_ns
            yield span if is_whole else Span(begin_ns, min(span.end_ns, end_ns), span.occupant)
            begin_ns = span.end_ns

    def place(self, pid: int, at_ns: int) -> int:
        """The place of the last change of a thread up to a moment; -1 if the trace begins later."""
        return bisect_left(self.threads.get(pid, ()), (at_ns + 1,)) - 1

    def running(self, pid: int, at_ns: int) -> int:
        """The place of the change that made a thread run at a moment: several changes may have the same microsecond."""
        changes, place = self.threads.get(pid, ()), self.place(pid, at_ns)
        while place > 0 and changes[place].at_ns == at_ns and changes[place].state is not State.RUNNING:
            place -= 1
        return place
