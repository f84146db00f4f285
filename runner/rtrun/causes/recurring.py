"""Late values at a fixed distance, which need no trace: from the samples of a run."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtrun.analysis.order.recurrence import Recurrence, counts_tried, find_recurrence
from rtrun.causes.measured import read_measured
from rtrun.kinds.lateness import Measure
from rtrun.kinds.values import Int64s
from rtrun.results.record import RunRecord

# In a shorter run the highest values are not rare.
VALUES_AT_LEAST = 1000
CLEARLY = 0.01


@dataclass(frozen=True, kw_only=True, slots=True)
class Recurring:
    """The late values of an output come in periods of time or, if `in_loops`, of loops."""

    run: str
    output: str
    in_loops: bool
    recurrence: Recurrence


def recurring(folder: Path, record: RunRecord, measure: Measure | None = None) -> Iterator[Recurring]:
    """Yield the outputs of a run whose late values have a period; `measure` and errors are those of `read_measured`."""
    for measured in read_measured(folder, record, measure):
        if measured.values_ns.size < VALUES_AT_LEAST:
            continue
        highest = _highest(measured.values_ns, max(counts_tried(measured.values_ns.size)))
        in_time = _search(measured.times_ns, highest)
        in_loops = _search(measured.index, highest)
        # If both fit, as with a fixed period, the time is what people search for.
        is_loops = in_loops is not None and (in_time is None or in_loops.p_value < CLEARLY * in_time.p_value)
        best = in_loops if is_loops else in_time
        if best is not None:
            yield Recurring(run=record.run, output=measured.output, in_loops=is_loops, recurrence=best)


def _highest(values_ns: Int64s, count: int) -> Int64s:
    """The places of the `count` highest values, the highest first."""
    places = np.argpartition(values_ns, values_ns.size - count)[values_ns.size - count :]
    return np.asarray(places[np.argsort(values_ns[places], kind="stable")[::-1]])


def _search(positions: Int64s, highest: Int64s) -> Recurrence | None:
    begin, end = int(positions.min()), int(positions.max()) + 1
    return find_recurrence(positions[highest], begin=begin, end=end, values=positions.size, searches=2)
