"""Spans: what kinds share if their values have a begin and an end."""

from functools import partial
from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.lateness import Measure
from rtrun.kinds.rows import MAX_ABSENT, Columns, Stated, agree, check_times, times_in
from rtrun.kinds.values import IndexedValues


def spans(name: str, columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    """How long each span took, as a series of this name."""
    begin, end = columns["begin_ns"], columns["end_ns"]
    check_times(path, begin, end)
    agree(path, "measured", len(begin), stated.measured)
    agree(path, "missing", stated.asked - len(begin), stated.missing)
    if stated.missing > MAX_ABSENT:
        raise UsageError(f"{path}: {stated.missing} never ended: none with more than {MAX_ABSENT} is read")
    values = np.asarray(end - begin)
    if values.size and int(values.min()) < 0:
        raise UsageError(f"{path}: row {int(values.argmin())} ends before it begins")
    # A span that never ended is known only by its number: it counts as late, after all the others.
    absent = np.arange(values.size, values.size + stated.missing)
    return {name: IndexedValues(values_ns=values, index=np.arange(values.size), absent=absent)}


def kind_of_spans(
    measure: Measure, subject: str, stream: StreamKind, *, is_of_callbacks: bool = False
) -> MeasurementKind:
    """A kind whose one series, by the name of its measure, is how long its spans took."""
    return MeasurementKind(
        series=partial(spans, measure),
        called={measure: measure},
        times=times_in("end_ns"),
        subject=subject,
        stream=stream,
        is_of_callbacks=is_of_callbacks,
    )
