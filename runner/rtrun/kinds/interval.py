"""Intervals: the time between two messages of a topic."""

from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.analysis.histogram import Int64s
from rtrun.kinds.kind import Columns, MeasurementKind
from rtrun.kinds.output import IndexedValues, Record
from rtrun.kinds.rows import agree, check_times, not_come, within_segments


def _series(columns: Columns, record: Record, path: Path) -> dict[str, IndexedValues]:
    timestamp = np.asarray(columns["timestamp_ns"])
    check_times(path, timestamp)
    # The first row of a segment is the origin of its first interval.
    row = np.flatnonzero(within_segments(columns["segment"], timestamp.size)) + 1
    values = timestamp[row] - timestamp[row - 1]
    agree(path, "measured", values.size, record.counts.measured)
    absent = not_come(record, values.size, timestamp.size, "intervals have not ended", path)
    if values.size and int(values.min()) < 0:
        raise UsageError(f"{path}: the time of row {int(row[values.argmin()])} is before that of the row before")
    return {"interval": IndexedValues(values_ns=values, index=row, absent=absent)}


def _times(columns: Columns, values: IndexedValues) -> Int64s:
    return np.asarray(columns["timestamp_ns"][values.index])


KIND = MeasurementKind(series=_series, called={"interval": "interval"}, times=_times, subject="between messages")
