"""For whom a runnable thread had to wait, and why."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from rtrun.causes.events import Context
from rtrun.causes.parts import Cause, Kind
from rtrun.causes.reconstruction import NORMAL_PRIO
from rtrun.causes.timeline import IDLE_PID, Occupant, Span, Timeline

IDLE = "idle"
EVENTS_MISSING = "events are missing"
# Kinds that get the CPU only because another thread is throttled.
GIVEN_THE_CPU = frozenset({Kind.SHARED, Kind.EQUAL, Kind.NOT_PREEMPTED, Kind.IDLE_EXIT, Kind.THROTTLED})
# A throttled thread runs this soon after it has time again, unless another one comes first.
REFILLED_WITHIN_NS = 500_000
# Without a real-time priority it may have to wait for a tick, and for other waiting threads. But mere sharing of the
# CPU may by chance end as soon after a refill. So this limit applies only if a quota was used up, and if the thread had
# waited `LONGER` times as long before the refill as after it.
REFILLED_AT_TICK_NS, LONGER = 4_500_000, 3


@dataclass(frozen=True, slots=True)
class CpuWaits:
    """Why threads waited for a CPU. `pid` is the measured thread, `own` are the threads of its program.

    `used_up`: the program's control group used up its quota during the run.
    """

    timeline: Timeline
    pid: int
    own: frozenset[int]
    used_up: bool

    def cause(self, kind: Kind, pid: int, name: str = "") -> Cause:
        """A thread, by its last name if no other is given."""
        name = name or self.timeline.names.get(pid, "")
        return Cause(kind=kind, name=name, pid=pid, prio=self.timeline.prios.get(pid))

    def refilled_ns(self, prio: int | None, cpu: int, begin_ns: int, end_ns: int) -> int:
        """Until when a waiting thread was throttled; 0 if it was not. A throttled thread gets the CPU as soon as it has
        time again."""
        is_real_time = prio is not None and prio < NORMAL_PRIO
        times = self.timeline.refills_ns.get(is_real_time, ())
        place = bisect_right(times, end_ns) - 1
        if place < 0 or times[place] <= begin_ns:
            return 0
        waited_ns, since_ns = times[place] - begin_ns, end_ns - times[place]
        if self.used_up and not is_real_time and since_ns < min(REFILLED_AT_TICK_NS, waited_ns / LONGER):
            return times[place]
        if since_ns >= REFILLED_WITHIN_NS:
            return 0
        occupants = (span.occupant for span in self.timeline.spans(cpu, times[place], end_ns))
        ran = {who.pid for who in occupants if who is not None and who.context is Context.THREAD}
        return times[place] if len(ran - self.own) <= 1 else 0

    def who_had(self, span: Span, pid: int, prio: int | None, since_ns: int) -> Cause:
        """Why a runnable thread had to wait for the one that has the CPU."""
        who = span.occupant
        if who is None or who.context is not Context.THREAD:
            return of_no_thread(who)
        if who.pid == IDLE_PID:
            if prio is not None and prio >= NORMAL_PRIO:
                return Cause(kind=Kind.GROUP if pid in who.passed_over else Kind.IDLE_EXIT)
            return Cause(kind=Kind.THROTTLED, name=IDLE) if who.throttled else Cause(kind=Kind.IDLE_EXIT)
        if who.pid == pid:
            return self.cause(Kind.PROGRAM if pid == self.pid else Kind.OTHER_THREAD, pid)
        other = who.prio if who.prio is not None else self.timeline.prios.get(who.pid)
        if who.pid in self.own:
            kind = Kind.OTHER_THREAD
        elif prio is None or other is None:
            kind = Kind.UNEXPLAINED
        elif (comes_before := _above(other, prio)) is not None:
            kind = comes_before
        elif prio >= NORMAL_PRIO:
            # Neither has a real-time priority: the scheduler shares the CPU among them, and throttles none.
            kind = Kind.CONSOLE if self._printed(who.pid, span.end_ns) else Kind.SHARED
        elif other == prio:
            kind = Kind.EQUAL
        elif who.throttled or self._was_chosen(who.pid, since_ns, span.end_ns):
            kind = Kind.THROTTLED
        else:
            kind = Kind.CONSOLE if self._printed(who.pid, span.end_ns) else Kind.NOT_PREEMPTED
        above = prio if prio is not None and other is not None and _above(other, prio) is Kind.HIGHER else None
        return Cause(kind=kind, name=who.name, pid=who.pid, prio=other, above=above)

    def _was_chosen(self, pid: int, begin_ns: int, end_ns: int) -> bool:
        """Whether a thread that has the CPU at the end of a period got it within that period."""
        place = self.timeline.running(pid, end_ns - 1)
        return place >= 0 and begin_ns < self.timeline.threads[pid][place].at_ns

    def _printed(self, pid: int, at_ns: int) -> bool:
        """Whether a thread has printed to the console since it got the CPU that it has at a moment.

        A kernel without PREEMPT_RT writes to the console at once, with interrupts or preemption off.
        """
        place = self.timeline.running(pid, at_ns - 1)
        began_ns = self.timeline.threads[pid][place].at_ns if place >= 0 else self.timeline.begin_ns
        times = self.timeline.consoles_ns.get(pid, ())
        return bisect_left(times, began_ns) < bisect_left(times, at_ns)

    def while_late(self, span: Span, pid: int) -> Cause:
        """What a CPU did while a timer's interrupt was late, which then woke the thread `pid`.

        A thread of higher priority kept `pid` from running in any case, with interrupts off (as stop_machine does) or
        not.
        """
        who = span.occupant
        if who is None or who.context is not Context.THREAD:
            return of_no_thread(who)
        if who.pid == IDLE_PID:
            return Cause(kind=Kind.TIMER_LATE, name=IDLE)
        other, prio = self.timeline.prios.get(who.pid), self.timeline.prios.get(pid)
        kind = None
        if who.pid not in self.own and other is not None and prio is not None:
            kind = _above(other, prio)
        kind = kind or (Kind.CONSOLE if self._printed(who.pid, span.end_ns) else Kind.TIMER_LATE)
        return Cause(kind=kind, name=who.name, pid=who.pid, prio=other, above=prio if kind is Kind.HIGHER else None)


def _above(prio: int, of_waiting: int) -> Kind | None:
    """Why a thread has precedence over a waiting one; None if it does not.

    Two threads without a real-time priority share the CPU, whatever their nice values.
    """
    if prio < 0:
        return Kind.DEADLINE
    return Kind.HIGHER if prio < min(of_waiting, NORMAL_PRIO) else None


def of_no_thread(occupant: Occupant | None) -> Cause:
    """The cause while an interrupt or a softirq had the CPU, or while it is not known who had it."""
    if occupant is None:
        return Cause(kind=Kind.UNEXPLAINED, name=EVENTS_MISSING)
    return of_interrupt(occupant.context, occupant.name)


def of_interrupt(context: Context, name: str) -> Cause:
    """The cause that an interrupt or a softirq is, by its name."""
    return Cause(kind=Kind.SOFTIRQ if context is Context.SOFT else Kind.INTERRUPT, name=name)
