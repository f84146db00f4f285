"""The events of the kernel's trace from which causes are read.

Named tuples, because a trace has hundreds of thousands of events and a dataclass takes five times as long to make.
Times are nanoseconds on the clock of the trace. Priorities are the kernel's (`prio`): below 0 deadline, 0 to 98 real
time with priority 99 - prio, from 100 on normal, 120 being nice 0.
"""

from enum import StrEnum
from typing import NamedTuple


class Context(StrEnum):
    """What a CPU was executing when it recorded an event."""

    THREAD = "thread"
    SOFT = "softirq"
    HARD = "interrupt"


class Current(NamedTuple):
    """The thread of a CPU's first line in the trace, or of its first line after a switch to the idle thread."""

    at_ns: int
    cpu: int
    pid: int
    name: str


class Switch(NamedTuple):
    """sched_switch: `state` is that of the thread that leaves the CPU, still runnable if it begins with R."""

    at_ns: int
    cpu: int
    pid: int
    name: str
    prio: int
    state: str
    next_pid: int
    next_name: str
    next_prio: int


class Wake(NamedTuple):
    """sched_waking; or, with `is_done`, sched_wakeup or sched_wakeup_new, which alone name the chosen CPU."""

    at_ns: int
    cpu: int
    by_pid: int
    context: Context
    pid: int
    target_cpu: int
    is_done: bool


class Migration(NamedTuple):
    """sched_migrate_task."""

    at_ns: int
    cpu: int
    pid: int
    to_cpu: int


class Interrupt(NamedTuple):
    """The begin or the end of an interrupt handler or a softirq; an end may have no name."""

    at_ns: int
    cpu: int
    context: Context
    name: str
    begins: bool


class Raise(NamedTuple):
    """softirq_raise: the softirq is asked for, and begins later."""

    at_ns: int
    cpu: int
    pid: int
    context: Context
    name: str


class TimerStart(NamedTuple):
    """hrtimer_start: the timer may expire from `soft_ns` on and must at `hard_ns`, in nanoseconds of its own clock.

    `wakes` is the thread that sleeps until then; None for a timer that does something else.
    """

    at_ns: int
    cpu: int
    timer: str
    soft_ns: int
    hard_ns: int
    wakes: int | None


class TimerExpiry(NamedTuple):
    """hrtimer_expire_entry: `now_ns` is the timer's own clock when its interrupt began, `function` what it calls."""

    at_ns: int
    cpu: int
    timer: str
    now_ns: int
    function: str


class Futex(NamedTuple):
    """A thread enters the system call futex, or leaves it (`operation` None)."""

    at_ns: int
    cpu: int
    pid: int
    operation: int | None


class Fault(NamedTuple):
    """page_fault_user."""

    at_ns: int
    cpu: int
    pid: int


class Console(NamedTuple):
    """printk: a line for the console, which the thread or another one then writes."""

    at_ns: int
    cpu: int
    pid: int


class Signal(NamedTuple):
    """signal_generate: a thread sends a signal to another one; a signal for a program goes to its first thread."""

    at_ns: int
    cpu: int
    by_pid: int
    number: int
    pid: int


class Thaw(NamedTuple):
    """cgroup_unfreeze: a thread lets the processes of a control group (version 2) run again."""

    at_ns: int
    cpu: int
    by_pid: int


class Frequency(NamedTuple):
    """cpu_frequency: from now on `of_cpu` runs at this frequency; another CPU may have recorded it."""

    at_ns: int
    cpu: int
    of_cpu: int
    khz: int


class Callback(NamedTuple):
    """callback_end: a callback ended after `took_ns`. callback_begin: a callback began, and its end was not seen.

    The second has no `took_ns`. Both come from observed nodes, not from the kernel: flows/turns.py.
    """

    at_ns: int
    cpu: int
    pid: int
    took_ns: int | None
    name: str

    @property
    def begin_ns(self) -> int:
        return self.at_ns - (self.took_ns or 0)


class Lost(NamedTuple):
    """Events of a CPU are missing before this moment; `missing` is None if the kernel does not know how many."""

    at_ns: int
    cpu: int
    missing: int | None


Event = (
    Current
    | Switch
    | Wake
    | Migration
    | Interrupt
    | Raise
    | TimerStart
    | TimerExpiry
    | Futex
    | Fault
    | Console
    | Signal
    | Thaw
    | Frequency
    | Callback
    | Lost
)
