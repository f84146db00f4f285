"""What the kinds have in common: rows of samples checked against the counts and against what times can be."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtfiles.errors import UsageError
from rtrun.kinds.limits import TIME_MAX_NS, WALL_TIME_MAX_NS
from rtrun.kinds.values import Int64s, pieces

Columns = Mapping[str, Int64s]


@dataclass(frozen=True, kw_only=True, slots=True)
class Stated:
    """What the json beside the samples says of them: how many were asked for, and what became of them.

    `skipped` are periods in which nothing came, None where that is not said; `requested` are the parameters.
    """

    asked: int
    measured: int
    not_fired: int
    missing: int
    out_of_order: int
    skipped: int | None
    is_complete: bool
    requested: Mapping[str, object]


MAX_ABSENT = 10_000_000  # loops without a value, so that they fit into memory


def disagree(path: Path) -> str:
    return f"{path} and {path.with_suffix('.json').name} disagree"


def agree(path: Path, what: str, rows: int, counts: int) -> None:
    if rows != counts:
        raise UsageError(f"{disagree(path)}: {what}: {rows} in the rows, {counts} in the counts")


def check_times(path: Path, *columns: Int64s) -> None:
    for column in columns:
        for piece in pieces(column.size):
            part = np.ascontiguousarray(column[piece])  # a row after the other in the file: a copy is searched faster
            if int(part.min()) < -TIME_MAX_NS or int(part.max()) > TIME_MAX_NS:
                raise UsageError(f"{path}: a time beyond {TIME_MAX_NS} ns cannot be")


def check_uptimes(path: Path, *columns: Int64s) -> None:
    """Times of a clock that counts from the start of the target: what lies between two of them is a time, too."""
    check_times(path, *columns)
    if any(column.size and int(column.min()) < 0 for column in columns):
        raise UsageError(f"{path}: a time before the target started cannot be")


def check_wall_times(path: Path, *columns: Int64s) -> None:
    """Times of a clock that may count from 1970, as ROS time does."""
    for column in columns:
        if column.size and not 0 <= int(column.min()) <= int(column.max()) <= WALL_TIME_MAX_NS:
            raise UsageError(f"{path}: a time of the wall clock below 0 or above {WALL_TIME_MAX_NS} ns cannot be")


def within_segments(segment: Int64s | None, rows: int) -> NDArray[np.bool_]:
    """Of each row but the first whether it follows the one before it without a gap, shape (rows - 1,).

    `segment`, shape (rows,), numbers what was seen without a gap; None: there was none.
    """
    if segment is None:
        return np.ones(max(rows - 1, 0), dtype=bool)
    return np.asarray(segment[1:] == segment[:-1])


def not_come(stated: Stated, measured: int, rows: int, what: str, path: Path) -> Int64s:
    """The number of a value that had not come when the observation ended, beyond its deadline already: int64, 0 or 1.

    `what` names them, for the UsageError that is raised then.
    """
    missing = stated.missing
    agree(path, "missing", stated.asked - measured, missing)
    if missing > 1:
        raise UsageError(f"{path}: {missing} {what}: only the last one may")
    return np.arange(rows, rows + missing)


def without(present: Int64s, number: int) -> Int64s:
    """Which of so many loops are not among those present, ascending."""
    absent = np.ones(number, dtype=bool)
    absent[present] = False
    return np.flatnonzero(absent).astype(np.int64)
