"""What is measured, as it stands now: figures of every stream, renewed from what came since the last time."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rtfiles.output import counted, printable
from rtrun.analysis.histogram import Int64s
from rtrun.flows import streams
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.messages import PUBLISHED, RECEIVED, MessagePair
from rtrun.flows.timers import ClockOffsets, TimerLog
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.plan.observation import StreamDeadline, StreamKind
from rtrun.probes.hits import HITS_CLOCK, Gap, covered_ns

_BINS_OF_OCTAVE = 64
# Calls of a timer whose lateness is not known before its clock is read.
_WAITING_MAX = 200_000


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveRow:
    """Figures of one stream since the begin; None where there is no value. `name` and `of` are printable.

    Median and p99 are at most 1.6 % too high, the others exact. `rate_hz` is since the last snapshot; `lost` may still
    fall, as a message comes late.
    """

    kind: StreamKind
    name: str
    of: str
    n: int
    rate_hz: float
    median_ns: int | None
    p99_ns: int | None
    worst_ns: int | None
    lost: int | None = None
    deadline_ns: int | None = None
    misses: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Snapshot:
    """The streams at a time; `remarks` are sentences on what is missing."""

    at_ns: int
    observed_s: float
    rows: tuple[LiveRow, ...]
    remarks: tuple[str, ...]


class BinnedValues:
    """Figures of values that come in pieces: they are counted in bins, 64 for each doubling."""

    def __init__(self) -> None:
        self.n = self.misses = 0
        self.worst_ns: int | None = None
        # Those with values alone: there may be thousands of streams.
        self._bins: Int64s = np.empty(0, np.int64)
        self._counts: Int64s = np.empty(0, np.int64)

    def add(self, values_ns: Int64s, limit_ns: int | None) -> None:
        if not values_ns.size:
            return
        self.n += values_ns.size
        most = int(values_ns.max())
        self.worst_ns = most if self.worst_ns is None else max(most, self.worst_ns)
        if limit_ns is not None:
            self.misses += int(np.count_nonzero(values_ns > limit_ns))
        part, octave = np.frexp(np.maximum(values_ns, 1).astype(np.float64))
        place = octave.astype(np.int64) * _BINS_OF_OCTAVE + ((part - 0.5) * 2 * _BINS_OF_OCTAVE).astype(np.int64)
        self._bins, inverse = np.unique(np.concatenate((self._bins, place)), return_inverse=True)
        counts = np.zeros(self._bins.size, np.int64)
        np.add.at(counts, inverse, np.concatenate((self._counts, np.ones(place.size, np.int64))))
        self._counts = counts

    def quantile_ns(self, part: float) -> int | None:
        if self.worst_ns is None:
            return None
        place = int(self._bins[np.searchsorted(np.cumsum(self._counts), part * self.n)])
        octave, step = divmod(place, _BINS_OF_OCTAVE)
        return min(int(2.0**octave * (0.5 + (step + 1) / 2 / _BINS_OF_OCTAVE)), self.worst_ns)


@dataclass(slots=True)
class _Shown:
    """A stream that is shown: its figures, and how many of its rows are in them, and were at the last snapshot."""

    figures: BinnedValues
    rows: int = 0
    before: int = 0


@dataclass(frozen=True, slots=True)
class _Current:
    """A stream as it is now: its name, how many rows it has, its values from a row on, and when each was there.

    Of the rows, `settled` many have values that will not change.
    """

    key: object
    kind: StreamKind
    name: str
    of: str
    rows: int
    values_ns: Int64s
    times_ns: Int64s
    settled: int
    lost: int | None = None


@dataclass(frozen=True, slots=True)
class NewValues:
    """What a stream received since the last snapshot: values and when each was there, int64 (n,); figures without them.

    `source` is that of its Stream.
    """

    source: object
    kind: StreamKind
    values_ns: Int64s
    times_ns: Int64s
    before: BinnedValues


class LiveFigures:
    """Takes snapshots of an accumulator, each from what came since the one before.

    `on_values` is called with what each stream received.
    """

    def __init__(
        self,
        observed: FlowAccumulator,
        deadlines: Sequence[StreamDeadline] = (),
        on_values: Callable[[NewValues], None] | None = None,
    ) -> None:
        self._observed = observed
        self._on_values = on_values
        self._limits = {(deadline.kind, deadline.name): deadline.deadline_ns for deadline in deadlines}
        self._shown: dict[object, _Shown] = {}
        self._at_ns = observed.begin_ns

    def snapshot(self, at_ns: int) -> Snapshot:
        """The figures at a time, which is not before that of the last snapshot."""
        passed_s = (at_ns - self._at_ns) / 1e9
        self._at_ns = at_ns
        rows = tuple(self._row(current, passed_s) for current in self._current())
        return Snapshot(
            at_ns=at_ns,
            observed_s=(at_ns - self._observed.begin_ns) / 1e9,
            rows=rows,
            remarks=tuple(self._remarks()),
        )

    def _row(self, current: _Current, passed_s: float) -> LiveRow:
        shown = self._shown[current.key]
        limit_ns = self._limits.get((current.kind, current.name))
        if self._on_values is not None and current.values_ns.size:
            self._on_values(NewValues(current.key, current.kind, current.values_ns, current.times_ns, shown.figures))
        shown.figures.add(current.values_ns, limit_ns)
        shown.rows = current.settled
        new, shown.before = current.rows - shown.before, current.rows
        figures = shown.figures
        return LiveRow(
            kind=current.kind,
            name=printable(current.name),
            of=printable(current.of),
            n=current.rows,
            rate_hz=new / passed_s if passed_s > 0 else 0.0,
            median_ns=figures.quantile_ns(0.5),
            p99_ns=figures.quantile_ns(0.99),
            worst_ns=figures.worst_ns,
            lost=current.lost,
            deadline_ns=limit_ns,
            misses=None if limit_ns is None else figures.misses,
        )

    def _from(self, key: object) -> int:
        return self._shown.setdefault(key, _Shown(BinnedValues())).rows

    def _current(self) -> Iterator[_Current]:
        observed = self._observed
        for pair in observed.topics.pairs.values():
            yield self._messages(pair)
        for timer in observed.calls.timers.values():
            yield self._timer(timer, observed.offsets)
        for (number, publisher), path in observed.paths.logs.items():
            begins, times = path.rows.read(self._from(path)).T
            values = times - begins
            name = ",".join(observed.paths.paths[number])
            rows = len(path.rows)
            yield _Current(path, StreamKind.PATH, name, publisher.label, rows, values, times, rows)
        for callback in observed.calls.callbacks.values():
            identity = streams.callback_identity(callback)
            begins, times = callback.rows.read(self._from(callback)).T
            values = times - begins
            rows = len(callback.rows)
            of = f"{callback.label}, thread {callback.thread}"
            yield _Current(callback, StreamKind.CALLBACK, str(identity["callback"]), of, rows, values, times, rows)
        for (role, topic, label), end in observed.topics.ends.items():
            begin = self._from(end)
            times = end.times.read(max(begin - 1, 0))[:, 0]
            steps = np.diff(times)
            cuts = end.cuts.between(begin, len(end.times))
            # A step to row r, which is the first one behind a cut, is none.
            rows_of = np.arange(max(begin, 1), len(end.times))
            is_step = ~np.isin(rows_of, cuts[cuts > 0])
            rows = len(end.times)
            of = f"{role} {label}"
            yield _Current(end, StreamKind.INTERVALS, topic, of, rows, steps[is_step], times[1:][is_step], rows)

    def _messages(self, pair: MessagePair) -> _Current:
        begin = self._from(pair)
        new = pair.rows.read(begin)
        times = new[:, RECEIVED]
        values = times - new[:, PUBLISHED]
        of = f"{pair.publisher.label} to {pair.subscriber.label}"
        rows = len(pair.rows)
        return _Current(
            pair, StreamKind.MESSAGES, pair.publisher.topic, of, rows, values, times, rows, pair.lost_so_far
        )

    def _timer(self, log: TimerLog, offsets: ClockOffsets) -> _Current:
        rows = len(log.rows)
        begin = max(self._from(log), rows - _WAITING_MAX)
        at, expected = log.rows.read(begin).T
        values = times = np.empty(0, np.int64)
        settled = rows
        if log.clock is not None and log.period_ns is not None:
            known = expected != NOT_SEEN_NS
            if log.clock != HITS_CLOCK:
                # How the clock stood is known up to the time at which it was last read.
                last_ns = offsets.last_ns(log.clock)
                size = 0 if last_ns is None else int(np.searchsorted(at, last_ns, side="right"))
                at, expected, known, settled = at[:size], expected[:size], known[:size], begin + size
            offset, is_known, _ = offsets.read(log.clock, at)
            known = known & is_known
            values, times = (at + offset - expected)[known], at[known]
        identity = streams.timer_identity(log)
        return _Current(log, StreamKind.TIMER, log.label, str(identity["timer"]), rows, values, times, settled)

    def _remarks(self) -> Iterator[str]:
        observed = self._observed
        if observed.gaps:
            yield gaps_in_words(observed.gaps)
        if observed.state.left_out:
            yield f"{counted(observed.state.left_out, 'hit')} of more streams or programs than can be observed"
        if observed.state.unreadable:
            yield f"{counted(observed.state.unreadable, 'hit')} did not tell what they should"


def gaps_in_words(gaps: Sequence[Gap]) -> str:
    """How many there were, of what time, and why."""
    reasons = ", ".join(dict.fromkeys(gap.reason for gap in gaps))
    together_s = covered_ns((gap.from_ns, gap.until_ns) for gap in gaps) / 1e9
    return printable(f"{counted(len(gaps), 'gap')} of {together_s:.3g} s together: {reasons}")


def worst_first(rows: Iterable[LiveRow]) -> list[LiveRow]:
    """Rows with misses first, then by kind as they came."""
    order = list(StreamKind)
    return sorted(rows, key=lambda row: (-(row.misses or 0), order.index(row.kind)))
