"""Responses of a loop: from when it was due until it sleeps until its next time."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.loop_log import LoopLog
from rtrun.flows.observed.loop import identity_of
from rtrun.flows.observed.source import Growth, Identity, spans_since, stalled_ns
from rtrun.flows.rows import Rows
from rtrun.flows.values import Stream
from rtrun.kinds.loop_response import STREAM as STREAM


def sources(observed: FlowAccumulator) -> Iterator["ResponseSource"]:
    logs = (log for log in observed.loops.logs.values() if log.is_shown and len(log.rows))
    return (ResponseSource(log.responses, log, observed) for log in logs)


@dataclass(frozen=True, slots=True)
class ResponseSource:
    record: Rows
    log: LoopLog
    observed: FlowAccumulator

    @property
    def name(self) -> str:
        return self.log.program

    @property
    def detail(self) -> str:
        return self.log.thread

    @property
    def identity(self) -> Identity:
        return identity_of(self.log)

    def stream(self) -> Stream:
        begin, end, run = self.record.columns()
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns={"begin_ns": begin, "end_ns": end, "run_ns": run},
            counts={"measured": end.size},
            open_ns=self._unended_ns(),
            source=self.record,
        )

    def _unended_ns(self) -> int:
        thread = self.log.latest
        if thread is None or not thread.is_alive or thread.open_ns is None:
            return 0
        longest_ns = max((int(np.max(piece[:, 1] - piece[:, 0])) for piece in self.record.pieces()), default=0)
        return max(0, stalled_ns(thread.open_ns, longest_ns, self.observed))

    def since(self, row: int) -> Growth:
        return spans_since(self.record, row)
