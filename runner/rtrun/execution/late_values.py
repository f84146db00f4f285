"""Late values of an observation, each with the kernel's events around it, from which its cause is read."""

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from rtfiles.output import printable
from rtrun.analysis.histogram import Int64s
from rtrun.causes.control import control_ns
from rtrun.causes.ftrace import CALLBACK_CHARACTERS_MAX
from rtrun.causes.outliers import AFTER_NS, BEFORE_NS
from rtrun.flows.live import NewValues
from rtrun.flows.turns import Turn
from rtrun.plan.observation import StreamKind
from rtrun.plan.trace import quantile
from rtrun.probes.hits import Gap, Hit
from rtrun.probes.stream import Batch
from rtrun.probes.trace_text import trace_text

# Of a stream, as many as a program of the suites keeps.
TRACES_MAX = 16
# Of all streams: some thousand traces.
TEXT_BYTES_MAX = 256 * 1024 * 1024
# So long events are kept, and no more of them: that takes some 130 MiB.
KEPT_NS = 10 * 10**9
EVENTS_KEPT = 400_000
# Between two messages a time passes that is as long as it should be.
TRACED = frozenset({StreamKind.MESSAGES, StreamKind.TIMER, StreamKind.CALLBACK, StreamKind.PATH})


@dataclass(kw_only=True, slots=True, eq=False)
class LateValue:
    """A value above the limit that held when it came, at a time of CLOCK_MONOTONIC, to a thread.

    `text` is the kernel's trace around it; it is empty until the events after it are there, and where it was not kept.
    Values that are near one another have the same.
    """

    value_ns: int
    at_ns: int
    limit_ns: int
    tid: int | None
    text: bytes = b""

    @property
    def due_ns(self) -> int:
        """When the value would have been 0."""
        return self.at_ns - self.value_ns

    @property
    def from_ns(self) -> int:
        """From when on events are needed to explain it."""
        return self.due_ns - max(control_ns(self.value_ns), BEFORE_NS)

    @property
    def until_ns(self) -> int:
        return self.at_ns + AFTER_NS


@dataclass(slots=True)
class LateValues:
    """The first late values of a stream, the number of all, and the limit as it is now.

    Of values that were late at the same time, as messages that waited behind one another, the one that waited longest
    is kept: else all that are kept might have waited for one thing.
    """

    above_limit: int = 0
    limit_ns: int | None = None
    """None as long as there are too few values for the quantile."""
    kept: list[LateValue] = field(default_factory=list)

    def keep(self, late: LateValue) -> None:
        """Keep one that came after those before."""
        last = self.kept[-1] if self.kept else None
        if last is not None and late.due_ns < last.at_ns and last.due_ns < late.at_ns:
            if late.value_ns > last.value_ns and not last.text:
                self.kept[-1] = late
        elif len(self.kept) < TRACES_MAX:
            self.kept.append(late)


class LateValueRecord:
    """Keeps the kernel's events of the last seconds, and of those the ones around late values.

    `above` is the limit as `rtrun.plan.trace.read_trace` gives it; a quantile is one of the values of a stream so far.
    `symbols` are names of the kernel's functions by their addresses. A batch is first given to `record`, then its
    values to `look`; `cut` then makes the traces of those after which all events are there.
    """

    def __init__(self, above: str, symbols: Mapping[int, str]) -> None:
        self.above = above
        self.streams: dict[object, LateValues] = {}
        """By the source of each stream."""
        self._symbols = symbols
        self._part = quantile(above)
        self._events: list[Hit] = []
        self._gaps: list[Gap] = []
        self._turns: deque[Turn] = deque(maxlen=EVENTS_KEPT)
        self._hits: deque[tuple[Int64s, Int64s]] = deque()
        """When there were hits, and of which threads, by batches."""
        self._text_bytes = 0

    def record(self, batch: Batch) -> None:
        """Take the kernel's events of a batch, and which thread each hit was of."""
        self._events += batch.kernel
        self._gaps += batch.gaps
        if batch.hits:
            hits = np.array([(hit.at_ns, hit.tid) for hit in batch.hits], dtype=np.int64)
            self._hits.append((hits[:, 0], hits[:, 1]))

    def turn(self, turn: Turn) -> None:
        """Take what a thread had to do; it is told before the values of its batch."""
        self._turns.append(turn)

    def look(self, new: NewValues) -> None:
        """Note which new values of a stream are late."""
        if new.kind not in TRACED:
            return
        late = self.streams.setdefault(new.source, LateValues())
        limit_ns = late.limit_ns = self._limit_ns(new)
        if limit_ns is None:
            return
        places = np.flatnonzero(new.values_ns > limit_ns)
        late.above_limit += places.size
        for place in places:
            at_ns = int(new.times_ns[place])
            tid = self._thread(at_ns)
            late.keep(LateValue(value_ns=int(new.values_ns[place]), at_ns=at_ns, limit_ns=limit_ns, tid=tid))

    def _thread(self, at_ns: int) -> int | None:
        """The thread of the hit at a time; None for one that is not kept any more."""
        for times, tids in reversed(self._hits):
            if times[0] <= at_ns <= times[-1]:
                place = int(np.searchsorted(times, at_ns))
                return int(tids[place]) if times[place] == at_ns else None
        return None

    def _limit_ns(self, new: NewValues) -> int | None:
        if self._part is None:
            return int(self.above.removesuffix("us")) * 1000
        # One of those before is expected above it.
        if new.before.n * (1 - self._part) < 1:
            return None
        limit_ns = new.before.quantile_ns(self._part)
        # A run has its limit in microseconds.
        return limit_ns and max(1000, limit_ns)

    def cut(self, until_ns: int) -> None:
        """Make the traces of late values, and forget old events; `until_ns`: all events before are there."""
        for late in self.streams.values():
            for near in _near(sorted(self._waiting(late, until_ns), key=lambda one: one.from_ns)):
                text = self._text(near[0].from_ns, max(one.until_ns for one in near))
                for one in near:
                    one.text = text
        oldest_ns = until_ns - KEPT_NS
        too_old = bisect_left(self._events, oldest_ns, key=itemgetter(0))
        del self._events[: max(too_old, len(self._events) - EVENTS_KEPT)]
        self._gaps = [gap for gap in self._gaps if gap.until_ns >= oldest_ns]
        while self._hits and self._hits[0][0][-1] < oldest_ns:
            self._hits.popleft()
        while self._turns and self._turns[0].begin_ns < oldest_ns:
            self._turns.popleft()

    def _waiting(self, late: LateValues, until_ns: int) -> Iterator[LateValue]:
        """Those whose events are all there now."""
        oldest_ns = self._events[0].at_ns if self._events else until_ns
        return (one for one in late.kept if not one.text and oldest_ns < one.at_ns and one.until_ns <= until_ns)

    def _text(self, from_ns: int, until_ns: int) -> bytes:
        first, last = (bisect_left(self._events, at_ns, key=itemgetter(0)) for at_ns in (from_ns, until_ns))
        gaps = [gap for gap in self._gaps if from_ns <= gap.until_ns <= until_ns]
        if self._text_bytes > TEXT_BYTES_MAX:
            return b""
        callbacks = [hit for turn in self._turns if from_ns <= (hit := _as_event(turn)).at_ns < until_ns]
        events = sorted([*self._events[first:last], *callbacks], key=itemgetter(0))
        text = "".join(trace_text(events, gaps, self._symbols)).encode()
        self._text_bytes += len(text)
        return text


def _as_event(turn: Turn) -> Hit:
    """A callback as an event of the trace: at its end, or where that was not seen, at its begin."""
    none: dict[str, int | str] = {"common_flags": 0, "common_preempt_count": 0}
    name = printable(turn.name)[:CALLBACK_CHARACTERS_MAX]
    if turn.end_ns is None:
        return Hit(turn.begin_ns, turn.cpu, turn.pid, turn.tid, "callback_begin", {**none, "name": name})
    told = {**none, "took_ns": turn.end_ns - turn.begin_ns, "name": name}
    return Hit(turn.end_ns, turn.cpu, turn.pid, turn.tid, "callback_end", told)


def _near(late: Sequence[LateValue]) -> Iterator[list[LateValue]]:
    """Values in groups whose traces would overlap."""
    group: list[LateValue] = []
    for one in late:
        if group and one.from_ns > max(other.until_ns for other in group):
            yield group
            group = []
        group.append(one)
    if group:
        yield group
