"""Callbacks: when each began and ended."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed.source import Growth, Identity, spans_since, stalled_ns
from rtrun.flows.programs import numbered
from rtrun.flows.threads import CallbackLog
from rtrun.flows.values import Stream
from rtrun.kinds.callback import STREAM as STREAM


def sources(observed: FlowAccumulator) -> Iterator["CallbackSource"]:
    # This searches all threads, once, and only for whole streams: live figures do not need it.
    running = cache(lambda: dict(observed.open_calls()))
    return (CallbackSource(log, observed, running) for log in observed.calls.callbacks.values())


@dataclass(frozen=True, slots=True)
class CallbackSource:
    record: CallbackLog
    observed: FlowAccumulator
    running: Callable[[], Mapping[CallbackLog, int]]
    """When each running callback began."""

    @property
    def name(self) -> str:
        return numbered(self.record.subject or "unknown", self.record.number)

    @property
    def detail(self) -> str:
        return f"{self.record.label}, thread {self.record.thread}"

    @property
    def identity(self) -> Identity:
        return {"node": self.record.label, "callback": self.name, "thread": self.record.thread}

    def stream(self) -> Stream:
        begin, end = self.record.rows.columns()
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns={"begin_ns": begin, "end_ns": end},
            counts={"measured": end.size},
            open_ns=self._unended_ns(),
            source=self.record,
        )

    def since(self, row: int) -> Growth:
        return spans_since(self.record.rows, row)

    def _unended_ns(self) -> int:
        since_ns = self.running().get(self.record)
        if since_ns is None:
            return 0
        longest_ns = max((int(np.diff(piece).max()) for piece in self.record.rows.pieces()), default=0)
        return stalled_ns(since_ns, longest_ns, self.observed)
