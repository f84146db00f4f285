"""Intervals: the time between two messages of a topic."""

from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.rows import Columns, Stated, agree, check_times, not_come, times_in, within_segments
from rtrun.kinds.values import IndexedValues


def _series(columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    timestamp = np.asarray(columns["timestamp_ns"])
    check_times(path, timestamp)
    # The first row of a segment is the origin of its first interval.
    row = np.flatnonzero(within_segments(columns["segment"], timestamp.size)) + 1
    values = timestamp[row] - timestamp[row - 1]
    agree(path, "measured", values.size, stated.measured)
    absent = not_come(stated, values.size, timestamp.size, "intervals have not ended", path)
    if values.size and int(values.min()) < 0:
        raise UsageError(f"{path}: the time of row {int(row[values.argmin()])} is before that of the row before")
    return {"interval": IndexedValues(values_ns=values, index=row, absent=absent)}


STREAM = StreamKind(
    word="interval",
    suite="observed_intervals",
    summary="time between two messages of a topic",
    columns=("timestamp_ns", "segment"),
    named_by="topic",
    words=("{topic}", "at {end}", "{node}"),
    at="timestamp_ns",
    is_between_rows=True,
    filled={"segment": 0},
    overdue="no message in the last {}, though its program lives",
)
KIND = MeasurementKind(
    series=_series,
    called={"interval": "interval"},
    times=times_in("timestamp_ns"),
    subject="between messages",
    stream=STREAM,
)
