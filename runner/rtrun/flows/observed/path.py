"""Reactions along a path of topics to the messages of its first publisher."""

from collections.abc import Iterator
from dataclasses import dataclass

from rtfiles.output import counted
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.messages import End
from rtrun.flows.observed.source import Growth, Identity, spans_since
from rtrun.flows.paths import PathLog
from rtrun.flows.values import Stream
from rtrun.kinds.path import STREAM as STREAM


def sources(observed: FlowAccumulator) -> Iterator["PathSource"]:
    paths, logs = observed.paths.paths, observed.paths.logs.items()
    return (PathSource(log, ",".join(paths[number]), publisher) for (number, publisher), log in logs)


@dataclass(frozen=True, slots=True)
class PathSource:
    record: PathLog
    name: str
    publisher: End

    @property
    def detail(self) -> str:
        return self.publisher.label

    @property
    def identity(self) -> Identity:
        return {"path": self.name, "publisher": self.detail}

    def stream(self) -> Stream:
        begin, end = self.record.rows.columns()
        unknown, outputs = self.record.unknown, end.size + self.record.unknown
        remark = f"path unknown: {100 * unknown / max(outputs, 1):.3g} % of {counted(outputs, 'message')} at its end"
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns={"begin_ns": begin, "end_ns": end},
            counts={"measured": end.size, "unknown": unknown},
            remarks=(remark,) if unknown else (),
            source=self.record,
        )

    def since(self, row: int) -> Growth:
        return spans_since(self.record.rows, row)
