"""How much of the observations' time was seen, and how much of the rest load may have hidden."""

from collections.abc import Iterable
from dataclasses import dataclass

from rtrun.probes.hits import GapCause, covered_ns
from rtrun.results.record import RunRecord

# Causes of gaps on a busy machine: a program cannot run, or events come faster than they are read.
OF_LOAD = frozenset((GapCause.RESTED, GapCause.EVENTS_LOST, GapCause.WATCHDOG_SILENT))


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeSeen:
    """Shares of the requested time, 0 to 1: the part not seen, and the part not seen because of load."""

    unseen_share: float = 0.0
    hidden_share: float = 0.0


def time_seen(records: Iterable[RunRecord]) -> TimeSeen:
    """The time that observations have seen; a run that does not observe has seen all of its time."""
    asked_ns = unseen_ns = hidden_ns = 0
    for record in records:
        if (coverage := record.coverage) is not None:
            asked_ns += coverage.asked_ns
            unseen_ns += coverage.asked_ns - coverage.seen_ns
            hidden_ns += covered_ns((gap.begin_ns, gap.end_ns) for gap in coverage.gaps if gap.cause in OF_LOAD)
    if not asked_ns:
        return TimeSeen()
    return TimeSeen(unseen_share=min(1.0, unseen_ns / asked_ns), hidden_share=min(1.0, hidden_ns / asked_ns))
