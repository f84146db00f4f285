"""The times of messages at one end of a topic, and what became of these messages."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rtfiles.output import counted
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.messages import End
from rtrun.flows.observed.source import Growth, Identity, cuts_of, segments, silent_ns, without_values
from rtrun.flows.topics import PUBLISHER
from rtrun.flows.values import Stream
from rtrun.kinds.interval import STREAM as STREAM
from rtrun.kinds.values import no_values


def sources(observed: FlowAccumulator) -> Iterator["EndSource"]:
    ends = observed.topics.ends.items()
    return (EndSource(end, role, observed) for (role, _, _), end in ends if end.times)


@dataclass(frozen=True, slots=True)
class EndSource:
    record: End
    role: str
    observed: FlowAccumulator

    @property
    def name(self) -> str:
        return self.record.topic

    @property
    def detail(self) -> str:
        return f"{self.role} {self.record.label}"

    @property
    def identity(self) -> Identity:
        return {"topic": self.record.topic, "end": self.role, "node": self.record.label}

    def stream(self) -> Stream:
        end, store = self.record, self.observed.state.store
        if end.copies:
            return without_values(STREAM, self, end.copies)
        cuts = cuts_of(end.cuts, store)
        (times,) = end.times.columns()
        counts, remarks = self._fates()
        return Stream(
            kind=STREAM,
            identity=self.identity,
            columns={"timestamp_ns": times, "segment": segments(cuts, times.size, store)},
            counts={"messages": len(end.times), **counts},
            cuts=cuts,
            remarks=remarks,
            open_ns=silent_ns(end.times, end, self.observed, end.paused_ns) if self.role == PUBLISHER else 0,
            source=end,
        )

    def since(self, row: int) -> Growth:
        end = self.record
        if end.copies:
            return Growth(0, no_values(), no_values(), 0)
        times = end.times.read(max(row - 1, 0))[:, 0]
        cuts = end.cuts.between(row, len(end.times))
        # The step to the first row after a cut does not count.
        rows_of = np.arange(max(row, 1), len(end.times))
        is_step = ~np.isin(rows_of, cuts[cuts > 0])
        return Growth(len(end.times), np.diff(times)[is_step], times[1:][is_step], len(end.times))

    def _fates(self) -> tuple[dict[str, int], tuple[str, ...]]:
        end = self.record
        if self.role == PUBLISHER:
            paused = f"its program deactivated a node {counted(end.pauses, 'time')}: silence from then on is no stall"
            return {"never_taken": end.forgotten}, (paused,) * bool(end.pauses)
        decided = {
            "received": end.received,
            "duplicate": end.duplicates,
            "ambiguous": end.ambiguous,
            "historic": end.historic,
            "unmatched": end.unmatched,
        }
        counts = decided | {"waiting": len(end.times) - sum(decided.values())}
        if not end.unmatched:
            return counts, ()
        # Their publishers are not known, so they do not count as losses of a pair.
        remark = (
            f"{counted(end.unmatched, 'message')} came whose publication was not seen, of whatever publisher:"
            " published before, in a gap, by a program that is not observed, or too long ago; in ROS 1 with a header"
            " whose stamp is no wall time; in Humble and Iron while the clock was set"
        )
        return counts, (remark,)
