"""Builds the timeline of a trace from its events, one at a time."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from rtrun.causes.events import (
    Callback,
    Console,
    Context,
    Current,
    Event,
    Fault,
    Frequency,
    Futex,
    Interrupt,
    Lost,
    Migration,
    Raise,
    Signal,
    Switch,
    Thaw,
    TimerExpiry,
    TimerStart,
    Wake,
)
from rtrun.causes.timeline import IDLE_PID, Expiry, Occupant, Span, State, StateChange, Timeline, Waker, Why

NORMAL_PRIO = 100  # from here on a thread has no real-time priority
# Operations that wait for the owner of a lock (include/uapi/linux/futex.h): FUTEX_WAIT, which glibc uses for mutexes
# but not for condition variables, FUTEX_LOCK_PI, FUTEX_LOCK_PI2. The bits above 127 are flags.
_LOCKING = frozenset({0, 6, 13})
_FUTEX_COMMAND = 127
# signal(7): SIGCONT; and SIGSTOP, SIGTSTP, SIGTTIN and SIGTTOU. The numbers hold for every Linux architecture except
# MIPS, Alpha, PA-RISC and SPARC.
_CONTINUING = 18
# A signal is recorded at most this long after the threads that it wakes.
SIGNALLED_WITHIN_NS = 100_000
_STOPPING = frozenset({19, 20, 21, 22})
# Recording may be paused while a trace is copied. Only a thread that runs without having been woken proves such a
# pause: idle CPUs may have no events for the same time.
PAUSED_NS = 10_000_000

# Timers that let threads run again after these used up their time (kernel/sched/rt.c, fair.c).
_RT_REFILLING = frozenset({"sched_rt_period_timer"})
_REFILLING = _RT_REFILLING | {"sched_cfs_period_timer", "sched_cfs_slack_timer"}


class _Layer(NamedTuple):
    """An interrupt or softirq that a CPU is in."""

    occupant: Occupant
    began_ns: int
    raised: Raise | None


@dataclass(kw_only=True, slots=True)
class _Cpu:
    """A CPU while its events are read."""

    thread: Occupant | None = None
    since_ns: int
    last_ns: int
    hard: list[_Layer] = field(default_factory=list)
    # By thread: with PREEMPT_RT another thread may run in the middle of a softirq.
    soft: dict[int, list[_Layer]] = field(default_factory=lambda: defaultdict(list))
    raises: dict[str, Raise] = field(default_factory=dict)
    expiry: TimerExpiry | None = None
    offset_ns: int = 0
    # Threads that could run here, but do not: with a real-time priority, and without.
    queued: set[int] = field(default_factory=set)
    queued_normal: set[int] = field(default_factory=set)
    spans: list[Span] = field(default_factory=list)
    # The place of the first span since the thread was given this CPU.
    first_of_thread: int = 0
    # The place of the first span since the trace began or events were lost; and by thread the softirq that was under
    # way then.
    first_known: int = 0
    began_before: dict[int, Span] = field(default_factory=dict)
    late_ns: list[tuple[int, int]] = field(default_factory=list)

    def layer(self) -> _Layer | None:
        if self.hard:
            return self.hard[-1]
        soft = self.soft.get(self.thread.pid) if self.thread else None
        return soft[-1] if soft else None

    def close(self, at_ns: int) -> None:
        """End the current span of the CPU."""
        if at_ns > self.since_ns:
            layer = self.layer()
            self.spans.append(Span(self.since_ns, at_ns, layer.occupant if layer else self.thread))
            self.since_ns = at_ns

    def name_what_ran(self, pid: int, name: str) -> None:
        """Give a thread the name that it has when it leaves the CPU, because a new process first has its parent's
        name."""
        for place in range(self.first_of_thread, len(self.spans)):
            span = self.spans[place]
            if span.occupant is not None and span.occupant.context is Context.THREAD and span.occupant.pid == pid:
                self.spans[place] = span._replace(occupant=span.occupant._replace(name=name))

    def forget_idle(self, from_ns: int) -> None:
        """From a moment on, forget that the CPU was idle: it may have done something else."""
        spans = self.spans[self.first_of_thread :]
        del self.spans[self.first_of_thread :]
        for span in spans:
            is_idle = span.occupant is not None and span.occupant.context is Context.THREAD
            if not is_idle or span.end_ns <= from_ns:
                self.spans.append(span)
                continue
            if span.begin_ns < from_ns:
                self.spans.append(span._replace(end_ns=from_ns))
            self.spans.append(Span(max(span.begin_ns, from_ns), span.end_ns, None))

    def note_late(self, start: TimerStart) -> None:
        """Record for how long an expiring timer had waited for its interrupt."""
        begin_ns = max(start.hard_ns + self.offset_ns, start.at_ns)
        if self.hard and begin_ns < self.hard[-1].began_ns:
            self.late_ns.append((begin_ns, self.hard[-1].began_ns))

    def name_what_began_before(self) -> None:
        """Give a softirq that was under way when the trace began, or events were lost, the spans up to its end."""
        for place in range(self.first_known, len(self.spans)) if self.began_before else ():
            span = self.spans[place]
            if span.occupant is None or span.occupant.context is not Context.THREAD:
                continue
            softirq = self.began_before.get(span.occupant.pid)
            if softirq is not None and span.end_ns <= softirq.end_ns:
                self.spans[place] = span._replace(occupant=softirq.occupant)
        self.began_before.clear()
        self.first_known = len(self.spans)


class _Builder:
    """A timeline while the events are read, one at a time in the order of time."""

    def __init__(self) -> None:
        self.cpus: dict[int, _Cpu] = {}
        self.threads: dict[int, list[StateChange]] = defaultdict(list)
        self.names: dict[int, str] = {}
        self.prios: dict[int, int] = {}
        self.timers: dict[str, TimerStart] = {}
        self.futexes: dict[int, int] = {}
        self.faults: set[int] = set()
        self.faults_ns: dict[int, list[int]] = defaultdict(list)
        self.consoles_ns: dict[int, list[int]] = defaultdict(list)
        self.frequencies: dict[int, list[Frequency]] = defaultdict(list)
        self.stops: list[Signal] = []
        self.refills_ns: dict[bool, list[int]] = defaultdict(list)
        self.callbacks: dict[int, list[Callback]] = defaultdict(list)
        # Until a thread sleeps: whom it woke, and whether it unfroze a control group.
        self.woke: dict[int, list[int]] = defaultdict(list)
        self.thawing: set[int] = set()
        # Threads that slept on after their timer had expired, and when that was.
        self.overslept_ns: dict[int, int] = {}
        self.lost: list[Lost] = []
        # The time of the last event of any CPU, and of the first one after a pause without any.
        self.last_ns = self.resumed_ns = 0
        self.has_waking = False
        self.not_woken: set[int] = set()
        # The CPU on whose queue a thread is.
        self.queues: dict[int, _Cpu] = {}

    def add(self, event: Event) -> None:
        cpu = self.cpus.get(event.cpu)
        if cpu is None:
            cpu = self.cpus[event.cpu] = _Cpu(since_ns=event.at_ns, last_ns=event.at_ns)
        if event.at_ns - self.last_ns > PAUSED_NS:
            self.resumed_ns = event.at_ns
        self.last_ns = event.at_ns
        match event:
            case Switch():
                self._switch(cpu, event)
            case Wake():
                self._wake(cpu, event)
            case Interrupt():
                _interrupt(cpu, event)
            case TimerStart():
                self.timers[event.timer] = event
                if event.wakes is not None:
                    self.overslept_ns.pop(event.wakes, None)
            case TimerExpiry():
                self._expire(cpu, event)
            case Migration():
                self._queue(event.pid, event.at_ns, event.to_cpu)
                if event.pid in self.queues:
                    self._enqueue(event.pid, event.to_cpu)
            case Current():
                self.names.setdefault(event.pid, event.name)
                if cpu.thread is not None and self._is_waiting(event.pid):
                    self._leave_idle(cpu, event)
                if cpu.thread is None:
                    cpu.thread = Occupant(Context.THREAD, event.name, event.pid, None)
                    self.threads[event.pid].append(StateChange(event.at_ns, State.RUNNING, event.cpu))
            case Lost():
                self._lose(cpu, event)
            case _:
                self._remember(cpu, event)
        cpu.last_ns = event.at_ns

    def _is_waiting(self, pid: int) -> bool:
        """Whether a thread was woken and has not been seen to run since; otherwise this may be its last line on the
        CPU."""
        changes = self.threads.get(pid, [])
        return bool(changes) and changes[-1].state is State.WAITING

    def _leave_idle(self, cpu: _Cpu, event: Current) -> None:
        """A thread runs on a CPU that was last seen idle: a kernel may not record how a CPU leaves idle.

        The thread began to run at some time between its wake-up and now. What the CPU did in between is not known.
        """
        cpu.close(event.at_ns)
        cpu.forget_idle(self.threads[event.pid][-1].at_ns)
        cpu.first_of_thread = len(cpu.spans)
        cpu.hard.clear()
        cpu.expiry = None
        cpu.thread = None
        self._dequeue(event.pid)

    def _remember(self, cpu: _Cpu, event: Event) -> None:
        """Keep an event that changes nothing now, but explains a later change."""
        match event:
            case Raise():
                cpu.raises.setdefault(event.name, event)
            case Futex():
                self.faults.discard(event.pid)
                if event.operation is None:
                    self.futexes.pop(event.pid, None)
                else:
                    self.futexes[event.pid] = event.operation & _FUTEX_COMMAND
            case Fault():
                self.faults.add(event.pid)
                self.faults_ns[event.pid].append(event.at_ns)
            case Console():
                self.consoles_ns[event.pid].append(event.at_ns)
            case Signal():
                self._signal(event)
            case Thaw():
                self.thawing.add(event.by_pid)
            case Callback():
                self.callbacks[event.pid].append(event)
            case Frequency():
                self.frequencies[event.of_cpu].append(event)

    def _expire(self, cpu: _Cpu, event: TimerExpiry) -> None:
        # All timers of one interrupt have the same `now`, which was read when it began.
        if cpu.expiry is None or cpu.expiry.now_ns != event.now_ns:
            cpu.offset_ns = event.at_ns - event.now_ns
        cpu.expiry = event
        if event.function in _REFILLING:
            self.refills_ns[event.function in _RT_REFILLING].append(event.at_ns)
        if (start := self.timers.get(event.timer)) is not None:
            cpu.note_late(start)
            if start.wakes is not None:
                self.overslept_ns[start.wakes] = event.at_ns

    def _switch(self, cpu: _Cpu, event: Switch) -> None:
        at_ns, number, pid, name, prio, state, next_pid, next_name, next_prio = event
        can_run = state.startswith("R")
        cpu.close(at_ns)
        if cpu.thread is not None and cpu.thread.name != name:
            cpu.name_what_ran(pid, name)
        cpu.first_of_thread = len(cpu.spans)
        cpu.hard.clear()
        cpu.expiry = None
        self._dequeue(next_pid)
        self.prios[pid] = prio
        if can_run and pid != IDLE_PID:
            self._enqueue(pid, number)
        else:
            self._dequeue(pid)
        throttled = next_prio >= NORMAL_PRIO and bool(cpu.queued)
        passed_over = frozenset(cpu.queued_normal) if next_pid == IDLE_PID else frozenset()
        cpu.thread = Occupant(Context.THREAD, next_name, next_pid, next_prio, throttled, passed_over)
        self.names[pid], self.prios[pid] = name, prio
        self.names[next_pid], self.prios[next_pid] = next_name, next_prio
        if pid != IDLE_PID:
            if can_run:
                self.threads[pid].append(StateChange(at_ns, State.WAITING, number))
            else:
                self.threads[pid].append(StateChange(at_ns, State.ASLEEP, number, why=self._why(event)))
                self.woke.pop(pid, None)
                self.thawing.discard(pid)
        if next_pid != IDLE_PID:
            self.faults.discard(next_pid)
            changes = self.threads.get(next_pid)
            if changes is None:
                self.not_woken.add(next_pid)
            elif changes[-1].state is State.ASLEEP and changes[-1].at_ns < self.resumed_ns:
                # It was woken while nothing was recorded: it could run when recording continued, if not before.
                changes.append(StateChange(self.resumed_ns, State.WAITING, number))
            self.threads[next_pid].append(StateChange(at_ns, State.RUNNING, number))

    def _why(self, event: Switch) -> Why:
        if event.state.startswith(("T", "t")):
            return Why.STOPPED
        if event.pid in self.faults:
            return Why.FAULT
        if self.futexes.get(event.pid) in _LOCKING:
            return Why.LOCK
        return Why.UNINTERRUPTIBLE if event.state.startswith("D") else Why.UNKNOWN

    def _enqueue(self, pid: int, cpu: int) -> None:
        self._dequeue(pid)
        if (queue := self.cpus.get(cpu)) is not None:
            is_normal = self.prios.get(pid, NORMAL_PRIO) >= NORMAL_PRIO
            (queue.queued_normal if is_normal else queue.queued).add(pid)
            self.queues[pid] = queue

    def _dequeue(self, pid: int) -> None:
        if (queue := self.queues.pop(pid, None)) is not None:
            queue.queued.discard(pid)
            queue.queued_normal.discard(pid)

    def _wake(self, cpu: _Cpu, event: Wake) -> None:
        if event.is_done:
            self._enqueue(event.pid, event.target_cpu)
        # A new thread has no sched_waking.
        if event.is_done and self.has_waking and event.pid in self.threads:
            self._queue(event.pid, event.at_ns, event.target_cpu)
            return
        self.has_waking |= not event.is_done
        changes = self.threads[event.pid]
        # Woken while it still runs, or again before it ran: its state stays.
        if changes and changes[-1].state is not State.ASLEEP:
            return
        waker = self._waker(cpu, event)
        if event.context is Context.THREAD:
            waker = self._held(cpu, event, waker)
            self.woke[event.by_pid].append(event.pid)
        self.overslept_ns.pop(event.pid, None)
        changes.append(StateChange(event.at_ns, State.WAITING, event.target_cpu, waker=waker))

    def _waker(self, cpu: _Cpu, event: Wake) -> Waker:
        layer = cpu.layer()
        expiry = None
        if event.context is not Context.THREAD and cpu.expiry is not None:
            start = self.timers.get(cpu.expiry.timer)
            soft_ns = start.soft_ns + cpu.offset_ns if start else None
            hard_ns = start.hard_ns + cpu.offset_ns if start else None
            expiry = Expiry(soft_ns, hard_ns, event.cpu)
        if event.context is Context.THREAD or layer is None:
            name = self.names.get(event.by_pid, "") if event.context is Context.THREAD else event.context.value
            began_ns = cpu.expiry.at_ns if expiry and cpu.expiry else event.at_ns
            return Waker(event.cpu, event.by_pid, event.context, name, began_ns, expiry, None)
        context, name = layer.occupant.context, layer.occupant.name
        return Waker(event.cpu, event.by_pid, context, name, layer.began_ns, expiry, layer.raised)

    def _held(self, cpu: _Cpu, event: Wake, waker: Waker) -> Waker:
        """The waker, marked if it released a stopped or frozen thread: the way back does not follow such a waker."""
        slept = self.threads[event.pid][-1] if self.threads[event.pid] else None
        if slept is not None and slept.why is Why.STOPPED:
            return waker._replace(held=Why.STOPPED)
        if event.by_pid in self.thawing:
            return waker._replace(held=Why.FROZEN)
        # The freezer of version 1 has no event: a frozen thread's timer expires without effect.
        expired_ns = self.overslept_ns.get(event.pid)
        if expired_ns is None or slept is None or expired_ns < slept.at_ns:
            return waker
        start = self.timers.get(cpu.expiry.timer) if cpu.expiry else None
        # With PREEMPT_RT a thread may run the timers.
        is_timer = start is not None and start.wakes == event.pid
        return waker if is_timer else waker._replace(held=Why.FROZEN, held_ns=expired_ns)

    def _signal(self, event: Signal) -> None:
        """Mark the threads that a signal woke to stop or to continue: their wake-ups are recorded before it.

        A thread that continues may have been stopped before the trace began.
        """
        if event.number in _STOPPING:
            self.stops.append(event)
            for pid in self.woke.get(event.by_pid, ()):
                last = self.threads[pid][-1]
                is_for_that = last.at_ns > event.at_ns - SIGNALLED_WITHIN_NS
                if is_for_that and last.waker is not None and last.waker.pid == event.by_pid:
                    self.threads[pid][-1] = last._replace(waker=last.waker._replace(stops=True))
        elif event.number == _CONTINUING:
            for pid in self.woke.get(event.by_pid, ()):
                first = self.threads[pid][0]
                if first.waker is not None and first.waker.pid == event.by_pid:
                    self.threads[pid][0] = first._replace(waker=first.waker._replace(held=Why.STOPPED))

    def _queue(self, pid: int, at_ns: int, cpu: int) -> None:
        """Move a waiting thread to another CPU's queue from now on."""
        changes = self.threads.get(pid)
        if changes and changes[-1].state is State.WAITING and changes[-1].cpu != cpu:
            changes.append(StateChange(at_ns, State.WAITING, cpu))

    def _lose(self, cpu: _Cpu, event: Lost) -> None:
        cpu.close(cpu.last_ns)
        cpu.thread = None
        cpu.hard.clear()
        cpu.soft.clear()
        cpu.expiry = None
        for pid in (*cpu.queued, *cpu.queued_normal):
            self._dequeue(pid)
        cpu.close(event.at_ns)
        cpu.name_what_began_before()
        self.lost.append(event)

    def wait_from_the_begin(self) -> None:
        """Let threads that ran without a recorded wake-up wait from the begin of the trace on.

        The trace begins when every CPU has begun, since any CPU may have woken them, and after the last lost event.
        """
        begins_ns = [cpu.spans[0].begin_ns if cpu.spans else cpu.since_ns for cpu in self.cpus.values()]
        for pid in self.not_woken:
            ran = self.threads[pid][0]
            begin_ns = max(*begins_ns, *(event.at_ns for event in self.lost if event.at_ns <= ran.at_ns), 0)
            if begin_ns < ran.at_ns:
                self.threads[pid].insert(0, StateChange(begin_ns, State.WAITING, ran.cpu))


def _interrupt(cpu: _Cpu, event: Interrupt) -> None:
    if cpu.thread is None:
        return
    cpu.close(event.at_ns)
    layers = cpu.hard if event.context is Context.HARD else cpu.soft[cpu.thread.pid]
    if event.begins:
        raised = cpu.raises.pop(event.name, None) if event.context is Context.SOFT else None
        layers.append(_Layer(Occupant(event.context, event.name, cpu.thread.pid, None), event.at_ns, raised))
    elif layers:
        layers.pop()
    elif event.context is Context.SOFT:
        softirq = Occupant(event.context, event.name, cpu.thread.pid, None)
        cpu.began_before.setdefault(cpu.thread.pid, Span(0, event.at_ns, softirq))
    cpu.expiry = None


def reconstruct(events: Iterable[Event], *, started: Iterable[TimerStart] = ()) -> Timeline:
    """Build a timeline from the events of a trace, which must be in the order of time.

    `started` are timers that were started before these events.
    """
    builder = _Builder()
    builder.timers.update({start.timer: start for start in started})
    begin_ns = end_ns = 0
    for event in events:
        if not builder.cpus:
            begin_ns = event.at_ns
        builder.add(event)
        end_ns = event.at_ns
    for cpu in builder.cpus.values():
        cpu.close(end_ns)
        cpu.name_what_began_before()
    builder.wait_from_the_begin()
    return Timeline(
        begin_ns=begin_ns,
        cpus={number: cpu.spans for number, cpu in builder.cpus.items()},
        threads=dict(builder.threads),
        names=builder.names,
        prios=builder.prios,
        lost=tuple(builder.lost),
        stops=tuple(builder.stops),
        faults_ns=dict(builder.faults_ns),
        consoles_ns=dict(builder.consoles_ns),
        frequencies=dict(builder.frequencies),
        late_ns={number: cpu.late_ns for number, cpu in builder.cpus.items()},
        refills_ns=dict(builder.refills_ns),
        callbacks=dict(builder.callbacks),
    )
