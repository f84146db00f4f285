"""Spans: what kinds share if their values have a begin and an end."""

from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.kinds.rows import MAX_ABSENT, Columns, Stated, agree, check_times
from rtrun.kinds.values import IndexedValues, Int64s


def series(name: str, columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
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


def times(columns: Columns, values: IndexedValues) -> Int64s:
    return np.asarray(columns["end_ns"][values.index])
