"""Timers: when each was called and when it was due, and what of that is lateness."""

from array import array
from dataclasses import dataclass

import numpy as np

from rtfiles.output import counted
from rtrun.analysis.histogram import Int64s
from rtrun.flows.programs import Handle, LivingProcess, LivingThing
from rtrun.flows.situation import HITS_CLOCK
from rtrun.flows.values import differences, int64s
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.output import no_values

LEAST_CALLS = 3
"""One that was called less often has no interval to go by: rclpy makes a timer for each spin_once with a time limit."""
_PERIOD_OFF_MAX = 0.1
_SAME_CLOCK = {"ros": "system"}  # unless the time is simulated
_LATE_MAX_NS = 3600 * 10**9  # simulated time is further from the clock
_NTP_DRIFT = 5e-4  # clocks that NTP disciplines drift by 500 ppm at most
_STEP_LEAST_NS = 20_000  # what two readings of a pair of clocks differ by on a busy machine
_ROUNDING_NS = 1000


def timer_name(period_ns: int | None) -> str:
    """A timer by its period, where that is known."""
    return "timer" if period_ns is None else f"timer {period_ns / 1e6:g} ms"


class TimerLog:
    """The calls of a timer, over all restarts of its program."""

    __slots__ = ("clock", "cuts", "expected", "label", "latest", "number", "period_ns", "times")

    def __init__(self, label: str, period_ns: int | None, clock: str | None, number: int) -> None:
        self.label = label
        self.period_ns = period_ns
        self.clock = clock
        self.number = number
        self.times: array[int] = array("q")
        self.expected: array[int] = array("q")
        self.cuts: array[int] = array("q")
        self.latest: tuple[int, LivingTimer] | None = None

    @property
    def name(self) -> str:
        """What it is called among the timers of its node."""
        return timer_name(self.period_ns)

    def add(self, at_ns: int, expected_ns: int, timer: "LivingTimer", epoch: int) -> None:
        """Count a call."""
        latest = self.latest
        if latest is None or latest[1] is not timer or latest[0] != epoch:
            self.cuts.append(len(self.times))
            self.latest = (epoch, timer)
        self.times.append(at_ns)
        self.expected.append(expected_ns)


class LivingTimer(LivingThing):
    """A timer of a living process; it has a log once it was called often enough to be one."""

    __slots__ = ("clock", "early", "handle", "log", "node", "period_ns")

    def __init__(self, process: LivingProcess, handle: Handle, period_ns: int | None, clock: str | None) -> None:
        super().__init__(process)
        self.handle = handle
        self.period_ns = period_ns
        self.clock = clock
        self.node: Handle | None = None
        self.early: list[tuple[int, int, int]] = []
        self.log: TimerLog | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lateness:
    """Rows of a timer whose lateness is known: their index, when each was due and when it was called on its own clock.

    All int64 of shape (n,). `why_not` says in sentences why some or all are not there.
    """

    rows: Int64s
    expected_ns: Int64s
    real_ns: Int64s
    why_not: tuple[str, ...] = ()


class ClockOffsets:
    """How far other clocks lie from the one of the hits, as it was read now and then."""

    def __init__(self) -> None:
        self._at: dict[str, array[int]] = {}
        self._offset: dict[str, array[int]] = {}

    def add(self, clock: str, at_ns: int, offset_ns: int) -> None:
        """`clock` was `offset_ns` ahead of the hits' clock at a time on that; later times follow earlier ones."""
        self._at.setdefault(clock, array("q")).append(at_ns)
        self._offset.setdefault(clock, array("q")).append(offset_ns)

    def read(self, clock: str, at_ns: Int64s) -> tuple[Int64s, "np.ndarray[tuple[int], np.dtype[np.bool_]]", int]:
        """The offset at each of these times, whether it is known there, and by how much the clock stepped at most.

        It is known between two readings between which the clock went on steadily; int64, bool (n,), nanoseconds.
        """
        if clock == HITS_CLOCK:
            return np.zeros(at_ns.size, np.int64), np.ones(at_ns.size, np.bool_), 0
        at, offset = (int64s(read.get(_SAME_CLOCK.get(clock, clock), array("q"))) for read in (self._at, self._offset))
        if at.size < 2:
            return np.zeros(at_ns.size, np.int64), np.zeros(at_ns.size, np.bool_), 0
        moved, passed = np.diff(offset), np.diff(at)
        is_step = np.abs(moved) > _STEP_LEAST_NS + _NTP_DRIFT * passed
        between = np.clip(np.searchsorted(at, at_ns, side="right") - 1, 0, at.size - 2)
        part = (at_ns - at[between]) / np.maximum(passed[between], 1)
        known = (at_ns >= at[0]) & (at_ns <= at[-1]) & ~is_step[between]
        most = int(np.abs(moved[is_step]).max(initial=0))
        return offset[between] + np.rint(moved[between] * part).astype(np.int64), known, most

    def last_ns(self, clock: str) -> int | None:
        """When a clock was read last; None for one that never was."""
        read = self._at.get(_SAME_CLOCK.get(clock, clock))
        return read[-1] if read else None


def known_period_ns(log: TimerLog) -> int | None:
    """The period that the timer was given, if its calls come at about that distance."""
    if log.period_ns is None or log.period_ns <= 0:
        return None
    steps = differences(int64s(log.times), int64s(log.cuts))
    if not steps.size or abs(float(np.median(steps)) / log.period_ns - 1) > _PERIOD_OFF_MAX:
        return None
    return log.period_ns


def lateness(log: TimerLog, offsets: ClockOffsets) -> Lateness:
    """The calls whose lateness is certain."""
    at, expected = int64s(log.times), int64s(log.expected)
    told = expected != NOT_SEEN_NS
    if known_period_ns(log) is None:
        return _none("period not known: none was told, or its calls lie more than 10 % from it")
    if not told.any():
        return _none("no probe tells when its calls were due")
    if log.clock is None:
        return _none("the clock of its grid is not known")
    why_not = []
    offset, known, step_ns = offsets.read(log.clock, at)
    if step_ns:
        why_not.append(f"its clock ({log.clock}) was set by up to {step_ns / 1e6:.3g} ms: no lateness around that")
    unknown = int(np.count_nonzero(told & ~known))
    if unknown:
        why_not.append(f"no lateness of {counted(unknown, 'call')}: not known how its clock ({log.clock}) stood then")
    rows = np.flatnonzero(told & known)
    if rows.size and not 0 <= np.median((at + offset - expected)[rows]) <= _LATE_MAX_NS:
        return _none(f"its grid is not one of the clock ({log.clock}); is the time simulated?")
    return Lateness(rows=rows, expected_ns=expected[rows], real_ns=(at + offset)[rows], why_not=tuple(why_not))


def _none(reason: str) -> Lateness:
    return Lateness(rows=no_values(), expected_ns=no_values(), real_ns=no_values(), why_not=(f"no lateness: {reason}",))


def skipped_periods(expected_ns: Int64s, period_ns: int, cuts: Int64s) -> int:
    """Whole periods without a call, by how the grid went on; not across a cut."""
    steps = differences(expected_ns, cuts)
    return int(np.maximum((steps + _ROUNDING_NS) // period_ns - 1, 0).sum())
