"""The requests of a client that a server answered, and those that nobody answered."""

from collections.abc import Iterator
from dataclasses import dataclass

from rtfiles.output import counted
from rtfiles.quantities import time
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.observed.source import STALL_NS, Growth, Identity
from rtrun.flows.requests import ServicePair
from rtrun.flows.values import Stream
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.service import STREAM as STREAM


def sources(observed: FlowAccumulator) -> Iterator["ServiceSource"]:
    services = observed.services
    waiting = services.waiting(max(observed.until_ns, observed.newest_ns), STALL_NS)
    return (ServiceSource(pair, tuple(waiting.get(pair, ()))) for pair in services.pairs.values())


@dataclass(frozen=True, slots=True)
class ServiceSource:
    record: ServicePair
    waiting_ns: tuple[int, ...]
    """How long each request has waited that is overdue, the longest first."""

    @property
    def name(self) -> str:
        return self.record.service

    @property
    def detail(self) -> str:
        return f"{self.record.client} to {self.record.server or 'nobody seen'}"

    @property
    def identity(self) -> Identity:
        identity: Identity = {"service": self.record.service, "client": self.record.client}
        return {**identity, "server": self.record.server} if self.record.server else identity

    def stream(self) -> Stream:
        begin, end, taken, answered = self.record.rows.columns()
        remarks = []
        if unknown := int((taken == NOT_SEEN_NS).sum()):
            remarks.append(f"not known of {counted(unknown, 'request')} when the server took it")
        if unclear := self.record.unclear:
            remarks.append(f"not known of {counted(unclear, 'request')} when its client took the answer")
        if self.waiting_ns and not end.size:
            waited = time(self.waiting_ns[0])
            remarks.append(f"nobody answered: {counted(len(self.waiting_ns), 'request')}, the first for {waited}")
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns={"begin_ns": begin, "end_ns": end, "taken_ns": taken, "answered_ns": answered},
            counts={
                "measured": end.size,
                "unanswered": len(self.waiting_ns),
                "unclear": unclear,
                "lost": self.record.lost,
            },
            remarks=tuple(remarks),
            open_ns=next(iter(self.waiting_ns), 0),
            more_open_ns=self.waiting_ns[1:],
            source=self.record,
        )

    def since(self, row: int) -> Growth:
        begin, end, *_ = self.record.rows.read(row).T
        rows = len(self.record.rows)
        return Growth(rows, end - begin, end, rows, lost=self.record.lost + len(self.waiting_ns))
