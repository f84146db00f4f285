"""The current figures of every stream, updated with the values since the last snapshot."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rtfiles.output import counted, printable
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed.source import StreamSource
from rtrun.flows.streams import OBSERVED
from rtrun.kinds.kind import StreamKind, name_in_words
from rtrun.kinds.known import STREAMS
from rtrun.kinds.lateness import are_late
from rtrun.kinds.values import Int64s
from rtrun.plan.observation import StreamDeadline
from rtrun.probes.hits import Gap, covered_ns

_BINS_OF_OCTAVE = 64


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveRow:
    """Figures of one stream since the begin; None if there is no value. `name` and `detail` are printable.

    Median and p99 are at most 1.6 % too high, the others are exact. `rate_hz` is that since the last snapshot. `lost`
    counts messages, and may still fall when one comes late; or the skipped periods of a timer, which are misses, too.
    """

    kind: StreamKind
    name: str
    detail: str
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
    """Figures of values that come in pieces. The values are counted in bins, 64 for each doubling."""

    def __init__(self) -> None:
        self.n = self.misses = 0
        self.worst_ns: int | None = None
        # Only bins with values are kept: there may be thousands of streams.
        self._bins: Int64s = np.empty(0, np.int64)
        self._counts: Int64s = np.empty(0, np.int64)

    def add(self, values_ns: Int64s, limit_ns: int | None) -> None:
        if not values_ns.size:
            return
        self.n += values_ns.size
        most = int(values_ns.max())
        self.worst_ns = most if self.worst_ns is None else max(most, self.worst_ns)
        if limit_ns is not None:
            self.misses += int(np.count_nonzero(are_late(values_ns, limit_ns)))
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
    """A shown stream: its figures, the number of rows in them, the number of its rows before these, and skipped
    periods."""

    figures: BinnedValues
    rows: int = 0
    before: int = 0
    skipped: int = 0


@dataclass(frozen=True, slots=True)
class NewValues:
    """What a stream received since the last snapshot: the values and when each was there, int64 (n,).

    `before` are the figures without them; `source` is that of the Stream, `tid` that of the Growth.
    """

    source: object
    kind: StreamKind
    values_ns: Int64s
    times_ns: Int64s
    before: BinnedValues
    tid: int | None = None


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
        self._deadlines = deadlines
        self._shown: dict[tuple[StreamKind, object], _Shown] = {}
        self._at_ns = observed.begin_ns

    def snapshot(self, at_ns: int) -> Snapshot:
        """The figures at a time, which must not be before that of the last snapshot."""
        passed_s = (at_ns - self._at_ns) / 1e9
        self._at_ns = at_ns
        rows = tuple(
            self._row(kind.STREAM, source, passed_s) for kind in OBSERVED for source in kind.sources(self._observed)
        )
        return Snapshot(
            at_ns=at_ns,
            observed_s=(at_ns - self._observed.begin_ns) / 1e9,
            rows=rows,
            remarks=tuple(self._remarks()),
        )

    def _row(self, kind: StreamKind, source: StreamSource, passed_s: float) -> LiveRow:
        key = (kind, source.record)  # a record may have streams of several kinds
        shown = self._shown.setdefault(key, _Shown(BinnedValues()))
        limit_ns = self._limit_ns(kind, source)
        new = source.since(shown.rows)
        if new.rows < shown.rows:
            # What was taken for its values was none.
            shown = self._shown[key] = _Shown(BinnedValues())
        if self._on_values is not None and new.values_ns.size:
            self._on_values(NewValues(source.record, kind, new.values_ns, new.times_ns, shown.figures, new.tid))
        figures = shown.figures
        figures.add(new.values_ns, limit_ns)
        shown.rows = new.settled
        shown.skipped += new.skipped
        more, shown.before = new.rows - shown.before, new.rows
        return LiveRow(
            kind=kind,
            name=printable(str(name_in_words(source.name))),
            detail=printable(source.detail),
            n=new.rows,
            rate_hz=more / passed_s if passed_s > 0 else 0.0,
            median_ns=figures.quantile_ns(0.5),
            p99_ns=figures.quantile_ns(0.99),
            worst_ns=figures.worst_ns,
            lost=new.lost if new.lost is not None else shown.skipped or None,
            deadline_ns=limit_ns,
            misses=None if limit_ns is None else figures.misses + shown.skipped,
        )

    def _limit_ns(self, kind: StreamKind, source: StreamSource) -> int | None:
        of_kind = [deadline for deadline in self._deadlines if deadline.stream is kind]
        identity = source.identity if of_kind else {}
        return next((deadline.deadline_ns for deadline in of_kind if kind.is_named(deadline.name, identity)), None)

    def _remarks(self) -> Iterator[str]:
        observed = self._observed
        if observed.gaps:
            yield gaps_in_words(observed.gaps)
        if observed.state.left_out:
            yield f"{counted(observed.state.left_out, 'hit')} of more streams or programs than can be observed"
        if observed.state.unreadable:
            yield f"{counted(observed.state.unreadable, 'hit')} did not tell what they should"


def gaps_in_words(gaps: Sequence[Gap]) -> str:
    """The number of gaps, their total length, and their causes."""
    reasons = ", ".join(dict.fromkeys(gap.reason for gap in gaps))
    together_s = covered_ns((gap.from_ns, gap.until_ns) for gap in gaps) / 1e9
    return printable(f"{counted(len(gaps), 'gap')} of {together_s:.3g} s together: {reasons}")


def worst_first(rows: Iterable[LiveRow]) -> list[LiveRow]:
    """Rows with misses first, then by kind as they came."""
    order = list(STREAMS.values())
    return sorted(rows, key=lambda row: (-(row.misses or 0), order.index(row.kind)))
