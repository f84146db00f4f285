"""Timers: when each callback began, when it was due, and thus how late it was.

A timer is called before its callback begins. In rclpy, rcl and roscpp the callback follows at once on the same thread,
so the call is its begin. In rclcpp another thread may take it from a queue, and a probe shows the begin.
"""

from array import array
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rtfiles.output import counted
from rtrun.flows.programs import Handle, HandleTable, LivingProcess, LivingThing
from rtrun.flows.rows import RowStore
from rtrun.flows.values import int64s, steps
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.values import Int64s, no_values
from rtrun.probes.hits import HITS_CLOCK
from rtrun.results.columns import PIECE_ROWS, collected

LEAST_CALLS = 3
"""A timer with fewer calls has no interval to go by: rclpy makes a timer for each spin_once with a time limit."""
_PERIOD_OFF_MAX = 0.1  # a share of the period
_QUEUED_MAX = 64  #: calls of an observed timer whose callbacks have not begun
_SAME_CLOCK = {"ros": "system"}  # unless the time is simulated
LATE_MAX_NS = 3600 * 10**9  # simulated time is further from the clock
_NTP_DRIFT = 5e-4  # clocks that NTP disciplines drift by 500 ppm at most
_STEP_LEAST_NS = 20_000  # difference of two readings of a pair of clocks on a busy machine
_ROUNDING_NS = 1000


def timer_name(period_ns: int | None) -> str:
    """The name of a timer, with its period if that is known."""
    return "timer" if period_ns is None else f"timer {period_ns / 1e6:g} ms"


class TimerLog:
    """The calls of a timer, over all restarts of its program.

    `rows`: when each callback began, and when it was due. `calls` counts all calls. `unpaired` counts callbacks that
    belong to an unknown call. `is_mixed`: some callbacks cannot be told from those of other timers or topics.
    """

    __slots__ = ("calls", "clock", "cuts", "is_mixed", "label", "latest", "number", "period_ns", "rows", "unpaired")

    def __init__(self, label: str, period_ns: int | None, clock: str | None, number: int, store: RowStore) -> None:
        self.label = label
        self.period_ns = period_ns
        self.clock = clock
        self.number = number
        self.rows = store.rows(2)
        self.cuts = store.rows()
        self.latest: tuple[int, LivingTimer] | None = None
        self.is_mixed = False
        self.calls = self.unpaired = 0

    @property
    def name(self) -> str:
        """Its name among the timers of its node."""
        return timer_name(self.period_ns)

    def add(self, at_ns: int, expected_ns: int, timer: "LivingTimer", epoch: int) -> None:
        """Count a callback that began."""
        latest = self.latest
        if latest is None or latest[1] is not timer or latest[0] != epoch:
            self.cuts.add((len(self.rows),))
            self.latest = (epoch, timer)
        self.rows.add((at_ns, expected_ns))


class TimerCall(NamedTuple):
    """A call of a timer, and when it was due; NOT_SEEN_NS: not known."""

    timer: "LivingTimer"
    at_ns: int
    expected_ns: int


class LivingTimer(LivingThing):
    """A timer of a living process; it gets a log after `LEAST_CALLS` calls.

    `due_ns` is when the latest call was due, if that is known. `waiting` are the calls whose callbacks have not begun,
    oldest first. It is kept in `whole_epoch`, in which all calls since the timer was made were seen.
    """

    __slots__ = (
        "calls", "clock", "due_ns", "early", "handle", "log", "node", "period_ns", "unpaired", "waiting", "whole_epoch",
    )  # fmt: skip

    def __init__(self, process: LivingProcess, handle: Handle, period_ns: int | None, clock: str | None) -> None:
        super().__init__(process)
        self.handle = handle
        self.period_ns = period_ns
        self.clock = clock
        self.node: Handle | None = None
        self.calls = self.unpaired = 0
        """As in its log to be."""
        self.early: list[tuple[int, int, int]] = []
        """The rows of its log to be, each with its epoch."""
        self.log: TimerLog | None = None
        self.due_ns: int | None = None
        self.waiting: deque[TimerCall] = deque()
        self.whole_epoch: int | None = None

    def waits(self, call: TimerCall) -> None:
        """The callback of a call has not begun yet."""
        if self.whole_epoch is not None:
            self.waiting.append(call)
        if len(self.waiting) > _QUEUED_MAX:
            self.waiting.clear()
            self.whole_epoch = None

    def next_waiting(self, epoch: int) -> TimerCall | None:
        """Take the oldest waiting call; None if an older one, which was not seen, may wait."""
        is_whole = self.whole_epoch == epoch
        return self.waiting.popleft() if is_whole and self.waiting else None

    def checked_due(self, expected_ns: object) -> int:
        """When a queued call was due, if that is whole periods before the latest known one; otherwise NOT_SEEN_NS."""
        if not isinstance(expected_ns, int) or self.due_ns is None or not self.period_ns:
            return NOT_SEEN_NS
        before_ns = self.due_ns - expected_ns
        return expected_ns if before_ns >= 0 and before_ns % self.period_ns == 0 else NOT_SEEN_NS


TIMERS = HandleTable[LivingTimer]()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lateness:
    """A timer's callbacks of known lateness: when each began and, by the timer's own clock, when it was due and began.

    All int64 of shape (n,); `cuts` are as in a stream. `skipped` counts whole periods without a call, seen from the
    grid of the timer. `why_not` are sentences on why some or all calls are missing.
    """

    at_ns: Int64s
    expected_ns: Int64s
    real_ns: Int64s
    cuts: Int64s
    skipped: int = 0
    why_not: tuple[str, ...] = ()


class ClockOffsets:
    """The offsets of other clocks from the hits' clock, from occasional readings."""

    def __init__(self) -> None:
        self._at: dict[str, array[int]] = {}
        self._offset: dict[str, array[int]] = {}

    def add(self, clock: str, at_ns: int, offset_ns: int) -> None:
        """`clock` was ahead of the hits' clock by `offset_ns` when that showed `at_ns`; times are added in order."""
        self._at.setdefault(clock, array("q")).append(at_ns)
        self._offset.setdefault(clock, array("q")).append(offset_ns)

    def read(self, clock: str, at_ns: Int64s) -> tuple[Int64s, "np.ndarray[tuple[int], np.dtype[np.bool_]]", int]:
        """The offset at each of these times, whether it is known there, and the largest step of the clock.

        The offset is known between two readings if the clock did not step between them. Shapes: int64 (n,), bool (n,);
        in nanoseconds.
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
        """When a clock was last read; None if it never was."""
        read = self._at.get(_SAME_CLOCK.get(clock, clock))
        return read[-1] if read else None


def called_period_ns(log: TimerLog) -> int | None:
    """The period that the timer was given, if its callbacks begin at about that distance."""
    medians = [float(np.median(some)) for some in steps(log.rows, log.cuts) if some.size]
    # The median of a long stream is that of its pieces' medians.
    if not log.period_ns or not medians or abs(float(np.median(medians)) / log.period_ns - 1) > _PERIOD_OFF_MAX:
        return None
    return log.period_ns


def known_period_ns(log: TimerLog) -> int | None:
    """The period that the timer was given, if its callbacks begin at about that distance, or are due by whole periods.

    The callbacks of a timer that always overruns are further apart than its period; their due times show the period.
    """
    if not log.period_ns or log.period_ns <= 0:
        return None
    on_grid = [is_on_grid(log, begin, begin + PIECE_ROWS) for begin in range(0, len(log.rows), PIECE_ROWS)]
    decided = [answer for answer in on_grid if answer is not None]
    return log.period_ns if decided and all(decided) else called_period_ns(log)


def is_on_grid(log: TimerLog, begin: int, end: int) -> bool | None:
    """Whether most of these rows were due whole periods after the one before; None if that is not known for any."""
    _, due, follows = _read(log, begin, end)
    is_due_known = due != NOT_SEEN_NS
    passed = np.diff(due)[follows[1:] & is_due_known[1:] & is_due_known[:-1]]
    if not passed.size or not log.period_ns:
        return None
    periods = np.rint(passed / log.period_ns)
    return float(np.mean((periods >= 1) & (np.abs(passed - periods * log.period_ns) <= _ROUNDING_NS))) > 1 / 2


class CertainCalls(NamedTuple):
    """Some rows of a timer whose lateness is certain.

    When each began; when it was due and began on the timer's clock, int64 (n,); whether it must not be joined with the
    one before, bool (n,). `skipped` counts the whole periods before them without a call, `unknown` the rows at which
    the clock is not known; `step_ns` is the largest step by which the clock was set.
    """

    at_ns: Int64s
    due_ns: Int64s
    real_ns: Int64s
    is_cut: "np.ndarray[tuple[int], np.dtype[np.bool_]]"
    skipped: int
    unknown: int
    step_ns: int


def certain_calls(log: TimerLog, clock: str, begin: int, end: int, offsets: ClockOffsets) -> CertainCalls:
    """The rows from `begin` to before `end` whose lateness is certain, for the live view and the verdict."""
    at, due, follows = _read(log, begin, end)
    offset, known, step_ns = offsets.read(clock, at)
    is_due_known = due != NOT_SEEN_NS
    certain = is_due_known & known
    follows[1:] &= certain[1:] & certain[:-1]
    skipped = 0
    if log.period_ns:
        # To the nearest period, as the samples are read.
        passed = np.diff(due)[follows[1:]]
        skipped = int(np.maximum((passed + log.period_ns // 2) // log.period_ns - 1, 0).sum())
    new = np.flatnonzero(certain)
    new = new[new >= begin - max(begin - 1, 0)]
    unknown = int(np.count_nonzero((is_due_known & ~known)[begin - max(begin - 1, 0) :]))
    return CertainCalls(at[new], due[new], (at + offset)[new], ~follows[new], skipped, unknown, step_ns)


def _read(log: TimerLog, begin: int, end: int) -> tuple[Int64s, Int64s, "np.ndarray[tuple[int], np.dtype[np.bool_]]"]:
    """Rows, with the one before them, if there is one; and whether each of them follows the one before."""
    start = max(begin - 1, 0)
    at, due = log.rows.read(start, end).T
    follows = ~np.isin(np.arange(start, start + at.size), log.cuts.between(start, start + at.size))
    follows[:1] = False
    return at, due, follows


def lateness(log: TimerLog, offsets: ClockOffsets, store: RowStore) -> Lateness:
    """The callbacks whose lateness is certain. Raises NoRoom."""
    if log.is_mixed or (log.calls and not log.rows):
        return _none("no probe sees where its callback begins: rclcpp may queue it for another thread")
    period_ns = known_period_ns(log)
    if period_ns is None:
        return _none("period not known: none was told, or its calls neither lie within 10 % of it nor are due by it")
    if not any(np.any(piece[:, 1] != NOT_SEEN_NS) for piece in log.rows.pieces()):
        if log.unpaired:
            return _none("not known which of its calls its callbacks belong to")
        return _none("no probe tells when its calls were due")
    if log.clock is None:
        return _none("the clock of its grid is not known")
    certain = _AllCertain(log, log.clock, offsets)
    at_ns, expected_ns, real_ns, cuts = collected(store.folder, certain.pieces(), 4)
    why_not = []
    if log.unpaired:
        callbacks = counted(log.unpaired, "callback")
        why_not.append(f"no lateness of {callbacks}: not known which call of the timer they belong to")
    if certain.step_ns:
        step = f"{certain.step_ns / 1e6:.3g} ms"
        why_not.append(f"its clock ({log.clock}) was set by up to {step}: no lateness around that")
    if certain.unknown:
        calls = counted(certain.unknown, "call")
        why_not.append(f"no lateness of {calls}: not known how its clock ({log.clock}) stood then")
    if certain.medians and not 0 <= np.median(certain.medians) <= LATE_MAX_NS:
        return _none(f"its grid is not one of the clock ({log.clock}); is the time simulated?")
    return Lateness(
        at_ns=at_ns,
        expected_ns=expected_ns,
        real_ns=real_ns,
        cuts=cuts,
        skipped=certain.skipped,
        why_not=tuple(why_not),
    )


def _none(reason: str) -> Lateness:
    none = no_values()
    return Lateness(at_ns=none, expected_ns=none, real_ns=none, cuts=none, why_not=(f"no lateness: {reason}",))


class _AllCertain:
    """Reads the calls of a timer whose lateness is certain, some at a time, and sums up what holds for all of them."""

    def __init__(self, log: TimerLog, clock: str, offsets: ClockOffsets) -> None:
        self._log, self._clock, self._offsets = log, clock, offsets
        self.step_ns = self.unknown = self.skipped = 0
        self.medians: list[float] = []
        """The median lateness of each piece."""

    def pieces(self) -> Iterator[tuple[Int64s, Int64s, Int64s, Int64s]]:
        """When each began; when it was due and began on the timer's clock; and which of these rows are cuts."""
        before = 0
        for begin in range(0, len(self._log.rows), PIECE_ROWS):
            piece = certain_calls(self._log, self._clock, begin, begin + PIECE_ROWS, self._offsets)
            self.step_ns = max(self.step_ns, piece.step_ns)
            self.unknown += piece.unknown
            self.skipped += piece.skipped
            if not piece.at_ns.size:
                continue
            self.medians.append(float(np.median(piece.real_ns - piece.due_ns)))
            cuts = np.flatnonzero(piece.is_cut) + before
            yield piece.at_ns, piece.due_ns, piece.real_ns, cuts[cuts > 0]
            before += piece.at_ns.size
