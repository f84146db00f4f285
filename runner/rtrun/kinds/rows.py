"""What the kinds share: checks of the rows of samples against the counts, and against the possible range of times."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtfiles.errors import UsageError
from rtrun.kinds.limits import TIME_MAX_NS, WALL_TIME_MAX_NS
from rtrun.kinds.values import IndexedValues, Int64s, pieces

Columns = Mapping[str, Int64s]


@dataclass(frozen=True, kw_only=True, slots=True)
class Stated:
    """What the json next to the samples states about them: how many were requested, and what became of them.

    `skipped` counts periods in which nothing came, None if that is not stated; `requested` are the parameters.
    """

    asked: int
    measured: int
    not_fired: int
    missing: int
    out_of_order: int
    skipped: int | None
    is_complete: bool
    requested: Mapping[str, object]


MAX_ABSENT = 10_000_000  #: loops of a run without a value, so that they fit into memory


def disagree(path: Path) -> str:
    return f"{path} and {path.with_suffix('.json').name} disagree"


def agree(path: Path, what: str, rows: int, counts: int) -> None:
    if rows != counts:
        raise UsageError(f"{disagree(path)}: {what}: {rows} in the rows, {counts} in the counts")


def check_times(path: Path, *columns: Int64s) -> None:
    for column in columns:
        for piece in pieces(column.size):
            part = np.ascontiguousarray(column[piece])  # the file is stored by rows: a copy is searched faster
            if int(part.min()) < -TIME_MAX_NS or int(part.max()) > TIME_MAX_NS:
                raise UsageError(f"{path}: a time beyond {TIME_MAX_NS} ns cannot be")


def check_uptimes(path: Path, *columns: Int64s) -> None:
    """Check times of a clock that counts from the start of the target: the time between two of them is valid, too."""
    check_times(path, *columns)
    if any(column.size and int(column.min()) < 0 for column in columns):
        raise UsageError(f"{path}: a time before the target started cannot be")


def check_wall_times(path: Path, *columns: Int64s) -> None:
    """Check times of a clock that may count from 1970, as ROS time does."""
    for column in columns:
        if column.size and not 0 <= int(column.min()) <= int(column.max()) <= WALL_TIME_MAX_NS:
            raise UsageError(f"{path}: a time of the wall clock below 0 or above {WALL_TIME_MAX_NS} ns cannot be")


def within_segments(segment: Int64s | None, rows: int) -> NDArray[np.bool_]:
    """Whether each row but the first follows the row before it without a gap, shape (rows - 1,).

    `segment`, shape (rows,), numbers the pieces without a gap; None: there was no gap.
    """
    if segment is None:
        return np.ones(max(rows - 1, 0), dtype=bool)
    return np.asarray(segment[1:] == segment[:-1])


def not_come(stated: Stated, measured: int, rows: int, what: str, path: Path) -> Int64s:
    """The index of the value that was overdue when the observation ended, if there is one: int64, (0,) or (1,).

    Raises UsageError, with `what` as the name of such values, if there is more than one.
    """
    missing = stated.missing
    agree(path, "missing", stated.asked - measured, missing)
    if missing > 1:
        raise UsageError(f"{path}: {missing} {what}: only the last one may")
    return np.arange(rows, rows + missing)


def without(present: Int64s, number: int) -> Int64s:
    """The loops, of `number` in all, that are not in `present`; ascending."""
    absent = np.ones(number, dtype=bool)
    absent[present] = False
    return np.flatnonzero(absent).astype(np.int64)


def times_in(column: str) -> Callable[[Columns, IndexedValues], Int64s]:
    """When values were measured whose index is their row, by this column."""
    return lambda columns, values: np.asarray(columns[column][values.index])
