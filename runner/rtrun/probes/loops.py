"""Which threads' loops are observed, and the kernel's events that show when such a thread was due, ran and slept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rtrun.probes.hits import ObservedProgram, ProgramThread

SLEEP = "hrtimer_wakeup"
"""What the kernel calls when the time of a sleeping thread has come, whichever call it sleeps in."""
FUNCTIONS = (SLEEP, "timerfd_tmrproc", "posix_timer_fn")
"""What it calls for timers that threads wait for: such a timer may expire while its thread runs."""
START, EXPIRY, WAKING, SWITCH = EVENTS = (
    "timer/hrtimer_start", "timer/hrtimer_expire_entry", "sched/sched_waking", "sched/sched_switch",
)  # fmt: skip
"""The events of loops; watch_probes.sh has the same in `loop_events`."""
EVENTS_PER_S = 120_000  #: events a second besides those of probes, while loops are observed; a cycle has five
BUFFER_KB = 8192
"""The kernel's memory for them, for each CPU: about a second at the limit."""
THREADS_MAX = 100  #: threads whose loops are observed at one time
"""Threads whose loops are observed at one time; watch_probes.sh has the same in `followed_max`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LoopWatch:
    """Loops that are observed: those of real-time threads, and of threads that have one of these names.

    A name is PROGRAM or PROGRAM/THREAD. `functions` has the kernel's functions of FUNCTIONS by address.
    """

    names: Sequence[str]
    functions: Mapping[int, str]

    @property
    def lines(self) -> tuple[str, ...]:
        """As watch_probes.sh takes it."""
        named = (f"name {name.replace(' ', chr(1))}" for name in self.names if name.isprintable())
        return (*named, f"loops {EVENTS_PER_S} {' '.join(f'{address:x}' for address in self.functions)}")


def thread_name(name: str) -> str:
    """The kernel's name of a thread, without the number that distinguishes it from similar ones."""
    before, _, number = name.rpartition("#")
    return before if number.isdecimal() else name


def is_asked_for(program: ObservedProgram, names: Sequence[str]) -> bool:
    """Whether a program has a thread whose loop is observed."""
    return any(is_observed(program, thread, names) for thread in program.threads)


def is_observed(program: ObservedProgram, thread: ProgramThread, names: Sequence[str]) -> bool:
    """Whether the loop of a thread is observed: it is real-time or named.

    The name of a program means its real-time threads. If it has none, it means all of its threads.
    """
    if thread.is_real_time or not names:
        return thread.is_real_time
    if f"{program.file_name}/{thread.name}" in map(thread_name, names):
        return True
    return program.file_name in names and not any(other.is_real_time for other in program.threads)
