"""What became of the messages of each hop: every message that was sent is counted once."""

from dataclasses import dataclass

import numpy as np

from rtrun.flows.topology.tables import NONE, HopTable, TopologyTables
from rtrun.kinds.values import Int64s

ON_THE_WAY = "dropped on the way"
"""The middleware or its transport dropped it, in a full queue or elsewhere: no program saw it."""
TOO_LATE = "sent after the node had ended"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HopFates:
    """The messages of a hop that were sent while it was measured.

    sent = taken + overwritten + unused + on_the_way + too_late. `rows`, int64, are the rows of the hop's table in which
    a message came for the first time. `duplicates` came again; `out_of_order` came after a later message.
    """

    sent: int
    taken: int
    overwritten: int
    unused: int
    on_the_way: int
    too_late: int
    rows: Int64s
    duplicates: int
    out_of_order: int

    @property
    def lost(self) -> dict[str, int]:
        """The messages that never came, by cause."""
        causes = {ON_THE_WAY: self.on_the_way, TOO_LATE: self.too_late}
        return {cause: count for cause, count in causes.items() if count}


def fates(tables: TopologyTables, hop: HopTable) -> HopFates:
    """What became of the messages of a hop."""
    publisher = tables.nodes[hop.publisher]
    sent = publisher.release_ns.size - publisher.first
    measured = np.flatnonzero(hop.seq >= publisher.first)
    numbers, first = np.unique(hop.seq[measured], return_index=True)
    rows = np.sort(measured[first])
    is_taken = hop.taken[rows] != NONE
    last_taken = int(np.flatnonzero(is_taken)[-1]) if is_taken.any() else -1
    came = np.zeros(sent, np.bool_)
    came[numbers - publisher.first] = True
    too_late = int(np.count_nonzero(publisher.done_ns[publisher.first :][~came] > hop.left_ns))
    taken = int(np.count_nonzero(is_taken))
    overwritten = last_taken + 1 - taken
    return HopFates(
        sent=sent,
        taken=taken,
        overwritten=overwritten,
        unused=rows.size - taken - overwritten,
        on_the_way=sent - rows.size - too_late,
        too_late=too_late,
        rows=rows,
        duplicates=measured.size - rows.size,
        out_of_order=int(np.count_nonzero(np.diff(hop.seq[rows]) < 0)),
    )
