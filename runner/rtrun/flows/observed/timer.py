"""Calls of a timer, and how late they were, if its clock and its period are known."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed.source import Growth, Identity, cuts_of, segments, silent_ns
from rtrun.flows.programs import numbered
from rtrun.flows.timers import (
    LATE_MAX_NS,
    TimerLog,
    called_period_ns,
    certain_calls,
    is_on_grid,
    known_period_ns,
    lateness,
)
from rtrun.flows.values import Stream
from rtrun.kinds.timer import STREAM as STREAM
from rtrun.kinds.values import no_values
from rtrun.probes.hits import HITS_CLOCK
from rtrun.results.columns import collected

_WAITING_MAX = 200_000  #: calls of a timer that wait for its clock to be read: their lateness is not known before


def sources(observed: FlowAccumulator) -> Iterator["TimerSource"]:
    return (TimerSource(log, observed) for log in observed.calls.timers.values())


@dataclass(frozen=True, slots=True)
class TimerSource:
    record: TimerLog
    observed: FlowAccumulator

    @property
    def name(self) -> str:
        return self.record.label

    @property
    def detail(self) -> str:
        return numbered(self.record.name, self.record.number)

    @property
    def identity(self) -> Identity:
        identity: Identity = {"node": self.name, "timer": self.detail}
        return {**identity, "clock": self.record.clock} if self.record.clock else identity

    def stream(self) -> Stream:
        log, store = self.record, self.observed.state.store
        late = lateness(log, self.observed.offsets, store)
        counts = {"calls": log.calls}
        if late.at_ns.size:
            cuts = late.cuts
            columns = {"timestamp_ns": late.at_ns, "expected_ns": late.expected_ns, "real_ns": late.real_ns}
            counts["skipped"] = late.skipped
        else:
            cuts = cuts_of(log.cuts, store)
            (at_ns,) = collected(store.folder, ((piece[:, 0],) for piece in log.rows.pieces()), 1)
            columns = {"timestamp_ns": at_ns}
        rows = columns["timestamp_ns"].size
        period_ns = known_period_ns(log) if "skipped" in counts else called_period_ns(log)
        # A call was due a period after the last one.
        overdue_ns = 0 if period_ns is None else max(0, silent_ns(log.rows, log, self.observed) - period_ns)
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns=columns | {"segment": segments(cuts, rows, store)},
            counts=counts | {"measured": rows},
            period_ns=period_ns,
            cuts=cuts,
            remarks=late.why_not,
            open_ns=overdue_ns,
            source=log,
        )

    def since(self, row: int) -> Growth:
        log, offsets = self.record, self.observed.offsets
        rows = len(log.rows)
        begin, end = max(row, rows - _WAITING_MAX), rows
        nothing = Growth(rows, no_values(), no_values(), rows)
        if log.is_mixed:
            return Growth(0, no_values(), no_values(), 0)
        if log.clock is None or not log.period_ns or begin == rows:
            return nothing
        if log.clock != HITS_CLOCK:
            # The offset of the clock is known up to its last reading.
            last_ns = offsets.last_ns(log.clock)
            at = log.rows.read(begin)[:, 0]
            end = begin if last_ns is None else begin + int(np.searchsorted(at, last_ns, side="right"))
        if is_on_grid(log, begin, end) is False:
            return nothing
        new = certain_calls(log, log.clock, begin, end, offsets)
        late = new.real_ns - new.due_ns
        if late.size and abs(float(np.median(late))) > LATE_MAX_NS:
            # Its grid does not follow the clock: the time is simulated.
            return nothing
        return Growth(rows, late, new.at_ns, end, skipped=new.skipped)
