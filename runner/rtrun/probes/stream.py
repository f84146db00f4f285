"""What watch_probes.sh prints: lines, formats of events, blocks of programs, and raw pages of the kernel's ring buffer.

The output comes from a target in pieces of any size. A `WatchReader` takes the pieces and yields a batch for each round
of the script: the hits of all CPUs together, in the order of time.
"""

import re
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from rtfiles.untrusted import whole_number
from rtrun.kinds.limits import CPUS_MAX, PID_MAX, WALL_TIME_MAX_NS
from rtrun.probes.formats import EventFormat
from rtrun.probes.hits import RAW, SYSTEM, ClockReading, Gap, GapCause, Hit
from rtrun.probes.kernel_events import EventKind, KernelEvents, WaitingEvents
from rtrun.probes.placement import PlacedProbe
from rtrun.probes.programs import LINE_BYTES_MAX, THREADS_MAX, ObservableProgram, ProgramReader
from rtrun.probes.ring_buffer import PageLayout, read_events, read_head
from rtrun.probes.timers import TimerChecks
from rtrun.probes.values import Values, converter, recorded
from rtrun.targets.errors import TargetError

_END = b"rtrun end "
# The last line. If the printing process was killed, this line comes within whatever was being printed.
_TAKEN_OFF = re.compile(r"rtrun end (?:(done)|left .*)")
# The format of an event has some KiB.
_BLOCK_BYTES_MAX = 256 * 1024  #: a block of lines of an observation
_FORMATS_MAX = 500  #: kinds of events of an observation
# How many hits, and how many bytes of them, may wait for the end of their round: four seconds at the highest rate at
# which the probes do not rest. Further hits are left out, and the time of that is recorded.
_HITS_MAX = 160_000  #: hits of probes that wait for the end of their round; others are a gap
_HITS_BYTES_MAX = 24 * 1024 * 1024  #: these hits, as they come
# The same for the kernel's events in an observation with a trace: four seconds at the highest rate. They take 50 MiB.
_KERNEL_EVENTS_MAX = 500_000  #: kernel events that wait for the end of their round, with a trace
_KERNEL_BYTES_MAX = 32 * 1024 * 1024  #: these events, as they come
_GAPS_MAX = 1000  #: gaps of a round; further ones are joined with the last
_ENDED_MAX = 20_000  #: ended programs of a round
_PIDS_MAX = 2 * THREADS_MAX  #: threads whose process is remembered
# A round begins a second after the one before. At most this many more rounds than seconds may have come: they may have
# waited to be read.
_ROUNDS_AHEAD_MAX = 120  #: rounds beyond one a second
# How long a round, or placing all probes, may take; a busy board takes some seconds. A pause in which this process
# itself did not run counts no more than the time between two beats.
_ROUND_MAX_S = 300.0  #: a round of an observation, or placing all probes
_PAUSE_MAX_S = 10.0  #: a time of a round in which nothing came
# Rounds whose marks for CLOCK_MONOTONIC_RAW wait for their lines, and marks of a round: watch_probes.sh makes 16.
_RAW_ROUNDS_MAX, _RAW_MARKS_MAX = 16, 100
# Marks this close to one another are good enough, and so are those at less than twice the smallest distance so far.
_RAW_WIDTH_NS = 40_000
_PRINT = "print"
_PROGRAMS = "programs"
TOO_MANY = "more events came than can be read"
RESTED = "the probes rested: too many events"
_TIMER_CALL = "timer_call"


@dataclass(frozen=True, kw_only=True, slots=True)
class Batch:
    """The events of a second, complete up to `until_ns`, in the order of time.

    Recording began at `begin_ns`, which is 0 if that is not known yet.

    `kernel` are the kernel's own events: their names have a slash, as sched/sched_switch. Their values are those of
    their format, and `common_flags` and `common_preempt_count`, decoded when asked for. `clocks` has the offsets of
    other clocks, as far as the target shows them. `programs` are new, or their threads have changed; `ended` has the
    pids of those that ended. Times are of CLOCK_MONOTONIC.
    """

    begin_ns: int
    until_ns: int
    hits: tuple[Hit, ...]
    kernel: KernelEvents
    gaps: tuple[Gap, ...]
    programs: tuple[ObservableProgram, ...]
    ended: tuple[int, ...]
    clocks: tuple[ClockReading, ...]

    @property
    def realtime_offset_ns(self) -> int | None:
        """By how much CLOCK_REALTIME is ahead of CLOCK_MONOTONIC at the end; None if the target does not show it."""
        return next((reading.offset_ns for reading in self.clocks if reading.clock == SYSTEM), None)


@dataclass(frozen=True, kw_only=True, slots=True)
class Ready:
    """The probes are placed; `refused` has the target's reason for each probe that it did not take, by name."""

    placed: tuple[str, ...]
    refused: Mapping[str, str]


@dataclass(slots=True)
class _Source:
    """How the events of one kind are read."""

    format: EventFormat
    event: str
    convert: Callable[[Values], None] | None = None
    kind: int | None = None
    """Its number among the kinds of kernel events; None: not a kernel event."""


class _WaitingRoom:
    """How many events may wait for the end of their round, and how many bytes of them."""

    def __init__(self, events_max: int, bytes_max: int) -> None:
        self._events_max, self._bytes_max = events_max, bytes_max
        self._events = self._bytes = 0

    def take(self, waiting: int, size_bytes: int) -> bool:
        """Reserve room for one more event besides the `waiting` ones; False if there is none."""
        if waiting >= self._events_max or self._bytes + size_bytes > self._bytes_max:
            return False
        self._events = waiting + 1
        self._bytes += size_bytes
        return True

    def keep(self, waiting: int) -> None:
        """Free the room of all events but the `waiting` ones, which are of the next round."""
        self._bytes = self._bytes * waiting // max(self._events, 1)
        self._events = waiting


class WatchReader:
    """Reads the output of one call of watch_probes.sh; `probes` are keyed by their names there.

    `loops` are the names of loops that are observed. With `is_traced` the kernel's own events are read.

    Raises TargetError, with the origin, for anything that the script would not print.
    """

    def __init__(
        self,
        probes: Mapping[str, PlacedProbe],
        origin: str,
        pids: Mapping[int, int],
        *,
        is_traced: bool = True,
        loops: Sequence[str] = (),
    ) -> None:
        self.is_done = False
        """Everything was taken off the target."""
        self.is_read_to_end = False
        """All rounds were printed, up to the last event."""
        self.lost = 0
        """Events that the kernel reports as lost; it may not know how many."""
        self.begin_ns = 0
        """When recording began; 0 before that is known."""
        self._placed: dict[str, None] = {}
        self._refused: dict[str, str] = {}
        self._is_ready = False
        self._last_ns = self._until_ns = 0
        self._probes, self._origin = probes, origin
        self._pids = dict(pids)
        self._is_traced = is_traced
        """Whether kernel events were asked for; otherwise they are left out."""
        self._data = bytearray()
        self._layout: PageLayout | None = None
        self._sources: dict[int, _Source] = {}
        self._last_of_cpu: dict[int, int] = {}
        self._timers = TimerChecks()
        self._hits: list[Hit] = []
        self._kinds: list[EventKind] = []
        """The kinds of the kernel's events."""
        self._kernel = WaitingEvents(self._kinds)
        self._gaps: list[Gap] = []
        self._loops = loops
        self.unfollowed = 0
        """Threads whose loops are not observed because there are too many, at most."""
        self._programs = ProgramReader(origin, loops)
        """What was listed since the last batch."""
        self._ended: list[int] = []
        self._realtime_offset_ns: int | None = None
        self._raw_ns: dict[int, tuple[list[int], list[int]]] = {}
        """By round: the times of marks, and those of the marks between two of them by CLOCK_MONOTONIC_RAW."""
        self._raw_width_ns: int | None = None
        """The least time between two marks."""
        self._round: int | None = None
        self._mark_ns: int | None = None
        """When the round that is being read began."""
        self._begin_s = self._fed_s = time.monotonic()
        self._rounds = 0
        self._round_s = 0.0
        self._hits_room = _WaitingRoom(_HITS_MAX, _HITS_BYTES_MAX)
        self._kernel_room = _WaitingRoom(_KERNEL_EVENTS_MAX, _KERNEL_BYTES_MAX)
        self._left_out_ns: tuple[int, int] | None = None
        self._rests_ns: int | None = None
        self._cpu: int | None = None
        """The CPU whose pages are being read."""
        self._block: tuple[str, bytearray] | None = None

    def feed(self, chunk: bytes) -> Iterator[Ready | Batch]:
        """Take a piece of the output, and yield what it completes: `Ready` once, then batches."""
        self._data += chunk
        now_s = time.monotonic()
        self._round_s += min(now_s - self._fed_s, _PAUSE_MAX_S)
        self._fed_s = now_s
        try:
            if self._round_s > _ROUND_MAX_S:
                raise ValueError(f"a round that takes more than {_ROUND_MAX_S:g} s")
            yield from self._take()
        except (ValueError, KeyError) as error:
            raise TargetError(f"{self._origin}: what watch_probes.sh printed cannot be read: {error}") from error

    def rest(self) -> Batch:
        """The last batch, after the end of the output; if that was cut off, without the unfinished round."""
        if self._rests_ns is not None:
            self._end_rest(max(self._rests_ns, self._last_ns) + 1)
        return self._batch(None if self.is_read_to_end else 0)

    def _take(self) -> Iterator[Ready | Batch]:
        place = 0
        data = self._data
        try:
            while True:
                # No page begins with these bytes: its events cannot have that length.
                if data.startswith(_END, place):
                    self._cpu = None
                if self._cpu is not None:
                    taken = self._take_page(place)
                    if not taken:
                        return
                    place += taken
                    continue
                end = data.find(b"\n", place)
                if end < 0:
                    if len(data) - place > LINE_BYTES_MAX:
                        raise ValueError("a line without an end")
                    return
                line, place = bytes(data[place:end]), end + 1
                yield from self._take_line(line)
        finally:
            del data[:place]

    def _take_page(self, place: int) -> int:
        """Read a page and return its size in bytes; 0 if more bytes have to come."""
        assert self._layout is not None and self._cpu is not None
        size_bytes = self._layout.size_bytes
        if len(self._data) - place < size_bytes:
            return 0
        self._read_page(bytes(self._data[place : place + size_bytes]), self._layout, self._cpu)
        return size_bytes

    def _take_line(self, raw: bytes) -> Iterator[Ready | Batch]:
        line = raw.decode("utf-8", "replace")
        if taken_off := _TAKEN_OFF.fullmatch(line):
            self._block, self.is_done = None, taken_off[1] is not None
            return
        if self._block is not None:
            kind, text = self._block
            if line == f"rtrun end {kind.partition(' ')[0]}":
                self._block = None
                self._end_block(kind, text.decode("utf-8", "replace"))
                return
            if kind == _PROGRAMS:
                found = self._programs.take(raw)
                if found is not None:
                    self._pids.update((thread.tid, found.program.pid) for thread in found.program.threads)
                    while len(self._pids) > _PIDS_MAX:
                        del self._pids[next(iter(self._pids))]
                return
            text += raw + b"\n"
            if len(text) > _BLOCK_BYTES_MAX:
                raise ValueError(f"{kind} of more than {_BLOCK_BYTES_MAX} bytes")
            return
        word, _, rest = line.partition(" ")
        if word in ("header_page", "format", _PROGRAMS):
            self._block = (line, bytearray())
        elif word == "pages" and self._layout is not None:
            self._cpu = whole_number(rest, lowest=0, highest=CPUS_MAX - 1)
        elif word == "round":
            if self._round is not None:
                yield self._batch(self._round)
            self._round, self._round_s = whole_number(rest, lowest=1), 0.0
            self._rounds += 1
            if self._rounds > time.monotonic() - self._begin_s + _ROUNDS_AHEAD_MAX:
                raise ValueError("rounds that follow one another faster than once in a second")
        elif word == "realtime":
            # A clock that was never set may be behind the other.
            self._realtime_offset_ns = whole_number(rest, lowest=-WALL_TIME_MAX_NS, highest=WALL_TIME_MAX_NS)
        elif word == "unfollowed":
            self.unfollowed = max(self.unfollowed, whole_number(rest, lowest=1, highest=PID_MAX))
        elif word == "raw":
            of_round, _, at_us = rest.partition(" ")
            raw_ns = whole_number(at_us, lowest=0, highest=WALL_TIME_MAX_NS // 1000) * 1000
            self._raw_marks(whole_number(of_round, lowest=0))[1].append(raw_ns)
        elif word == "ended":
            pid = whole_number(rest, lowest=1, highest=PID_MAX)
            if len(self._ended) < _ENDED_MAX:
                self._ended.append(pid)
        elif word == "placed" and rest in self._probes:
            self._placed[rest] = None
        elif word == "refused" and rest.partition(" ")[0] in self._probes:
            name, _, reason = rest.partition(" ")
            self._refused[name] = reason[:300]
        elif line == "ready" and not self._is_ready:
            self._is_ready = True
            yield Ready(placed=tuple(self._placed), refused=dict(self._refused))
        elif line == "rounds end":
            self.is_read_to_end = True
        elif word != "lost" and line not in ("rtrun end pages", "rtrun observes"):
            raise ValueError(f"unexpected line {line[:80]!r}")

    def _end_block(self, kind: str, text: str) -> None:
        word, _, path = kind.partition(" ")
        if word == "header_page":
            self._layout = PageLayout.read(text)
        elif word == _PROGRAMS:
            self._programs.cut()
        else:
            self._add_format(path, text)

    def _add_format(self, path: str, text: str) -> None:
        if len(self._sources) > _FORMATS_MAX:
            raise ValueError(f"more than {_FORMATS_MAX} formats of events")
        event = EventFormat(text)
        probe = self._probes.get(event.name)
        if probe is not None and re.match(r"rtrun_observe_", path):
            types = {name: fetch.rpartition(":")[2] for name, fetch in recorded(probe.arguments).items()}
            event = EventFormat(text, types)
            convert = converter(probe.arguments, probe.constants)
            self._sources[event.identifier] = _Source(event, probe.event, convert)
            return
        # …/events/sched/sched_switch/format
        names = path.split("/")
        name = "/".join(names[-3:-1])[:128]
        self._sources[event.identifier] = _Source(event, name, kind=len(self._kinds))
        self._kinds.append((name, event))

    def _read_page(self, page: bytes, layout: PageLayout, cpu: int) -> None:
        head = read_head(page, layout)
        if head.has_lost:
            self.lost += head.lost or 0
            before_ns = min(self._last_of_cpu.get(cpu, self.begin_ns), head.begin_ns)
            why = f"the kernel lost events of CPU {cpu}"
            self._add_gap(Gap(before_ns, head.begin_ns, why, GapCause.EVENTS_LOST))
        sources, pids = self._sources, self._pids
        at_ns = head.begin_ns
        for at_ns, start, size in read_events(page, layout, head):
            identifier = page[start] | page[start + 1] << 8
            source = sources.get(identifier)
            if source is None:
                # Another program enabled this event.
                continue
            tid = int.from_bytes(page[start + 4 : start + 8], "little")
            if source.kind is not None:
                self._take_kernel_event(source, source.kind, at_ns, cpu, tid, page[start : start + size])
                continue
            if not self._hits_room.take(len(self._hits), size):
                self._leave_out(at_ns)
                continue
            values = source.format.values(page, start, size)
            if source.convert is not None:
                source.convert(values)
            self._hits.append(Hit(at_ns, cpu, pids.get(tid, 0), tid, source.event, values))
        self._last_of_cpu[cpu] = at_ns
        self._last_ns = max(self._last_ns, at_ns)

    def _add_gap(self, gap: Gap) -> None:
        if len(self._gaps) >= _GAPS_MAX:
            last = self._gaps.pop()
            gap = Gap(min(gap.from_ns, last.from_ns), max(gap.until_ns, last.until_ns), gap.reason, gap.cause)
        self._gaps.append(gap)

    def _leave_out(self, at_ns: int) -> None:
        """Note that there was no room for an event."""
        if self._left_out_ns is None:
            self._left_out_ns = (at_ns, at_ns + 1)
        self._left_out_ns = (min(self._left_out_ns[0], at_ns), max(self._left_out_ns[1], at_ns + 1))

    def _take_kernel_event(self, source: _Source, kind: int, at_ns: int, cpu: int, tid: int, data: bytes) -> None:
        if source.format.name == _PRINT:
            text = str(source.format.values(data, 0, len(data)).get("buf", "")).strip()
            if text.startswith("rtrun "):
                self._take_mark(at_ns, text.removeprefix("rtrun "))
            return
        if not self._is_traced:
            return
        if not self._kernel_room.take(len(self._kernel), len(data)):
            self._leave_out(at_ns)
            return
        self._kernel.add(at_ns, cpu, self._pids.get(tid, 0), tid, kind, data)

    def _take_mark(self, at_ns: int, mark: str) -> None:
        word, _, rest = mark.partition(" ")
        if word == "round":
            if whole_number(rest, lowest=1) == self._round:
                self._mark_ns = at_ns
        elif word == "raw":
            self._raw_marks(whole_number(rest, lowest=0))[0].append(at_ns)
        elif word == "rests":
            self._rests_ns = at_ns
        elif word == "observes":
            if self.begin_ns:
                self._end_rest(at_ns)
            self.begin_ns = self.begin_ns or at_ns

    def _raw_marks(self, of_round: int) -> tuple[list[int], list[int]]:
        if of_round not in self._raw_ns and len(self._raw_ns) >= _RAW_ROUNDS_MAX:
            self._raw_ns.clear()
        marks = self._raw_ns.setdefault(of_round, ([], []))
        for times in marks:
            del times[_RAW_MARKS_MAX:]
        return marks

    def _clocks(self, until_ns: int) -> Iterator[ClockReading]:
        """The offsets of other clocks that were read in this round."""
        if self._realtime_offset_ns is not None:
            yield ClockReading(SYSTEM, until_ns, self._realtime_offset_ns)
        for of_round, (marks, raw) in sorted(self._raw_ns.items(), key=lambda round_marks: round_marks[1][0][:1]):
            if not raw or len(marks) != 2 * len(raw):
                # A line comes before the marks that belong to it; or marks were lost.
                continue
            del self._raw_ns[of_round]
            width_ns, before_ns, at_ns = min(
                (after - before, before, at) for before, after, at in zip(marks[::2], marks[1::2], raw, strict=True)
            )
            self._raw_width_ns = min(width_ns, self._raw_width_ns or width_ns)
            # The writer of the marks may lose its CPU between any two of them.
            if 0 <= width_ns <= max(2 * self._raw_width_ns, _RAW_WIDTH_NS):
                middle_ns = before_ns + width_ns // 2
                yield ClockReading(RAW, middle_ns, at_ns - middle_ns)

    def _end_rest(self, until_ns: int) -> None:
        """Add the gap of a rest: since its mark or, if that was lost, since the end of the batch before."""
        from_ns = self._rests_ns if self._rests_ns is not None else self._until_ns
        self._add_gap(Gap(min(from_ns, until_ns), until_ns, RESTED, GapCause.RESTED))
        self._rests_ns = None

    def _batch(self, number: int | None) -> Batch:
        """What is complete by the end of a round; None: all there is; 0: nothing after the batch before.

        Later events wait, since those of other CPUs are still to come.
        """
        until_ns = self._mark_ns if number != 0 else None
        if number is None:
            until_ns = max(self._last_ns + 1, self._until_ns)
        self._mark_ns = None
        if self._left_out_ns is not None:
            self._add_gap(Gap(*self._left_out_ns, TOO_MANY, GapCause.EVENTS_LOST))
            self._left_out_ns = None
        if until_ns is None:
            # The mark was lost: the next batch has these events.
            until_ns = self._until_ns
        self._until_ns = until_ns
        # While probes are switched on or off one after the other, a message may be seen at one end only.
        rests = [gap for gap in self._gaps if gap.cause is GapCause.RESTED]
        silent = [(0, self.begin_ns), *((gap.from_ns, gap.until_ns) for gap in rests)]
        hits, self._hits = _cut(self._hits, until_ns, silent)
        kernel = self._kernel.cut(until_ns, silent)
        self._hits_room.keep(len(self._hits))
        self._kernel_room.keep(len(self._kernel))
        # A round lists its programs after its pages.
        pids = self._pids
        hits = tuple(hit._replace(pid=pids[hit.tid]) if not hit.pid and hit.tid in pids else hit for hit in hits)
        # All CPUs in the order of time: the thread of a timer moves from one CPU to another.
        for hit in hits:
            if hit.event == _TIMER_CALL and isinstance(hit.values, dict):
                self._timers.check((hit.pid or -hit.tid, hit.values.get("timer")), hit.values)
        # A gap that outlasts the round is included, too: it must come no later than the hits of other CPUs within it.
        gaps = tuple(sorted(gap for gap in self._gaps if gap.from_ns <= until_ns))
        self._gaps = [gap for gap in self._gaps if gap.from_ns > until_ns]
        batch = Batch(
            begin_ns=self.begin_ns,
            until_ns=until_ns,
            hits=hits,
            kernel=kernel,
            gaps=gaps,
            programs=self._programs.found,
            ended=tuple(self._ended),
            clocks=tuple(self._clocks(until_ns)),
        )
        self._programs, self._ended = ProgramReader(self._origin, self._loops), []
        return batch


def _cut(hits: list[Hit], until_ns: int, silent: Sequence[tuple[int, int]]) -> tuple[tuple[Hit, ...], list[Hit]]:
    """The hits up to a time, in the order of time and without those of silent times; and the later hits."""
    hits.sort(key=itemgetter(0))
    for from_ns, before_ns in silent:
        first, last = bisect_left(hits, from_ns, key=itemgetter(0)), bisect_left(hits, before_ns, key=itemgetter(0))
        del hits[first:last]
    count = bisect_right(hits, until_ns, key=itemgetter(0))
    return tuple(hits[:count]), hits[count:]
