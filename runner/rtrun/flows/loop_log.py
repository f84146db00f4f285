"""What is known about a thread and its loop: its activations, the grid of its due times, and remarks for readers."""

from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rtfiles.output import counted
from rtfiles.quantities import time
from rtrun.flows.observation_state import ObservationState
from rtrun.kinds.values import Int64s
from rtrun.probes.hits import ObservedProgram

GRID_ROWS = 1000  # activations that show the period
_GRID_ROWS_LEAST = 8
UNKNOWN_NS = -1
"""The timer's interrupt, or the waking, was not seen to come before the thread ran."""


class Latest(NamedTuple):
    """The activation that ran latest after it was due, and who had the CPU before it; 0: nobody."""

    late_ns: int
    timer_ns: int
    wake_ns: int
    wait_ns: int
    before_tid: int
    before_name: str


class LoopLog:
    """The activations of a thread, over all restarts of its program.

    `rows`: due, interrupt, waking, running. `responses`: due, end, CPU time. `past_due` counts activations whose time
    had passed when the thread asked for it, `unseen` those whose begin was not recorded.
    """

    __slots__ = (
        "asked", "cuts", "is_asked", "is_dropped", "is_real_time", "latest", "past_due", "program", "realtime",
        "responses", "rows", "runs", "thread", "unseen", "wakers", "worst",
    )  # fmt: skip

    def __init__(self, program: str, thread: str, state: ObservationState) -> None:
        self.program, self.thread = program, thread
        self.rows, self.responses, self.cuts = state.store.rows(4), state.store.rows(3), state.store.rows()
        self.asked: array[int] = array("q")
        """When the first activations were asked for."""
        self.past_due = self.realtime = self.runs = self.unseen = 0
        self.wakers: Counter[str] = Counter()
        """What wakes it besides its timers."""
        self.is_real_time = self.is_dropped = False
        self.is_asked = False
        """It has a deadline."""
        self.latest: LoopThread | None = None
        self.worst: Latest | None = None

    @property
    def is_shown(self) -> bool:
        """Whether it is a stream. Once a program has real-time threads, its ordinary threads are not."""
        return self.is_real_time or not self.is_dropped

    @property
    def clock(self) -> str:
        """``system`` if it sleeps on CLOCK_REALTIME, which may be set; otherwise empty."""
        return "system" if 2 * self.realtime > len(self.rows) else ""

    def period_ns(self) -> int | None:
        """The period, if its due times lie on a grid; None if each sleep begins anew, or too few were seen.

        On a grid the time between two due times varies less than the time from asking to being due.
        """
        rows = min(len(self.asked), GRID_ROWS)
        if rows < _GRID_ROWS_LEAST:
            return None
        due = self.rows.read(0, rows)[:, 0]
        steps, asked = np.diff(due), due - np.frombuffer(self.asked[:rows], np.int64)
        period_ns = int(np.median(steps))
        if period_ns <= 0:
            return None
        off = np.abs(steps - np.maximum(np.rint(steps / period_ns), 1) * period_ns)
        varies = np.abs(asked - np.median(asked))
        return period_ns if np.median(off) == 0 or np.median(off) < np.median(varies) else None

    def skipped(self, begin: int, due: Int64s, period_ns: int | None) -> Int64s:
        """The periods without an activation before each of these rows, from row `begin` on; int64 (n,)."""
        skipped = np.zeros(due.size, np.int64)
        if period_ns is None or not due.size:
            return skipped
        before = self.rows[begin - 1] if begin else int(due[0])
        passed = np.diff(due, prepend=before)
        cuts = self.cuts.between(begin, begin + due.size) - begin
        skipped[:] = np.maximum((passed + period_ns // 2) // period_ns - 1, 0)
        skipped[cuts] = 0
        return skipped

    def rhythm(self) -> str:
        """What wakes it, and how often."""
        if not len(self.rows):
            return f"no loop: {self._why_none()}"
        period_ns = self.period_ns()
        if period_ns is not None:
            return f"sleeps until times {time(period_ns)} apart"
        return "sleeps for a time that it reckons anew each time, so skipped periods are not counted"

    def in_words(self) -> Iterator[str]:
        """What a reader has to know about its values, or why it has none."""
        if not len(self.rows) or self.is_asked:
            yield self.rhythm()
        if self.past_due:
            yield f"{counted(self.past_due, 'activation')} it asked for too late: the time had already passed"
        if self.unseen:
            late = counted(self.unseen, "activation")
            yield f"{late} began at most as late as told: the kernel did not record when the thread began to run"
        if self.clock:
            yield "it sleeps on CLOCK_REALTIME: a step of that clock moves its due times"
        if self.worst is not None and self.is_asked:
            yield f"its latest activation ran {time(self.worst.late_ns)} after it was due: {_parts(self.worst)}"

    def _why_none(self) -> str:
        if not self.runs:
            return (
                "the thread did not run" if self.latest is None or not self.latest.is_on else "it runs without a pause"
            )
        if not self.wakers:
            return "the thread never slept: it waits busily, or does not wait at all"
        woken = ", ".join(f"{number} times by {who}" for who, number in self.wakers.most_common(3))
        return f"no timer ends its sleeps: it was woken {woken}"


@dataclass(slots=True)
class LoopTimer:
    """A timer that a thread has armed; `due_ns` is of CLOCK_MONOTONIC."""

    handle: int
    due_ns: int
    asked_ns: int
    is_sleep: bool
    is_realtime: bool
    expired_ns: int | None = None
    expired_cpu: int = -1


class LoopThread:
    """A living thread whose loop is observed."""

    __slots__ = (
        "asleep_ns", "is_alive", "is_joined", "is_on", "log", "on_ns", "open_ns", "program", "run_ns", "tid", "timers",
        "woken",
    )  # fmt: skip
    log: LoopLog

    def __init__(self, tid: int, program: ObservedProgram) -> None:
        self.tid, self.program = tid, program
        self.is_alive = True
        self.cut()

    def cut(self) -> None:
        """Events are missing: what it does now is unknown."""
        self.is_joined = False
        """Its next activation follows the one before without a gap."""
        self.timers: dict[int, LoopTimer] = {}
        self.asleep_ns: int | None = None
        """Since when it sleeps; None: it does not, or that is not known."""
        self.is_on = False
        self.on_ns: int | None = None
        self.woken: tuple[LoopTimer | None, int] | None = None
        self.open_ns: int | None = None
        """When the activation was due that has not ended."""
        self.run_ns = 0


def _parts(worst: Latest) -> str:
    who = f" that {worst.before_name} had" if worst.before_tid else ""
    return (
        f"{time(worst.timer_ns)} until its timer's interrupt, {time(worst.wake_ns)} until it was woken, "
        f"{time(worst.wait_ns)} until it had a CPU{who}"
    )
