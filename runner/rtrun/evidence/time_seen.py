"""How much of the time of observations was seen, and how much of the rest load may have hidden."""

from collections.abc import Iterable
from dataclasses import dataclass

from rtrun.probes.hits import GapCause, covered_ns
from rtrun.results.record import RunRecord

# What a busy machine causes: a program is kept from running, or events come faster than they are read.
OF_LOAD = frozenset((GapCause.RESTED, GapCause.EVENTS_LOST, GapCause.WATCHDOG_SILENT))


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeSeen:
    """Shares of the time that was asked for, 0 to 1: not seen, and of that, because of load."""

    unseen_share: float = 0.0
    hidden_share: float = 0.0


def time_seen(records: Iterable[RunRecord]) -> TimeSeen:
    """What observations have seen; a run that measures by itself has seen all of its time."""
    asked_ns = unseen_ns = hidden_ns = 0
    for record in records:
        if (coverage := record.coverage) is not None:
            asked_ns += coverage.asked_ns
            unseen_ns += coverage.asked_ns - coverage.seen_ns
            hidden_ns += covered_ns((gap.begin_ns, gap.end_ns) for gap in coverage.gaps if gap.cause in OF_LOAD)
    if not asked_ns:
        return TimeSeen()
    return TimeSeen(unseen_share=min(1.0, unseen_ns / asked_ns), hidden_share=min(1.0, hidden_ns / asked_ns))
