"""Loops of threads: when each was due, ran and slept again, from the kernel's own events.

A thread arms a timer and sleeps; the timer's interrupt wakes it, and it runs. An activation begins there. It ends where
the thread began the sleep that its next timer ended, so other waits within a cycle are part of the cycle.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from rtrun.flows.loop_log import GRID_ROWS, UNKNOWN_NS, Latest, LoopLog, LoopThread, LoopTimer
from rtrun.flows.observation_state import ObservationState
from rtrun.flows.programs import NAME_CHARACTERS_MAX, numbered
from rtrun.kinds.limits import TIME_MAX_NS
from rtrun.probes.hits import Gap, ObservedProgram, ProgramThread
from rtrun.probes.kernel_events import KernelEvents
from rtrun.probes.loops import EVENTS, EXPIRY, SLEEP, START, SWITCH, THREADS_MAX, WAKING, LoopWatch, is_observed

_INTERRUPT = 0x18  # bits of common_flags: within an interrupt or a softirq
_ASLEEP, _ENDED = 0x03, 0x30  # bits of prev_state: S and D, X and Z
_STEP_NS = 1000  # two readings of the offset of a clock differ by less
_TIMERS_MAX = 64  #: timers that a thread has armed at one time, while its loop is observed
_WAKERS_MAX = 16  #: different wakers of such a thread


class LoopRecord:
    """Reads loops from the kernel's events.

    `observe` takes the programs that run, before their events are fed. `feed` takes events and gaps, each time later
    than before. `missing` are sentences about what the kernel does not have.
    """

    def __init__(self, state: ObservationState, watch: LoopWatch | None) -> None:
        self._state = state
        self._names = watch.names if watch is not None else ()
        self._functions = dict(watch.functions) if watch is not None else {}
        self.logs: dict[tuple[str, str], LoopLog] = {}
        self.threads: dict[int, LoopThread] = {}
        self.missing: dict[str, None] = {}
        self._armed: dict[int, LoopThread] = {}
        self._offset_ns: int | None = None
        self._is_offset_certain = False
        self._blind_until_ns = 0

    def observe(self, programs: Iterable[ObservedProgram]) -> None:
        """Take all programs that run now: others have ended."""
        living: dict[int, tuple[ObservedProgram, ProgramThread]] = {}
        for program in sorted(programs, key=lambda program: (program.start_ticks, program.pid)):
            for thread in sorted(program.threads, key=lambda thread: thread.tid):
                if is_observed(program, thread, self._names):
                    living[thread.tid] = program, thread
                elif (known := self.threads.get(thread.tid)) is not None and known.program.pid == program.pid:
                    # It was observed until its program had a real-time thread, or as one of those.
                    known.log.is_dropped = True
        for tid, loop_thread in list(self.threads.items()):
            now = living[tid][0] if tid in living else None
            if now is None or (now.pid, now.start_ticks) != (loop_thread.program.pid, loop_thread.program.start_ticks):
                self._end(loop_thread)
        for tid, (program, thread) in living.items():
            if tid not in self.threads:
                if len(self.threads) >= THREADS_MAX:
                    continue
                self._begin(tid, program, thread)
                if tid not in self.threads:
                    continue
            self.threads[tid].log.is_real_time |= thread.is_real_time

    def _begin(self, tid: int, program: ObservedProgram, thread: ProgramThread) -> None:
        file_name, name = program.file_name[:NAME_CHARACTERS_MAX], thread.name
        loop_thread = LoopThread(tid, program)
        number = self._state.numbering.number(("loop", file_name, name), loop_thread, program.argv)
        key = file_name, numbered(name, number)
        # The name of an ordinary thread that is no stream any more may be that of a real-time one.
        if key not in self.logs or not self.logs[key].is_shown:
            if not self._state.add_stream():
                return
            self.logs[key] = LoopLog(*key, self._state)
        loop_thread.log = self.logs[key]
        loop_thread.log.latest = loop_thread
        loop_thread.log.is_asked = any(
            asked in (file_name, f"{file_name}/{loop_thread.log.thread}") for asked in self._names
        )
        self._state.add_pid(file_name, program.pid)
        self.threads[tid] = loop_thread

    def _end(self, thread: LoopThread) -> None:
        thread.is_alive = thread.is_on = False
        del self.threads[thread.tid]
        for handle in thread.timers:
            self._armed.pop(handle, None)

    def feed(self, events: KernelEvents, gaps: Sequence[Gap], offset_ns: int | None) -> None:
        """Read events, in the order of time, and gaps between them.

        `offset_ns` is how far CLOCK_REALTIME is ahead of the events' clock at the end of these events, if known. Raises
        NoRoom if more was measured than may be kept.
        """
        before, self._offset_ns = self._offset_ns, offset_ns
        # Whether it holds for all of these events: it was the same before them.
        is_same = before is not None and offset_ns is not None and abs(offset_ns - before) < _STEP_NS
        self._is_offset_certain = is_same or before is None
        if before is not None and offset_ns is not None and not is_same:
            self._forget_realtime()
        if not self.threads:
            return
        waiting = sorted(gaps)
        for at_ns, cpu, tid, place, *numbers in self._numbers(events):
            while waiting and waiting[0].from_ns <= at_ns:
                self._cut(waiting.pop(0))
            if at_ns < self._blind_until_ns:
                continue
            match numbers:
                case [0, handle, soft_ns, function]:
                    self._start(at_ns, tid, handle, soft_ns, function)
                case [1, handle, _, _]:
                    self._expire(at_ns, cpu, handle)
                case [2, woken, flags, _]:
                    self._wake(at_ns, cpu, tid, woken, flags)
                case [_, prev, next_tid, state]:
                    self._leave(at_ns, prev, state)
                    self._enter(at_ns, next_tid, prev, events, place)
        for gap in waiting:
            self._cut(gap)
        self._state.store.ease()

    def finish(self) -> None:
        """There are no more events: an activation has ended if its thread sleeps."""
        for thread in self.threads.values():
            # A sleep within a cycle is not the end: only its next timer shows that it asked for the next time.
            if thread.open_ns is not None and thread.asleep_ns is not None and thread.timers:
                self._close(thread, thread.asleep_ns)

    def _numbers(self, events: KernelEvents) -> Iterator[tuple[int, ...]]:
        """Of each event that concerns a thread: time, CPU, thread, place, kind (as in _FIELDS), and its numbers."""
        kinds = {name: number for number, (name, _) in enumerate(events.kinds)}
        for name in EVENTS:
            if name not in kinds:
                self.missing[f"the kernel has no event {name}: no loop is measured"] = None
        if self.missing or not len(events):
            return
        size = len(events)
        numbers = np.zeros((size, 4), np.int64)
        is_of = np.zeros(size, np.bool_)
        followed = np.fromiter(self.threads, np.int64, len(self.threads))
        functions = np.array([*self._functions], np.uint64).view(np.int64)
        tids = events.rows["tid"].astype(np.int64)
        try:
            for code, (name, fields) in enumerate(_FIELDS.items()):
                some = np.flatnonzero(events.rows["kind"] == kinds[name])
                columns = [events.numbers(some, field) for field in fields]
                if name == START:
                    kept = np.isin(tids[some], followed) & np.isin(columns[2], functions)
                elif name == EXPIRY:
                    kept = np.ones(some.size, np.bool_)
                elif name == WAKING:
                    kept = np.isin(columns[0], followed)
                else:
                    kept = np.isin(columns[0], followed) | np.isin(columns[1], followed)
                numbers[some, 0] = code
                for number, column in enumerate(columns):
                    numbers[some, number + 1] = column
                is_of[some] = kept
        except ValueError as error:
            self.missing[f"{error}: no loop is measured"] = None
            return
        places = np.flatnonzero(is_of)
        parts = (events.at_ns[places], events.rows["cpu"][places], tids[places], places, *numbers[places].T)
        yield from zip(*(part.tolist() for part in parts), strict=True)

    def _start(self, at_ns: int, tid: int, handle: int, soft_ns: int, function: int) -> None:
        """A thread arms a timer that may expire from `soft_ns` on."""
        thread = self.threads[tid]
        self._runs(at_ns, thread)
        is_sleep = self._functions.get(function & (1 << 64) - 1) == SLEEP
        if not is_sleep and (timer := thread.timers.get(handle)) is not None and timer.expired_ns is not None:
            # It had expired while its thread ran, and only now the thread reacts.
            self._activate(thread, timer, UNKNOWN_NS, at_ns, at_ns, 0, "")
        for old in [
            armed for armed in thread.timers.values() if armed.handle == handle or (is_sleep and armed.is_sleep)
        ]:
            self._disarm(thread, old)
        offset_ns = self._offset_ns
        is_realtime = offset_ns is not None and abs(soft_ns - offset_ns - at_ns) < abs(soft_ns - at_ns)
        if is_realtime and not self._is_offset_certain:
            return
        due_ns = soft_ns - offset_ns if is_realtime and offset_ns is not None else soft_ns
        if not 0 <= due_ns <= TIME_MAX_NS or len(thread.timers) >= _TIMERS_MAX:
            return
        thread.timers[handle] = LoopTimer(handle, due_ns, at_ns, is_sleep, is_realtime)
        self._armed[handle] = thread

    def _disarm(self, thread: LoopThread, timer: LoopTimer) -> None:
        thread.timers.pop(timer.handle, None)
        self._armed.pop(timer.handle, None)

    def _forget_realtime(self) -> None:
        for thread in self.threads.values():
            for timer in [timer for timer in thread.timers.values() if timer.is_realtime]:
                self._disarm(thread, timer)

    def _expire(self, at_ns: int, cpu: int, handle: int) -> None:
        thread = self._armed.get(handle)
        if thread is not None and (timer := thread.timers.get(handle)) is not None:
            timer.expired_ns, timer.expired_cpu = at_ns, cpu

    def _wake(self, at_ns: int, cpu: int, by_tid: int, tid: int, flags: int) -> None:
        thread = self.threads[tid]
        timer = None
        if flags & _INTERRUPT:
            expired = [
                armed for armed in thread.timers.values() if armed.expired_ns is not None and armed.expired_cpu == cpu
            ]
            timer = min(expired, key=lambda armed: armed.due_ns, default=None)
        if thread.is_on or by_tid == tid:
            # The interrupt came before it slept: it continues to run.
            if timer is not None:
                self._activate(thread, timer, at_ns, at_ns, timer.asked_ns, 0, "")
            return
        if timer is None:
            who = "an interrupt" if flags & _INTERRUPT else self._name(by_tid)
            if who in thread.log.wakers or len(thread.log.wakers) < _WAKERS_MAX:
                thread.log.wakers[who] += 1
            for sleep in [armed for armed in thread.timers.values() if armed.is_sleep]:
                self._disarm(thread, sleep)
        thread.woken = timer, at_ns

    def _name(self, tid: int) -> str:
        thread = self.threads.get(tid)
        return f"{thread.log.program}/{thread.log.thread}" if thread is not None else "another thread"

    def _leave(self, at_ns: int, tid: int, state: int) -> None:
        thread = self.threads.get(tid)
        if thread is None:
            return
        self._runs(at_ns, thread)
        thread.is_on = False
        if thread.on_ns is not None:
            thread.run_ns += at_ns - thread.on_ns
            thread.on_ns = None
        if state & _ASLEEP:
            thread.asleep_ns, thread.woken = at_ns, None
        elif state & _ENDED:
            thread.cut()

    def _runs(self, at_ns: int, thread: LoopThread) -> None:
        """A thread runs, though the kernel may not have recorded the switch to it: it does not record every switch.

        Such activations are late more often than others. So they count, from the time at which the thread is first seen
        to run.
        """
        if not thread.is_on and thread.woken is not None:
            thread.log.unseen += thread.woken[0] is not None
            self._enters(at_ns, thread, 0, "")

    def _enter(self, at_ns: int, tid: int, before: int, events: KernelEvents, place: int) -> None:
        thread = self.threads.get(tid)
        if thread is None:
            return
        timer, worst = thread.woken[0] if thread.woken is not None else None, thread.log.worst
        is_worst = timer is not None and (worst is None or at_ns - timer.due_ns > worst.late_ns)
        self._enters(at_ns, thread, before, _previous_name(events, place) if is_worst and before else "")

    def _enters(self, at_ns: int, thread: LoopThread, before: int, name: str) -> None:
        thread.is_on, thread.on_ns = True, at_ns
        thread.log.runs += 1
        timer, waking_ns = thread.woken or (None, UNKNOWN_NS)
        thread.woken = None
        if timer is not None and timer.handle in thread.timers:
            end_ns = thread.asleep_ns if thread.asleep_ns is not None else timer.asked_ns
            self._activate(thread, timer, waking_ns, at_ns, end_ns, before, name)
        thread.asleep_ns = None

    def _activate(
        self, thread: LoopThread, timer: LoopTimer, waking_ns: int, running_ns: int, end_ns: int, before: int, name: str
    ) -> None:
        """The time of a thread has come and it runs; the activation before ended at `end_ns`."""
        log = thread.log
        if thread.open_ns is not None:
            self._close(thread, end_ns)
        if not thread.is_joined:
            log.cuts.add((len(log.rows),))
            thread.is_joined = True
        interrupt_ns = timer.expired_ns if timer.expired_ns is not None else UNKNOWN_NS
        log.rows.add((timer.due_ns, interrupt_ns, waking_ns, running_ns))
        if len(log.asked) < GRID_ROWS:
            log.asked.append(timer.asked_ns)
        log.past_due += timer.asked_ns >= timer.due_ns
        log.realtime += timer.is_realtime
        late_ns = running_ns - timer.due_ns
        if log.worst is None or late_ns > log.worst.late_ns:
            timer_ns = max(interrupt_ns - timer.due_ns, 0) if interrupt_ns >= 0 else 0
            wake_ns = max(waking_ns - interrupt_ns, 0) if min(waking_ns, interrupt_ns) >= 0 else 0
            log.worst = Latest(late_ns, timer_ns, wake_ns, late_ns - timer_ns - wake_ns, before, name)
        thread.open_ns, thread.run_ns = timer.due_ns, 0
        if thread.is_on:
            thread.on_ns = running_ns
        self._disarm(thread, timer)

    def _close(self, thread: LoopThread, end_ns: int) -> None:
        """An activation has ended."""
        assert thread.open_ns is not None
        run_ns = thread.run_ns
        if thread.on_ns is not None and thread.on_ns < end_ns:
            run_ns += end_ns - thread.on_ns
        thread.log.responses.add((thread.open_ns, max(end_ns, thread.open_ns), run_ns))
        thread.open_ns = None

    def _cut(self, gap: Gap) -> None:
        self._blind_until_ns = max(self._blind_until_ns, gap.until_ns)
        self._armed.clear()
        for thread in self.threads.values():
            thread.cut()


_FIELDS: Mapping[str, Sequence[str]] = {
    START: ("hrtimer", "softexpires", "function"),
    EXPIRY: ("hrtimer",),
    WAKING: ("pid", "common_flags"),
    SWITCH: ("prev_pid", "next_pid", "prev_state"),
}


def _previous_name(events: KernelEvents, place: int) -> str:
    """The kernel's name of the thread that left the CPU."""
    (event,) = events.only(slice(place, place + 1))
    return str(event.values.get("prev_comm", ""))
