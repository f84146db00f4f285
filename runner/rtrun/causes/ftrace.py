"""The reader of the kernel's trace text (tracefs `trace` and `snapshot`, Documentation/trace/ftrace.rst).

Unknown lines are counted and left out: kernels differ, and a person may have enabled more events. The file may have any
size: it is read in pieces, pieces before the wanted time are skipped, and the last `EVENTS_MAX` events are kept.
"""

import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter
from os import SEEK_END
from pathlib import Path
from sys import intern
from typing import BinaryIO

from rtfiles.errors import UsageError
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

EVENTS_MAX = 200_000  #: events of a kernel trace in memory: the buffers of 16 CPUs, of 512 KiB each
TIMERS_MAX = 10_000  #: timers kept that were started before the first event that is read
PIECE_BYTES = 1 << 16
# How many parsed arguments of switches and wake-ups are cached, since a trace repeats them; and how long they may be.
REPEATED_MAX, ARGUMENTS_MAX = 1024, 512
CALLBACK_CHARACTERS_MAX = 200  #: characters of the name of a callback in a trace
# trace-cmd.dat(5): how a file of trace-cmd begins.
_TRACE_CMD = b"\x17\x08\x44tracing"

# "  name-pid (group) [cpu] flags seconds: event: arguments"; system calls are "sys_futex(...)" and "sys_futex -> 0x0".
# A name may have dashes, but most have none: that is tried first.
_LINE = re.compile(
    r" *([^-\n]{1,32}|.{1,32}?)-(\d{1,10}) +(?:\([ \d-]{1,12}\) +)?\[(\d{1,4})\] +(?:([^\s\d]\S{2,9}) +)?"
    r"(\d{1,9})\.(\d{9}|\d{6}): (\w+)(?:: | -> |\()(.*)",
    re.ASCII,
)
_TIME = re.compile(rb" (\d{1,9})\.(\d{9}|\d{6}): ")
_TIMER_START_EVENT = b": hrtimer_start: "
_LOST = re.compile(r"CPU:(\d{1,4}) \[LOST (?:(\d{1,15}) )?EVENTS\]", re.ASCII)
_SWITCH = re.compile(
    r"prev_comm=(.{0,64}?) prev_pid=(\d{1,10}) prev_prio=(-?\d{1,4}) prev_state=(\S{1,8}) ==> "
    r"next_comm=(.{0,64}?) next_pid=(\d{1,10}) next_prio=(-?\d{1,4})\b",
    re.ASCII,
)
_WAKE = re.compile(r"comm=.{0,64}? pid=(\d{1,10}) prio=-?\d{1,4} (?:success=\d )?target_cpu=(\d{1,4})\b", re.ASCII)
_MIGRATION = re.compile(r"comm=.{0,64}? pid=(\d{1,10}) prio=-?\d{1,4} orig_cpu=\d{1,4} dest_cpu=(\d{1,4})\b", re.ASCII)
_HANDLER = re.compile(r"irq=(\d{1,10}) name=(.{1,64})", re.ASCII)
_SOFTIRQ = re.compile(r"vec=\d{1,4} \[action=(\w{1,32})\]", re.ASCII)
_TIMER_START = re.compile(
    r"hrtimer=(\w{1,32}) function=(\S{1,128}) expires=(\d{1,19}) softexpires=(\d{1,19})\b", re.ASCII
)
_TIMER_EXPIRY = re.compile(r"hrtimer=(\w{1,32}) function=(\S{1,128}) now=(\d{1,19})\b", re.ASCII)
_FREQUENCY = re.compile(r"state=(\d{1,10}) cpu_id=(\d{1,4})\b", re.ASCII)
_SIGNAL = re.compile(r"sig=(\d{1,3}) errno=-?\d{1,10} code=-?\d{1,10} comm=.{0,64}? pid=(\d{1,10}) grp=", re.ASCII)
# The function of a timer that wakes its sleeping thread (hrtimer_init_sleeper).
_WAKES_ITS_THREAD = "hrtimer_wakeup"
_CALLBACK = re.compile(rf"(?:took_ns=(\d{{1,18}}) )?name=(.{{1,{CALLBACK_CHARACTERS_MAX}}})", re.ASCII)
_FUTEX = re.compile(r".{0,64}\bop: (?:0x)?([0-9a-f]{1,8})\b", re.ASCII)
# Vectors of x86 whose handlers have a pair of events (arch/x86/include/asm/trace/irq_vectors.h).
_VECTOR_EVENTS = {
    f"{name}_{edge}": (name, edge == "entry")
    for edge in ("entry", "exit")
    for name in (
        "local_timer",
        "reschedule",
        "call_function",
        "call_function_single",
        "irq_work",
        "x86_platform_ipi",
        "thermal_apic",
        "error_apic",
        "spurious_apic",
        "threshold_apic",
        "deferred_error_apic",
    )
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Trace:
    """The events between two moments, in the order of time, and the timers that were started before.

    `not_read` counts lines that do not belong to a trace.
    """

    events: tuple[Event, ...]
    started: tuple[TimerStart, ...]
    not_read: int


class _NotInOrder(Exception):
    """Times go back from one piece of the file to the next."""


def read_trace(path: Path, *, from_ns: int = 0, until_ns: int) -> Trace:
    """Read a trace between two moments of its clock; some earlier events may be included.

    Raises UsageError for a file of trace-cmd, or one that cannot be read.
    """
    refuse_trace_cmd(path)
    try:
        with path.open("rb") as stream:
            try:
                return _read(stream, from_ns, until_ns)
            except _NotInOrder:
                # The kernel merges its CPUs by time, but a file may have been put together by hand.
                return _read(stream, 0, until_ns)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error


def refuse_trace_cmd(path: Path) -> None:
    """Raise UsageError for a file of trace-cmd, or one that cannot be read."""
    try:
        with path.open("rb") as stream:
            begin = stream.read(len(_TRACE_CMD))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    if begin == _TRACE_CMD:
        raise UsageError(f"{path}: a file of trace-cmd; the kernel's text is read here: cat /sys/kernel/tracing/trace")


def read_ends(path: Path) -> tuple[int, int] | None:
    """The first and the last time in a file, in ns; None if no line has a time as the kernel prints it."""
    with path.open("rb") as stream:
        size = stream.seek(0, SEEK_END)
        ends = []
        for place in (0, max(0, size - PIECE_BYTES)):
            stream.seek(place)
            ends.append(stream.read(PIECE_BYTES))
    first_ns, last_ns = _first_ns(ends[0]), _last_ns(ends[1])
    return None if first_ns is None or last_ns is None else (first_ns, last_ns)


def has_lines(path: Path) -> bool:
    """Whether a trace has more than its head: a line that is not a comment."""
    with path.open("rb") as stream:
        return any(line.strip() and not line.startswith(b"#") for line in stream.read(PIECE_BYTES).split(b"\n"))


def _read(stream: BinaryIO, from_ns: int, until_ns: int) -> Trace:
    stream.seek(0)
    events: deque[Event] = deque(maxlen=EVENTS_MAX)
    started: dict[str, TimerStart] = {}
    not_read = 0
    for event in parse(_lines(stream, from_ns, started)):
        if event is None:
            not_read += 1
        elif event.at_ns <= until_ns:
            events.append(event)
    in_order = tuple(sorted(events, key=itemgetter(0)))
    return Trace(events=in_order, started=tuple(started.values()), not_read=not_read)


def _lines(stream: BinaryIO, from_ns: int, started: dict[str, TimerStart]) -> Iterator[str]:
    """Yield the lines of a file without the pieces that end before `from_ns`, but with the timer starts in these.

    A line that is longer than a piece is cut. Raises _NotInOrder.
    """
    rest, before_ns = b"", 0
    while data := stream.read(PIECE_BYTES):
        piece = rest + data
        end = piece.rfind(b"\n") + 1 or len(piece)
        piece, rest = piece[:end], piece[end:]
        first_ns, last_ns = _first_ns(piece), _last_ns(piece)
        if from_ns and first_ns is not None and last_ns is not None:
            if not before_ns <= first_ns <= last_ns:
                raise _NotInOrder
            before_ns = last_ns
            if last_ns < from_ns:
                _keep_started(piece, started)
                continue
        yield from piece.decode("utf-8", errors="replace").split("\n")
    yield rest.decode("utf-8", errors="replace")


def _first_ns(lines: bytes) -> int | None:
    """The time of the first line that has one."""
    match = _TIME.search(lines)
    return _ns(*match.groups()) if match else None


def _last_ns(lines: bytes) -> int | None:
    """The time of the last line that has one."""
    end = len(lines)
    while end > 0:
        begin = lines.rfind(b"\n", 0, end - 1) + 1
        if match := _TIME.search(lines, begin, end):
            return _ns(*match.groups())
        end = begin
    return None


def _keep_started(lines: bytes, started: dict[str, TimerStart]) -> None:
    if _TIMER_START_EVENT not in lines:
        return
    of_timers = (line.decode("utf-8", errors="replace") for line in lines.split(b"\n") if _TIMER_START_EVENT in line)
    for event in parse(of_timers):
        if isinstance(event, TimerStart):
            started[event.timer] = event
            if len(started) > TIMERS_MAX:
                del started[next(iter(started))]


def _ns(seconds: str | bytes, fraction: str | bytes) -> int:
    return int(seconds) * 1_000_000_000 + int(fraction) * (1000 if len(fraction) == 6 else 1)


_IDLE = "0"
"""The thread of an idle CPU."""


def parse(lines: Iterable[str]) -> Iterator[Event | None]:
    """Yield the events of a trace's lines, None for a line that is neither an event nor a comment."""
    running: dict[str, str] = {}
    lost: dict[int, int | None] = {}
    second, second_ns = "", 0
    for line in lines:
        match = _LINE.match(line)
        if match is None:
            if lost_match := _LOST.match(line):
                lost[int(lost_match[1])] = int(lost_match[2]) if lost_match[2] else None
            elif not line.startswith("#") and line.strip():
                yield None
            continue
        name, pid, cpu, flags, seconds, fraction, event, arguments = match.groups()
        read = _READERS.get(event)
        known = running.get(cpu)
        is_news = known is None or (known == _IDLE and pid != _IDLE)
        if read is None and not is_news and not lost:
            continue
        if seconds != second:
            second, second_ns = seconds, _ns(seconds, "000000")
        at_ns = second_ns + int(fraction) * (1000 if len(fraction) == 6 else 1)
        if is_news:
            running.setdefault(cpu, pid)
            yield Current(at_ns, int(cpu), int(pid), name)
        if lost and int(cpu) in lost:
            yield Lost(at_ns, int(cpu), lost.pop(int(cpu)))
        if read is not None:
            parsed = read((at_ns, int(cpu), int(pid), flags, event), arguments)
            if isinstance(parsed, Switch):
                running[cpu] = str(parsed.next_pid)
            yield parsed


_Head = tuple[int, int, int, str | None, str]
"""What precedes the arguments of an event: time, CPU, thread, flags, name of the event."""


@lru_cache(maxsize=256)
def _context(flags: str | None) -> Context:
    """The position of the letter differs between kernels, the letters do not. H is an interrupt within a softirq."""
    letters = set(flags or "")
    if letters & set("hHzZ"):
        return Context.HARD
    return Context.SOFT if "s" in letters else Context.THREAD


@lru_cache(maxsize=REPEATED_MAX)
def _switch_arguments(arguments: str) -> tuple[int, str, int, str, int, str, int] | None:
    if not (match := _SWITCH.match(arguments)):
        return None
    name, pid, prio, state, next_name, next_pid, next_prio = match.groups()
    return int(pid), intern(name), int(prio), intern(state), int(next_pid), intern(next_name), int(next_prio)


def _switch(head: _Head, arguments: str) -> Event | None:
    read = _switch_arguments(arguments[:ARGUMENTS_MAX])
    return read and Switch(head[0], head[1], *read)


@lru_cache(maxsize=REPEATED_MAX)
def _wake_arguments(arguments: str) -> tuple[int, int] | None:
    match = _WAKE.match(arguments)
    return match and (int(match[1]), int(match[2]))


def _wake(head: _Head, arguments: str) -> Event | None:
    if (read := _wake_arguments(arguments[:ARGUMENTS_MAX])) is None:
        return None
    at_ns, cpu, pid, flags, event = head
    return Wake(at_ns, cpu, pid, _context(flags), *read, event != "sched_waking")


def _migration(head: _Head, arguments: str) -> Event | None:
    match = _MIGRATION.match(arguments)
    return match and Migration(head[0], head[1], int(match[1]), int(match[2]))


def _handler(head: _Head, arguments: str) -> Event | None:
    match = _HANDLER.match(arguments)
    return match and Interrupt(head[0], head[1], Context.HARD, intern(f"{match[1]} {match[2]}"), begins=True)


def _handler_exit(head: _Head, _: str) -> Event:
    return Interrupt(head[0], head[1], Context.HARD, "", begins=False)


def _vector(head: _Head, _: str) -> Event:
    name, begins = _VECTOR_EVENTS[head[4]]
    return Interrupt(head[0], head[1], Context.HARD, name, begins)


def _softirq(head: _Head, arguments: str) -> Event | None:
    if not (match := _SOFTIRQ.match(arguments)):
        return None
    name = intern(match[1])
    if head[4] == "softirq_raise":
        return Raise(head[0], head[1], head[2], _context(head[3]), name)
    return Interrupt(head[0], head[1], Context.SOFT, name, begins=head[4] == "softirq_entry")


def _timer_start(head: _Head, arguments: str) -> Event | None:
    match = _TIMER_START.match(arguments)
    if match is None:
        return None
    wakes = head[2] if match[2] == _WAKES_ITS_THREAD else None
    return TimerStart(head[0], head[1], intern(match[1]), int(match[4]), int(match[3]), wakes)


def _timer_expiry(head: _Head, arguments: str) -> Event | None:
    match = _TIMER_EXPIRY.match(arguments)
    return match and TimerExpiry(head[0], head[1], intern(match[1]), int(match[3]), intern(match[2]))


def _futex(head: _Head, arguments: str) -> Event:
    match = _FUTEX.match(arguments)
    return Futex(head[0], head[1], head[2], int(match[1], 16) if match else None)


def _signal(head: _Head, arguments: str) -> Event | None:
    match = _SIGNAL.match(arguments)
    return match and Signal(head[0], head[1], head[2], int(match[1]), int(match[2]))


def _callback(head: _Head, arguments: str) -> Event | None:
    match = _CALLBACK.fullmatch(arguments[:ARGUMENTS_MAX])
    return match and Callback(*head[:3], None if match[1] is None else int(match[1]), intern(match[2]))


def _frequency(head: _Head, arguments: str) -> Event | None:
    match = _FREQUENCY.match(arguments)
    return match and Frequency(head[0], head[1], int(match[2]), int(match[1]))


_READERS: dict[str, Callable[[_Head, str], Event | None]] = {
    "sched_switch": _switch,
    "sched_waking": _wake,
    "sched_wakeup": _wake,
    "sched_wakeup_new": _wake,
    "sched_migrate_task": _migration,
    "irq_handler_entry": _handler,
    "irq_handler_exit": _handler_exit,
    **dict.fromkeys(_VECTOR_EVENTS, _vector),
    "softirq_raise": _softirq,
    "softirq_entry": _softirq,
    "softirq_exit": _softirq,
    "hrtimer_start": _timer_start,
    "hrtimer_expire_entry": _timer_expiry,
    "sys_futex": _futex,
    "sys_futex_time32": _futex,
    "page_fault_user": lambda head, _: Fault(*head[:3]),
    "console": lambda head, _: Console(*head[:3]),
    "signal_generate": _signal,
    "cgroup_unfreeze": lambda head, _: Thaw(*head[:3]),
    "cpu_frequency": _frequency,
    **dict.fromkeys(("callback_begin", "callback_end"), _callback),
}
