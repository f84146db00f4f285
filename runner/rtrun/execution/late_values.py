"""Late values of an observation, each with the kernel's events around it, which may show its cause."""

import heapq
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path

import numpy as np

from rtfiles.output import printable
from rtrun.causes.control import control_ns
from rtrun.causes.outliers import AFTER_NS, BEFORE_NS
from rtrun.flows.live import NewValues
from rtrun.flows.turns import Turn
from rtrun.kinds.lateness import are_late
from rtrun.kinds.values import Int64s
from rtrun.plan.trace import quantile
from rtrun.probes.hits import GAPS_MAX, Gap, Hit, joined
from rtrun.probes.kernel_events import KernelEvents
from rtrun.probes.stream import Batch
from rtrun.probes.trace_text import trace_text
from rtrun.results.texts import StoredText, TextStore

# Per stream; the programs of the suites keep as many.
TRACES_MAX = 16  #: traces around late values of an observed stream
# Events are kept for this long, within limits: bytes of kernel events, turns of threads and characters of their names,
# and times of hits. On a busy machine the limits hold about as much.
KEPT_NS = 10 * 10**9
EVENTS_BYTES_MAX = 64 * 1024 * 1024  #: kernel events of the last seconds, kept for traces around late values
TURNS_MAX = 100_000  #: callbacks that are kept for them
TURN_CHARACTERS_MAX = 6_000_000  #: characters of the names of these callbacks together
HITS_MAX = 1_000_000  #: hits whose threads are kept for them
# Text of traces that one call makes, some seconds' work: other late values wait for the next call.
TEXT_BYTES_AT_ONCE_MAX = 32 * 1024 * 1024  #: text of traces that is written at one time; other late values wait


@dataclass(kw_only=True, slots=True, eq=False)
class LateValue:
    """A value above the limit in force when it came: its time by CLOCK_MONOTONIC, and its thread.

    `text` is the kernel's trace around it: None until the events after it have arrived, empty if it was not kept.
    Values close to one another share a trace.
    """

    value_ns: int
    at_ns: int
    limit_ns: int
    tid: int | None
    text: StoredText | None = None

    @property
    def due_ns(self) -> int:
        """When the value would have been 0."""
        return self.at_ns - self.value_ns

    @property
    def from_ns(self) -> int:
        """Events from this time on are needed to explain the value."""
        return self.due_ns - max(control_ns(self.value_ns), BEFORE_NS)

    @property
    def until_ns(self) -> int:
        return self.at_ns + AFTER_NS


@dataclass(slots=True)
class LateValues:
    """The first late values of a stream, the number of all late values, and the present limit.

    When several values are late at the same time, for example messages in a queue, only the one that waited longest is
    kept. Otherwise all kept values might have the same cause.
    """

    above_limit: int = 0
    limit_ns: int | None = None
    """None as long as there are too few values for the quantile."""
    kept: list[LateValue] = field(default_factory=list)

    def keep(self, late: LateValue) -> None:
        """Keep a late value. Values must come in the order of time."""
        last = self.kept[-1] if self.kept else None
        if last is not None and late.due_ns < last.at_ns and last.due_ns < late.at_ns:
            if late.value_ns > last.value_ns and last.text is None:
                self.kept[-1] = late
        elif len(self.kept) < TRACES_MAX:
            self.kept.append(late)


class LateValueRecord:
    """Keeps the kernel's events of the last seconds, and stores those around late values as traces.

    `above` is the limit as `rtrun.plan.trace.read_trace` returns it; a quantile is computed from the values of a stream
    so far. `symbols` maps addresses to names of kernel functions. Traces are stored in `folder`; None: in the folder of
    temporary files. Pass each batch to `record`, then its values to `look`. `cut` then makes the traces of the late
    values whose following events have all arrived.
    """

    def __init__(self, above: str, symbols: Mapping[int, str], folder: Path | None = None) -> None:
        self.above = above
        self.streams: dict[object, LateValues] = {}
        """By the source of each stream."""
        self._symbols = symbols
        self._part = quantile(above)
        self._events: deque[KernelEvents] = deque()
        """One item per batch."""
        self._gaps: list[Gap] = []
        self._turns: deque[Turn] = deque()
        self._hits: deque[tuple[Int64s, Int64s]] = deque()
        """Times and threads of hits, one item per batch."""
        self._events_bytes = self._turn_characters = self._hit_count = 0
        self._texts = TextStore(folder)

    def record(self, batch: Batch) -> None:
        """Take the kernel's events of a batch, and the thread of each hit."""
        if len(batch.kernel):
            self._events.append(batch.kernel)
            self._events_bytes += batch.kernel.size_bytes
        while self._events_bytes > EVENTS_BYTES_MAX:
            self._events_bytes -= self._events.popleft().size_bytes
        self._gaps += batch.gaps
        if len(self._gaps) > GAPS_MAX:
            self._gaps = joined(self._gaps)
        if batch.hits:
            hits = np.array([(hit.at_ns, hit.tid) for hit in batch.hits], dtype=np.int64)
            self._hits.append((hits[:, 0], hits[:, 1]))
            self._hit_count += len(hits)
        while self._hit_count > HITS_MAX:
            self._forget_hits()

    def _forget_hits(self) -> None:
        self._hit_count -= self._hits.popleft()[0].size

    def turn(self, turn: Turn) -> None:
        """Take one turn of a thread. It must come before the values of its batch."""
        self._turns.append(turn)
        self._turn_characters += len(turn.name)
        while len(self._turns) > TURNS_MAX or self._turn_characters > TURN_CHARACTERS_MAX:
            self._forget_turn()

    def _forget_turn(self) -> None:
        self._turn_characters -= len(self._turns.popleft().name)

    def look(self, new: NewValues) -> None:
        """Note which new values of a stream are late."""
        if not new.kind.is_traced:
            return
        late = self.streams.setdefault(new.source, LateValues())
        limit_ns = late.limit_ns = self._limit_ns(new)
        if limit_ns is None:
            return
        places = np.flatnonzero(are_late(new.values_ns, limit_ns))
        late.above_limit += places.size
        for place in places:
            at_ns = int(new.times_ns[place])
            tid = new.tid if new.tid is not None else self._thread(at_ns)
            late.keep(LateValue(value_ns=int(new.values_ns[place]), at_ns=at_ns, limit_ns=limit_ns, tid=tid))

    def _thread(self, at_ns: int) -> int | None:
        """The thread of the hit at this time; None if the hit is not kept any more."""
        for times, tids in reversed(self._hits):
            if times[0] <= at_ns <= times[-1]:
                place = int(np.searchsorted(times, at_ns))
                return int(tids[place]) if times[place] == at_ns else None
        return None

    def _limit_ns(self, new: NewValues) -> int | None:
        if self._part is None:
            return int(self.above.removesuffix("us")) * 1000
        # Too few values yet: at least one must be expected above the quantile.
        if new.before.n * (1 - self._part) < 1:
            return None
        limit_ns = new.before.quantile_ns(self._part)
        # A run has its limit in microseconds.
        return limit_ns and max(1000, limit_ns)

    def cut(self, until_ns: int) -> None:
        """Make the traces of late values, and forget old events. All events before `until_ns` have arrived."""
        turns: _TurnsByTime | None = None
        end = self._texts.end + TEXT_BYTES_AT_ONCE_MAX
        for late in self.streams.values():
            for near in _near(sorted(self._waiting(late, until_ns), key=lambda value: value.from_ns)):
                if self._texts.end >= end:
                    break
                turns = turns or _TurnsByTime(self._turns)
                text = self._text(turns, near[0].from_ns, max(value.until_ns for value in near))
                for value in near:
                    value.text = text
        oldest_ns = until_ns - KEPT_NS
        while self._events and self._events[0].at_ns[-1] < oldest_ns:
            self._events_bytes -= self._events.popleft().size_bytes
        self._gaps = [gap for gap in self._gaps if gap.until_ns >= oldest_ns]
        while self._hits and self._hits[0][0][-1] < oldest_ns:
            self._forget_hits()
        while self._turns and self._turns[0].begin_ns < oldest_ns:
            self._forget_turn()

    def _waiting(self, late: LateValues, until_ns: int) -> Iterator[LateValue]:
        """The late values without a trace whose events have all arrived."""
        oldest_ns = int(self._events[0].at_ns[0]) if self._events else until_ns
        return (
            value
            for value in late.kept
            if value.text is None and oldest_ns < value.at_ns and value.until_ns <= until_ns
        )

    def _text(self, turns: "_TurnsByTime", from_ns: int, until_ns: int) -> StoredText:
        gaps = [gap for gap in self._gaps if from_ns <= gap.until_ns <= until_ns]
        kernel = [batch.between(from_ns, until_ns) for batch in self._events]
        events = _EventsOfTrace(kernel, turns.between(from_ns, until_ns))
        return self._texts.add(trace_text(events, gaps, self._symbols))


class _TurnsByTime:
    """Turns of threads, sorted by the time of their event in a trace."""

    def __init__(self, turns: Iterable[Turn]) -> None:
        self._turns = sorted(turns, key=_event_ns)
        self._at_ns = np.array([*map(_event_ns, self._turns)], np.int64)

    def between(self, from_ns: int, until_ns: int) -> Sequence[Turn]:
        """The turns with an event at or after `from_ns` and before `until_ns`."""
        first, last = np.searchsorted(self._at_ns, [from_ns, until_ns])
        return self._turns[first:last]


@dataclass(frozen=True, slots=True)
class _EventsOfTrace:
    """Kernel events and callbacks in the order of time, decoded during iteration."""

    kernel: Sequence[KernelEvents]
    turns: Sequence[Turn]

    def __iter__(self) -> Iterator[Hit]:
        return heapq.merge(*self.kernel, map(_as_event, self.turns), key=itemgetter(0))


def _event_ns(turn: Turn) -> int:
    """The time of a turn's event: its end, or its begin if the end was not seen."""
    return turn.begin_ns if turn.end_ns is None else turn.end_ns


def _as_event(turn: Turn) -> Hit:
    """A callback as an event of the trace."""
    none: dict[str, int | str] = {"common_flags": 0, "common_preempt_count": 0}
    name = printable(turn.name)
    if turn.end_ns is None:
        return Hit(turn.begin_ns, turn.cpu, turn.pid, turn.tid, "callback_begin", {**none, "name": name})
    values = {**none, "took_ns": turn.end_ns - turn.begin_ns, "name": name}
    return Hit(turn.end_ns, turn.cpu, turn.pid, turn.tid, "callback_end", values)


def _near(late: Sequence[LateValue]) -> Iterator[list[LateValue]]:
    """Values in groups whose traces would overlap."""
    group: list[LateValue] = []
    for value in late:
        if group and value.from_ns > max(other.until_ns for other in group):
            yield group
            group = []
        group.append(value)
    if group:
        yield group
