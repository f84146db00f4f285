"""What watch_probes.sh prints: lines, formats of events, blocks of programs, and raw pages of the kernel's ring buffer.

It comes from a target in pieces of any size. A `WatchReader` takes them and gives batches, one for each round of the
script: hits in the order of time, of all CPUs together.
"""

import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from rtfiles.untrusted import whole_number
from rtrun.plan.limits import CPUS_MAX, PID_MAX, WALL_TIME_MAX_NS
from rtrun.probes.formats import EventFormat, RawValues
from rtrun.probes.hits import Gap, Hit
from rtrun.probes.placement import PlacedProbe
from rtrun.probes.programs import LINE_BYTES_MAX, FoundProgram, ProgramReader
from rtrun.probes.ring_buffer import PageLayout, read_events, read_head
from rtrun.probes.timers import TimerChecks
from rtrun.probes.values import Values, converter
from rtrun.targets.errors import TargetError

_END_OF_PAGES = b"rtrun end pages\n"
# Formats and programs: 2000 of these take some MiB.
_BLOCK_BYTES_MAX = 16 * 1024 * 1024
_FORMATS_MAX = 2000
# Of one round: far above what the buffers of the script can hold.
_ROUND_BYTES_MAX = 1 << 30
_PRINT = "print"
_PROGRAMS = "programs"
RESTED = "the probes rested: too many events"
_TIMER_CALL = "timer_call"


@dataclass(frozen=True, kw_only=True, slots=True)
class Batch:
    """What a second brought, complete up to `until_ns`, in the order of time.

    Events are recorded since `begin_ns`, which is 0 where that is not known yet.

    `kernel` are the kernel's own events: their names have a slash, as sched/sched_switch. Their values are those of
    their format, and `common_flags` and `common_preempt_count`; they are `RawValues`. `realtime_offset_ns` is how far
    CLOCK_REALTIME is ahead of CLOCK_MONOTONIC, None where the target does not show it. `programs` are those that are
    new or whose threads have changed; `ended` are pids. Times are of CLOCK_MONOTONIC.
    """

    begin_ns: int
    until_ns: int
    hits: tuple[Hit, ...]
    kernel: tuple[Hit, ...]
    gaps: tuple[Gap, ...]
    programs: tuple[FoundProgram, ...]
    ended: tuple[int, ...]
    realtime_offset_ns: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Ready:
    """The probes are placed; `refused` has the target's reason for each that it did not take. By their names."""

    placed: tuple[str, ...]
    refused: Mapping[str, str]


@dataclass(slots=True)
class _Source:
    """How the events of one kind are read."""

    format: EventFormat
    event: str
    convert: Callable[[Values], None] | None = None
    is_kernel: bool = False


class WatchReader:
    """Reads the output of one call of watch_probes.sh, for the probes by the names that they have there.

    Raises TargetError with the origin for whatever is not as the script prints it.
    """

    def __init__(self, probes: Mapping[str, PlacedProbe], origin: str, pids: Mapping[int, int]) -> None:
        self.is_done = False
        """Everything was taken off."""
        self.lost = 0
        """Events that the kernel says it has lost; it may not know how many."""
        self.begin_ns = 0
        """Since when events are recorded; 0 before that is known."""
        self._is_whole = False
        self._placed: list[str] = []
        self._refused: dict[str, str] = {}
        self._last_ns = self._until_ns = 0
        self._probes, self._origin = probes, origin
        self._pids = dict(pids)
        self._data = bytearray()
        self._layout: PageLayout | None = None
        self._sources: dict[int, _Source] = {}
        self._last_of_cpu: dict[int, int] = {}
        self._timers = TimerChecks()
        self._hits: list[Hit] = []
        self._kernel: list[Hit] = []
        self._gaps: list[Gap] = []
        self._programs = ProgramReader(origin)
        """What was listed since the last batch."""
        self._ended: list[int] = []
        self._realtime_offset_ns: int | None = None
        self._round: int | None = None
        self._round_ns: dict[int, int] = {}
        self._round_bytes = 0
        self._rests_ns: int | None = None
        self._cpu: int | None = None
        """Whose pages are being read."""
        self._block: tuple[str, bytearray] | None = None

    def feed(self, chunk: bytes) -> Iterator[Ready | Batch]:
        """Take a piece of the output, and yield what is complete by it: `Ready` once, then batches."""
        self._data += chunk
        self._round_bytes += len(chunk)
        try:
            if self._round_bytes > _ROUND_BYTES_MAX:
                raise ValueError(f"more than {_ROUND_BYTES_MAX} bytes in a second")
            yield from self._take()
        except (ValueError, KeyError) as error:
            raise TargetError(f"{self._origin}: what watch_probes.sh printed cannot be read: {error}") from error

    def rest(self) -> Batch:
        """What is left when the output has ended; where it was cut off, what came of a round is no whole one."""
        if self._rests_ns is not None:
            self._end_rest(max(self._rests_ns, self._last_ns) + 1)
        return self._batch(None if self._is_whole else 0)

    def _take(self) -> Iterator[Ready | Batch]:
        place = 0
        data = self._data
        try:
            while True:
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
        """Read a page, or the end of those of a CPU; how many bytes that were, 0 when more have to come."""
        assert self._layout is not None and self._cpu is not None
        if len(self._data) - place < len(_END_OF_PAGES):
            return 0
        # No page has that where the length of its events is.
        if self._data.startswith(_END_OF_PAGES, place):
            self._cpu = None
            return len(_END_OF_PAGES)
        size_bytes = self._layout.size_bytes
        if len(self._data) - place < size_bytes:
            return 0
        self._read_page(bytes(self._data[place : place + size_bytes]), self._layout, self._cpu)
        return size_bytes

    def _take_line(self, raw: bytes) -> Iterator[Ready | Batch]:
        line = raw.decode("utf-8", "replace")
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
                return
            text += raw + b"\n"
            if len(text) > _BLOCK_BYTES_MAX:
                raise ValueError(f"{kind} of more than {_BLOCK_BYTES_MAX} bytes")
            return
        word, _, rest = line.partition(" ")
        if word in ("header_page", "format", _PROGRAMS):
            self._block = (line, bytearray())
        elif word == "pages" and self._layout is not None:
            self._cpu = whole_number(rest, lowest=0, highest=CPUS_MAX)
        elif word == "round":
            if self._round is not None:
                yield self._batch(self._round)
            self._round, self._round_bytes = whole_number(rest, lowest=1), 0
        elif word == "realtime":
            # A clock that was never set may be behind.
            self._realtime_offset_ns = whole_number(rest, lowest=-WALL_TIME_MAX_NS, highest=WALL_TIME_MAX_NS)
        elif word == "ended":
            self._ended.append(whole_number(rest, lowest=1, highest=PID_MAX))
        elif word == "placed" and rest in self._probes:
            self._placed.append(rest)
        elif word == "refused" and rest.partition(" ")[0] in self._probes:
            name, _, reason = rest.partition(" ")
            self._refused[name] = reason[:300]
        elif line == "ready":
            yield Ready(placed=tuple(self._placed), refused=dict(self._refused))
        elif line == "done" or word == "left":
            self.is_done, self._is_whole = line == "done", True
        elif word != "lost" and line != "rtrun observes":
            raise ValueError(f"unexpected line {line[:80]!r}")

    def _end_block(self, kind: str, text: str) -> None:
        word, _, path = kind.partition(" ")
        if word == "header_page":
            self._layout = PageLayout.of(text)
        elif word == _PROGRAMS:
            self._programs.cut()
        else:
            self._add_format(path, EventFormat(text))

    def _add_format(self, path: str, event: EventFormat) -> None:
        if len(self._sources) > _FORMATS_MAX:
            raise ValueError(f"more than {_FORMATS_MAX} formats of events")
        probe = self._probes.get(event.name)
        if probe is not None and re.match(r"rtrun_observe_", path):
            convert = converter(probe.arguments, probe.constants)
            self._sources[event.identifier] = _Source(event, probe.event, convert)
            return
        # …/events/sched/sched_switch/format
        names = path.split("/")
        self._sources[event.identifier] = _Source(event, "/".join(names[-3:-1])[:128], is_kernel=True)

    def _read_page(self, page: bytes, layout: PageLayout, cpu: int) -> None:
        head = read_head(page, layout)
        if head.has_lost:
            self.lost += head.lost or 0
            before_ns = min(self._last_of_cpu.get(cpu, self.begin_ns), head.begin_ns)
            self._gaps.append(Gap(before_ns, head.begin_ns, f"the kernel lost events of CPU {cpu}"))
        sources, pids = self._sources, self._pids
        at_ns = head.begin_ns
        for at_ns, start, size in read_events(page, layout, head):
            identifier = page[start] | page[start + 1] << 8
            source = sources.get(identifier)
            if source is None:
                # Of an event that was switched on by somebody else.
                continue
            tid = int.from_bytes(page[start + 4 : start + 8], "little")
            if source.is_kernel:
                self._take_kernel_event(source, at_ns, cpu, tid, RawValues(source.format, page, start, size))
                continue
            values = source.format.values(page, start, size)
            if source.convert is not None:
                source.convert(values)
            self._hits.append(Hit(at_ns, cpu, pids.get(tid, 0), tid, source.event, values))
        self._last_of_cpu[cpu] = at_ns
        self._last_ns = max(self._last_ns, at_ns)

    def _take_kernel_event(self, source: _Source, at_ns: int, cpu: int, tid: int, values: RawValues) -> None:
        if source.format.name == _PRINT:
            text = str(values.get("buf", "")).strip()
            if text.startswith("rtrun "):
                self._take_mark(at_ns, text.removeprefix("rtrun "))
            return
        self._kernel.append(Hit(at_ns, cpu, self._pids.get(tid, 0), tid, source.event, values))

    def _take_mark(self, at_ns: int, mark: str) -> None:
        word, _, rest = mark.partition(" ")
        if word == "round":
            self._round_ns[whole_number(rest, lowest=1)] = at_ns
        elif word == "rests":
            self._rests_ns = at_ns
        elif word == "observes":
            if self.begin_ns:
                self._end_rest(at_ns)
            self.begin_ns = self.begin_ns or at_ns

    def _end_rest(self, until_ns: int) -> None:
        """Since its mark, or where that was lost, since the end of the batch before."""
        from_ns = self._rests_ns if self._rests_ns is not None else self._until_ns
        self._gaps.append(Gap(min(from_ns, until_ns), until_ns, RESTED))
        self._rests_ns = None

    def _batch(self, number: int | None) -> Batch:
        """What is complete by the end of a round, or all there is: later events of some CPUs are still to come."""
        until_ns = self._round_ns.get(number) if number is not None else max(self._last_ns + 1, self._until_ns)
        self._round_ns.clear()
        if until_ns is None:
            # The mark was lost: what is read is given with the next.
            until_ns = self._until_ns
        self._until_ns = until_ns
        # While probes are switched on or off one after the other, one end of a message is seen, and the other is not.
        silent = [(0, self.begin_ns), *((gap.from_ns, gap.until_ns) for gap in self._gaps if gap.reason == RESTED)]
        hits, self._hits = _cut(self._hits, until_ns, silent)
        kernel, self._kernel = _cut(self._kernel, until_ns, silent)
        # The programs of a round are told after its pages.
        pids = self._pids
        hits = tuple(hit._replace(pid=pids[hit.tid]) if not hit.pid and hit.tid in pids else hit for hit in hits)
        # In the order of time, of all CPUs: the thread of a timer goes from one to another.
        for hit in hits:
            if hit.event == _TIMER_CALL and isinstance(hit.values, dict):
                self._timers.check((hit.pid or -hit.tid, hit.values.get("timer")), hit.values)
        # One that lasts longer than the round, too: it comes no later than the hits of other CPUs within it.
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
            realtime_offset_ns=self._realtime_offset_ns,
        )
        self._programs, self._ended = ProgramReader(self._origin), []
        return batch


def _cut(hits: list[Hit], until_ns: int, silent: Sequence[tuple[int, int]]) -> tuple[tuple[Hit, ...], list[Hit]]:
    """Those up to a time, in the order of time, without those of silent times; and those that are later."""
    hits.sort(key=itemgetter(0))
    for from_ns, before_ns in silent:
        first, last = bisect_left(hits, from_ns, key=itemgetter(0)), bisect_left(hits, before_ns, key=itemgetter(0))
        del hits[first:last]
    count = bisect_right(hits, until_ns, key=itemgetter(0))
    return tuple(hits[:count]), hits[count:]
