"""Activations of a loop, and how late each ran."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.loop_log import LoopLog
from rtrun.flows.observed.source import Growth, Identity, cuts_of, stalled_ns
from rtrun.flows.values import Stream
from rtrun.kinds.loop import STREAM as STREAM
from rtrun.kinds.values import Int64s
from rtrun.results.columns import PIECE_ROWS, collected


def sources(observed: FlowAccumulator) -> Iterator["LoopSource"]:
    return (LoopSource(log, observed) for log in observed.loops.logs.values() if log.is_shown)


def identity_of(log: LoopLog) -> Identity:
    """What identifies the loop of a thread."""
    identity: Identity = {"program": log.program, "thread": log.thread}
    return {**identity, "clock": log.clock} if log.clock else identity


@dataclass(frozen=True, slots=True)
class LoopSource:
    record: LoopLog
    observed: FlowAccumulator

    @property
    def name(self) -> str:
        return self.record.program

    @property
    def detail(self) -> str:
        return self.record.thread

    @property
    def identity(self) -> Identity:
        return identity_of(self.record)

    def stream(self) -> Stream:
        log, store = self.record, self.observed.state.store
        columns = dict(zip(STREAM.columns, collected(store.folder, self._pieces(), len(STREAM.columns)), strict=True))
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns=columns,
            counts={"measured": len(log.rows), "past_due": log.past_due},
            cuts=cuts_of(log.cuts, store),
            remarks=tuple(log.in_words()),
            open_ns=self._overdue_ns(),
            source=log,
        )

    def _pieces(self) -> Iterator[tuple[Int64s, ...]]:
        log, period_ns = self.record, self.record.period_ns()
        for begin in range(0, len(log.rows), PIECE_ROWS):
            columns = log.rows.read(begin, begin + PIECE_ROWS).T
            yield (*columns, log.skipped(begin, columns[0], period_ns))

    def _overdue_ns(self) -> int:
        """How long ago it was due, if it has not run since then."""
        thread = self.record.latest
        if thread is None or not thread.is_alive or not thread.timers or thread.is_on or not self.record.worst:
            return 0
        due_ns = min(timer.due_ns for timer in thread.timers.values())
        return max(0, stalled_ns(due_ns, self.record.worst.late_ns, self.observed))

    def since(self, row: int) -> Growth:
        log = self.record
        due, _, _, running = log.rows.read(row).T
        skipped = int(log.skipped(row, due, log.period_ns()).sum())
        rows = len(log.rows)
        tid = log.latest.tid if log.latest is not None else None
        return Growth(rows, running - due, np.ascontiguousarray(running), rows, skipped=skipped, tid=tid)
