"""Spans: how long something took that has a begin and an end, as a callback, or the reaction along a path of topics."""

from functools import partial
from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.analysis.histogram import Int64s
from rtrun.kinds.kind import Columns, MeasurementKind
from rtrun.kinds.output import IndexedValues, Record
from rtrun.kinds.rows import MAX_ABSENT, agree, check_times


def _series(name: str, columns: Columns, record: Record, path: Path) -> dict[str, IndexedValues]:
    begin, end = columns["begin_ns"], columns["end_ns"]
    check_times(path, begin, end)
    agree(path, "measured", len(begin), record.counts.measured)
    agree(path, "missing", record.counts.asked - len(begin), record.counts.missing)
    if record.counts.missing > MAX_ABSENT:
        raise UsageError(f"{path}: {record.counts.missing} never ended: none with more than {MAX_ABSENT} is read")
    values = np.asarray(end - begin)
    if values.size and int(values.min()) < 0:
        raise UsageError(f"{path}: row {int(values.argmin())} ends before it begins")
    # What never ended is known by its number alone: it counts as late, after all the others.
    absent = np.arange(values.size, values.size + record.counts.missing)
    return {name: IndexedValues(values_ns=values, index=np.arange(values.size), absent=absent)}


def _times(columns: Columns, values: IndexedValues) -> Int64s:
    return np.asarray(columns["end_ns"][values.index])


CALLBACK = MeasurementKind(
    series=partial(_series, "duration"), called={"duration": "duration"}, times=_times, subject="of the callback"
)
PATH = MeasurementKind(
    series=partial(_series, "reaction"), called={"reaction": "reaction"}, times=_times, subject="along the path"
)
RESPONSE = MeasurementKind(
    series=partial(_series, "response"), called={"response": "response"}, times=_times, subject="of the node"
)
AGE = MeasurementKind(series=partial(_series, "age"), called={"age": "age"}, times=_times, subject="along the path")
