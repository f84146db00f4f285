"""Cuts the time between when a thread should have run and when it did into what took it.

The cut goes backwards from the moment at which the measured thread has its value. Time in which the thread ran counts
for the thread, or for an interrupt within it. Time in which it waited for a CPU counts for whoever had the CPU. Time in
which it slept counts for what woke it: a timer, whose interrupt may have been late; an interrupt; or a thread. That
thread is then followed in the same way, even into another process.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from rtrun.causes.events import Callback, Context
from rtrun.causes.parts import NAMELESS, Cause, Kind, Part
from rtrun.causes.reconstruction import NORMAL_PRIO
from rtrun.causes.timeline import Span, State, StateChange, Timeline, Waker, Why
from rtrun.causes.waits import GIVEN_THE_CPU, CpuWaits, of_interrupt

STEPS_MAX = 10_000  #: steps from a late thread back to what woke it: threads may wake one another in a circle
TIMER = "the timer's own"
BEFORE = "before the trace begins"
# A fault has no event at its end. A thread whose faults follow one another this closely does little else.
BETWEEN_FAULTS_NS = 50_000


def cut(
    timeline: Timeline,
    *,
    pid: int,
    own: frozenset[int],
    due_ns: int,
    at_ns: int,
    callbacks: Sequence[Callback] = (),
    used_up: bool = False,
) -> tuple[Part, ...]:
    """Cut the time from `due_ns` to `at_ns` into parts, earliest first, that add up to it.

    `pid` is the thread that ran at `at_ns`, `own` are the threads of the measured program. `callbacks` are the earlier
    callbacks of that thread, in order. `used_up`: the program's control group used up its quota during the run.
    """
    parts: list[Part] = []
    end_ns = at_ns
    for part in _Walk(timeline, pid, own, due_ns, CpuWaits(timeline, pid, own, used_up)).back(at_ns):
        begin_ns, limit_ns = max(part.begin_ns, due_ns), max(min(part.end_ns, end_ns), due_ns)
        if limit_ns < end_ns:
            parts.append(_unexplained(limit_ns, end_ns))
        if begin_ns < limit_ns:
            parts.append(replace(part, begin_ns=begin_ns, end_ns=limit_ns))
        end_ns = min(begin_ns, limit_ns)
    if end_ns > due_ns:
        begins_ns = (spans[0].begin_ns for spans in timeline.cpus.values() if spans)
        parts.append(_unexplained(due_ns, end_ns, BEFORE if end_ns <= max(begins_ns, default=0) else ""))
    pieces = (piece for part in reversed(parts) for piece in _not_interrupted(timeline, part))
    slowed = (piece for part in pieces for piece in _slowed(timeline, part))
    return tuple(_joined(piece for part in slowed for piece in _in_callbacks(timeline, pid, callbacks, part)))


def _not_interrupted(timeline: Timeline, part: Part) -> Iterator[Part]:
    """Cut a part in which another thread of the program had the CPU at the times when a timer's interrupt was late.

    Interrupts were off, or the CPU itself did not run: the thread may be innocent.
    """
    at_ns = part.begin_ns
    if part.cause.kind is Kind.OTHER_THREAD and part.cpu is not None:
        late_ns = timeline.late_ns.get(part.cpu, ())
        for place in range(bisect_right(late_ns, at_ns, key=lambda late: late[1]), len(late_ns)):
            begin_ns, end_ns = max(late_ns[place][0], at_ns), min(late_ns[place][1], part.end_ns)
            if begin_ns >= part.end_ns:
                break
            if begin_ns < end_ns:
                if at_ns < begin_ns:
                    yield replace(part, begin_ns=at_ns, end_ns=begin_ns)
                yield replace(part, begin_ns=begin_ns, end_ns=end_ns, cause=replace(part.cause, kind=Kind.TIMER_LATE))
                at_ns = end_ns
    if at_ns < part.end_ns:
        yield replace(part, begin_ns=at_ns)


def _slowed(timeline: Timeline, part: Part) -> Iterator[Part]:
    """Split off the time that a thread of the program lost because its CPU ran below its highest frequency.

    The highest frequency is that in the trace. The time is an upper bound: code that waits for memory does not run
    faster at a higher frequency.
    """
    changes = timeline.frequencies.get(-1 if part.cpu is None else part.cpu, ())
    if part.cause.kind not in (Kind.PROGRAM, Kind.OTHER_THREAD) or not changes:
        yield part
        return
    highest_khz = max(change.khz for change in changes)
    slowed = Cause(kind=Kind.SLOWED, name=f"below {highest_khz / 1000:.0f} MHz")
    within = [change for change in changes if change.at_ns < part.end_ns]
    begins_ns = [part.begin_ns, *(change.at_ns for change in within if change.at_ns > part.begin_ns), part.end_ns]
    for begin_ns, end_ns in pairwise(begins_ns):
        khz = next((change.khz for change in reversed(within) if change.at_ns <= begin_ns), highest_khz)
        from_ns = begin_ns + (end_ns - begin_ns) * khz // max(1, highest_khz)
        yield from (
            Part(begin_ns=start_ns, end_ns=stop_ns, cause=cause, cpu=part.cpu)
            for start_ns, stop_ns, cause in ((begin_ns, from_ns, part.cause), (from_ns, end_ns, slowed))
            if start_ns < stop_ns
        )


def _in_callbacks(timeline: Timeline, pid: int, callbacks: Sequence[Callback], part: Part) -> Iterator[Part]:
    """Divide a part that names no other culprit among the earlier callbacks of the measured thread: the value waited
    for them.

    If the end of a callback was not seen, only the time that its thread ran until its next callback may belong to it.
    """
    at_ns = part.begin_ns
    for callback, following in pairwise((*callbacks, None)) if part.cause.kind in NAMELESS else ():
        assert callback is not None
        is_open = callback.took_ns is None
        end_ns = callback.at_ns if not is_open else following.begin_ns if following else part.end_ns
        begin_ns, end_ns = max(callback.begin_ns, at_ns), min(end_ns, part.end_ns)
        if begin_ns >= end_ns or (is_open and part.cause.kind is not Kind.PROGRAM):
            continue
        if at_ns < begin_ns:
            yield replace(part, begin_ns=at_ns, end_ns=begin_ns)
        name = f"{callback.name} (its end is not known)" if is_open else callback.name
        cause = Cause(kind=Kind.CALLBACK, name=name, pid=pid, prio=timeline.prios.get(pid))
        yield replace(part, begin_ns=begin_ns, end_ns=end_ns, cause=cause)
        at_ns = end_ns
    if at_ns < part.end_ns:
        yield replace(part, begin_ns=at_ns)


def _unexplained(begin_ns: int, end_ns: int, name: str = "") -> Part:
    return Part(begin_ns=begin_ns, end_ns=end_ns, cause=Cause(kind=Kind.UNEXPLAINED, name=name))


def _marked(pid: int, state: State, parts: Iterable[Part]) -> Iterator[Part]:
    """The parts, marked with a thread and its state."""
    return (replace(part, pid=pid, state=state) for part in parts)


def _joined(parts: Iterator[Part]) -> Iterator[Part]:
    last: Part | None = None
    for part in parts:
        if last is not None and replace(last, end_ns=part.end_ns) == replace(part, begin_ns=last.begin_ns):
            last = replace(last, end_ns=part.end_ns)
            continue
        if last is not None:
            yield last
        last = part
    if last is not None:
        yield last


@dataclass(frozen=True, slots=True)
class _Walk:
    """The way back from the measured thread; yields parts from the latest to the earliest."""

    timeline: Timeline
    pid: int
    own: frozenset[int]
    due_ns: int
    waits: CpuWaits

    def back(self, at_ns: int) -> Iterator[Part]:
        pid, place = self.pid, self.timeline.running(self.pid, at_ns)
        for _ in range(STEPS_MAX):
            if at_ns <= self.due_ns or place < 0:
                return
            change = self.timeline.threads[pid][place]
            begin_ns = min(change.at_ns, at_ns)
            if change.state is State.RUNNING:
                yield from _marked(pid, change.state, self._ran(pid, change.cpu, begin_ns, at_ns))
            elif change.state is State.WAITING:
                yield from _marked(pid, change.state, self._waited(pid, change.cpu, begin_ns, at_ns))
            else:
                yield from _marked(pid, change.state, [_unexplained(begin_ns, at_ns)])
            at_ns, place = begin_ns, place - 1
            if change.waker is None or at_ns <= self.due_ns:
                continue
            slept = self.timeline.threads[pid][place] if place >= 0 else None
            hands_over = change.waker.context is Context.THREAD and not change.waker.stops
            if hands_over and not self._is_held_up(slept, change.waker):
                pid, place = change.waker.pid, self.timeline.running(change.waker.pid, at_ns)
                continue
            asleep_ns = min(slept.at_ns, at_ns) if slept else self.due_ns
            if change.waker.raised and change.waker.raised.context is Context.THREAD and change.waker.expiry is None:
                raised = change.waker.raised
                yield from self._softirq(pid, change.waker, at_ns)
                pid, at_ns = raised.pid, min(raised.at_ns, at_ns)
                place = self.timeline.running(pid, at_ns)
                continue
            if (awaited := self._awaited(pid, change.waker, at_ns)) is not None:
                pid, place = awaited, self.timeline.place(awaited, at_ns)
                continue
            yield from _marked(pid, State.ASLEEP, self._slept(pid, slept, change.waker, asleep_ns, at_ns))
            at_ns, place = asleep_ns, place - 1

    def _awaited(self, pid: int, waker: Waker, at_ns: int) -> int | None:
        """The thread of the program that should have woken this one, but waited for a CPU when something else woke it.

        Something else is a timeout (a timer that expires after the value was due) or a signal that stops the program.
        Candidates are the threads that woke this one before: they hand work over to it.
        """
        expires_ns = waker.expiry.soft_ns if waker.expiry else None
        if not waker.stops and (expires_ns is None or expires_ns <= self.due_ns):
            return None
        earlier = reversed(self.timeline.threads[pid][: self.timeline.place(pid, at_ns)])
        wakers = (change.waker for change in earlier if change.waker and change.waker.context is Context.THREAD)
        for mate in dict.fromkeys(waker.pid for waker in wakers if waker.pid in self.own - {pid}):
            place = self.timeline.place(mate, at_ns)
            if place >= 0 and self.timeline.threads[mate][place].state is State.WAITING:
                return mate
        return None

    def _is_held_up(self, slept: StateChange | None, waker: Waker) -> bool:
        """Whether a thread waited for something that another one held, or was held itself, rather than waiting for
        work."""
        if waker.held is not Why.UNKNOWN:
            return True
        if slept is None:
            return False
        if slept.why is not Why.UNKNOWN:
            return True
        # Without futex events two signs show a lock: the thread had begun the work of this period, and another program
        # woke it.
        return slept.at_ns > self.due_ns and waker.pid not in self.own and self.pid in self.own

    def _ran(self, pid: int, cpu: int, begin_ns: int, end_ns: int) -> Iterator[Part]:
        kind = Kind.PROGRAM if pid == self.pid else Kind.OTHER_THREAD
        for span in self._spans(cpu, begin_ns, end_ns):
            who = span.occupant
            if who is not None and who.context is not Context.THREAD:
                yield self._part(span, cpu, of_interrupt(who.context, who.name))
            else:
                yield from self._with_faults(span, cpu, self.waits.cause(kind, pid))

    def _with_faults(self, span: Span, cpu: int, cause: Cause) -> Iterator[Part]:
        """The time that a thread ran, latest first; time between close page faults counts for the faults."""
        times = self.timeline.faults_ns.get(cause.pid or 0, ())
        within = times[bisect_left(times, span.begin_ns) : bisect_right(times, span.end_ns)]
        end_ns = span.end_ns
        for first_ns, next_ns in reversed(list(pairwise(within))):
            if next_ns - first_ns <= BETWEEN_FAULTS_NS:
                yield Part(begin_ns=next_ns, end_ns=end_ns, cause=cause, cpu=cpu)
                fault = Cause(kind=Kind.FAULT, name=cause.name, pid=cause.pid, prio=cause.prio)
                yield Part(begin_ns=first_ns, end_ns=next_ns, cause=fault, cpu=cpu)
                end_ns = first_ns
        yield Part(begin_ns=span.begin_ns, end_ns=end_ns, cause=cause, cpu=cpu)

    def _waited(self, pid: int, cpu: int, begin_ns: int, end_ns: int) -> Iterator[Part]:
        prio = self.timeline.prios.get(pid)
        refilled_ns = self.waits.refilled_ns(prio, cpu, begin_ns, end_ns)
        for span in self._spans(cpu, begin_ns, end_ns):
            cause = self.waits.who_had(span, pid, prio, begin_ns)
            if span.begin_ns < refilled_ns and cause.kind in GIVEN_THE_CPU:
                is_normal = prio is not None and prio >= NORMAL_PRIO
                cause = Cause(kind=Kind.GROUP) if is_normal else replace(cause, kind=Kind.THROTTLED, above=None)
            yield self._part(span, cpu, cause)

    def _slept(self, pid: int, slept: StateChange | None, waker: Waker, asleep_ns: int, at_ns: int) -> Iterator[Part]:
        """The time from when a thread fell asleep until it was woken."""
        if waker.held is not Why.UNKNOWN:
            yield from self._held(pid, slept, waker, asleep_ns, at_ns)
        elif waker.stops:
            yield _unexplained(asleep_ns, at_ns, "it slept until it was stopped")
        elif waker.expiry is not None:
            yield from self._timer(pid, waker, asleep_ns, at_ns)
        elif waker.context is Context.THREAD:
            why = slept.why if slept else Why.UNKNOWN
            kind = {Why.LOCK: Kind.LOCK, Why.FAULT: Kind.FAULT, Why.UNINTERRUPTIBLE: Kind.BLOCKED}.get(why, Kind.LOCK)
            yield from self._kept(self.waits.cause(kind, waker.pid, waker.name), waker, asleep_ns, at_ns)
        elif slept is not None and slept.why is Why.UNINTERRUPTIBLE:
            cause = Cause(kind=Kind.BLOCKED, name=f"{waker.context} {waker.name}")
            yield Part(begin_ns=asleep_ns, end_ns=at_ns, cause=cause, cpu=waker.cpu)
        else:
            cause = of_interrupt(waker.context, waker.name)
            yield Part(begin_ns=waker.began_ns, end_ns=at_ns, cause=cause, cpu=waker.cpu)
            why = slept.why if slept else Why.UNKNOWN
            before = Cause(kind=Kind.FAULT if why is Why.FAULT else Kind.OUTSIDE, name=waker.name)
            yield Part(begin_ns=asleep_ns, end_ns=waker.began_ns, cause=before, cpu=waker.cpu)

    def _kept(self, cause: Cause, waker: Waker, asleep_ns: int, at_ns: int) -> Iterator[Part]:
        """The time for which another thread kept this one waiting, latest first.

        Time in which a limit throttled that other thread counts for the limit.
        """
        changes = self.timeline.threads.get(waker.pid, ())
        for place in range(self.timeline.place(waker.pid, at_ns), -1, -1):
            change, until_ns = changes[place], changes[place + 1].at_ns if place + 1 < len(changes) else at_ns
            if until_ns <= asleep_ns:
                break
            waited = (
                self._waited(waker.pid, change.cpu, change.at_ns, until_ns) if change.state is State.WAITING else ()
            )
            for part in waited:
                begin_ns, end_ns = max(part.begin_ns, asleep_ns), min(part.end_ns, at_ns)
                if part.cause.kind in (Kind.GROUP, Kind.THROTTLED) and begin_ns < end_ns:
                    yield Part(begin_ns=end_ns, end_ns=at_ns, cause=cause, cpu=waker.cpu)
                    yield replace(part, begin_ns=begin_ns, end_ns=end_ns)
                    at_ns = begin_ns
        yield Part(begin_ns=asleep_ns, end_ns=at_ns, cause=cause, cpu=waker.cpu)

    def _held(self, pid: int, slept: StateChange | None, waker: Waker, asleep_ns: int, at_ns: int) -> Iterator[Part]:
        """The time for which a thread was stopped or frozen, latest first.

        The cause is the thread that sent the stopping signal, if one came after this thread's previous sleep began.
        Otherwise it is the thread that released this one. The two may differ.
        """
        kind, by = (Kind.FROZEN if waker.held is Why.FROZEN else Kind.LET_GO_ON), (waker.pid, waker.name)
        if kind is Kind.LET_GO_ON and slept is not None:
            changes = self.timeline.threads[pid][: self.timeline.place(pid, slept.at_ns)]
            awake_ns = next((change.at_ns for change in reversed(changes) if change.state is State.ASLEEP), 0)
            of_program = (stop for stop in reversed(self.timeline.stops) if stop.pid in self.own | {pid})
            sent = next((stop for stop in of_program if awake_ns <= stop.at_ns <= slept.at_ns), None)
            kind, by = (Kind.STOPPED, (sent.by_pid, "")) if sent else (kind, by)
        begin_ns = max(asleep_ns, min(waker.held_ns or asleep_ns, at_ns))
        yield Part(begin_ns=begin_ns, end_ns=at_ns, cause=self.waits.cause(kind, *by), cpu=waker.cpu)
        yield Part(begin_ns=asleep_ns, end_ns=begin_ns, cause=self.waits.cause(Kind.OWN_SLEEP, pid), cpu=waker.cpu)

    def _timer(self, pid: int, waker: Waker, asleep_ns: int, at_ns: int) -> Iterator[Part]:
        """From the expiry of a timer until it woke the thread, latest first."""
        expiry = waker.expiry
        began_ns = min(waker.began_ns, at_ns)
        name = waker.name if waker.context is Context.SOFT else TIMER
        yield Part(begin_ns=began_ns, end_ns=at_ns, cause=of_interrupt(waker.context, name), cpu=waker.cpu)
        if expiry is None or expiry.soft_ns is None or expiry.hard_ns is None:
            yield _unexplained(asleep_ns, began_ns, "when the timer should have expired is not in the trace")
            return
        soft_ns = max(asleep_ns, min(expiry.soft_ns, began_ns))
        hard_ns = max(soft_ns, min(expiry.hard_ns, began_ns))
        for span in self._spans(waker.cpu, hard_ns, began_ns):
            yield self._part(span, waker.cpu, self.waits.while_late(span, pid))
        yield Part(begin_ns=soft_ns, end_ns=hard_ns, cause=Cause(kind=Kind.TIMER_SLACK), cpu=waker.cpu)
        yield Part(begin_ns=asleep_ns, end_ns=soft_ns, cause=self.waits.cause(Kind.OWN_SLEEP, pid), cpu=waker.cpu)

    def _softirq(self, pid: int, waker: Waker, at_ns: int) -> Iterator[Part]:
        """From when a softirq was raised until it woke the thread, latest first."""
        began_ns = min(waker.began_ns, at_ns)
        yield Part(begin_ns=began_ns, end_ns=at_ns, cause=of_interrupt(waker.context, waker.name), cpu=waker.cpu)
        raised_ns = min(waker.raised.at_ns, began_ns) if waker.raised else began_ns
        for span in self._spans(waker.cpu, raised_ns, began_ns):
            who = span.occupant
            is_raiser = who is not None and waker.raised is not None and who.pid == waker.raised.pid
            cause = self.waits.cause(Kind.OTHER_THREAD, who.pid) if who and is_raiser else None
            yield self._part(span, waker.cpu, cause or self.waits.who_had(span, pid, self.timeline.prios.get(pid), 0))

    def _spans(self, cpu: int, begin_ns: int, end_ns: int) -> Iterator[Span]:
        """What a CPU did, latest first, no earlier than the window."""
        return reversed(list(self.timeline.spans(cpu, max(begin_ns, self.due_ns), end_ns)))

    def _part(self, span: Span, cpu: int, cause: Cause) -> Part:
        return Part(begin_ns=span.begin_ns, end_ns=span.end_ns, cause=cause, cpu=cpu)
