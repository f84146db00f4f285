"""Late values at a fixed distance, which need no trace: from the samples of a run."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtrun.analysis.histogram import Int64s
from rtrun.analysis.recurrence import Recurrence, find_recurrence
from rtrun.causes.measured import read_measured
from rtrun.results.record import RunRecord

# What counts as late: the highest thousandth of a run's values, within these numbers.
LATE_AT_LEAST, LATE_AT_MOST = 50, 500
# Of a shorter run the highest values are no rare ones.
VALUES_AT_LEAST = 20 * LATE_AT_LEAST
CLEARLY = 0.01


@dataclass(frozen=True, kw_only=True, slots=True)
class Recurring:
    """The late values of an output come in periods of time or, if `in_loops`, of loops."""

    run: str
    output: str
    late: int
    in_loops: bool
    recurrence: Recurrence


def recurring(folder: Path, record: RunRecord) -> Iterator[Recurring]:
    """Yield the outputs of a run whose late values have a period. Raises UsageError as `read_measured` does."""
    for measured in read_measured(folder, record):
        number = measured.values_ns.size
        if number < VALUES_AT_LEAST:
            continue
        late = min(LATE_AT_MOST, max(LATE_AT_LEAST, number // 1000))
        places = np.argpartition(measured.values_ns, number - late)[number - late :]
        in_time = _search(measured.times_ns, places)
        in_loops = _search(measured.index, places)
        # Where both fit, as with a fixed period, the time is what people look for.
        is_loops = in_loops is not None and (in_time is None or in_loops.p_value < CLEARLY * in_time.p_value)
        best = in_loops if is_loops else in_time
        if best is not None:
            yield Recurring(run=record.run, output=measured.output, late=late, in_loops=is_loops, recurrence=best)


def _search(positions: Int64s, places: Int64s) -> Recurrence | None:
    begin, end = int(positions.min()), int(positions.max()) + 1
    loop = max(1, (end - begin) // positions.size)
    return find_recurrence(np.sort(positions[places]), begin=begin, end=end, loop=loop, tried=2)
