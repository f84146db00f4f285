"""A timer of a program that runs already: how late its calls came on its own grid, and the jitter of its periods."""

from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.rows import (
    MAX_ABSENT,
    Columns,
    Stated,
    agree,
    check_times,
    check_wall_times,
    not_come,
    times_in,
    within_segments,
    without,
)
from rtrun.kinds.values import IndexedValues, Int64s, no_values

UNKNOWN_NS = -1
"""Instead of the time at which a call was due, if that is not known."""
_NOT_KNOWN = "when the timer was due is not known: ask for the jitter (--of jitter)"


def _series(columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    """Lateness of each call, and jitter of each period, which the first call of a segment does not end."""
    called, period_ns = np.asarray(columns["timestamp_ns"]), _period_ns(stated, path)
    check_times(path, called)
    row = np.flatnonzero(within_segments(columns["segment"], called.size)) + 1
    agree(path, "measured periods", row.size, stated.measured)
    absent = not_come(stated, row.size, called.size, "calls did not come", path)
    jitter = IndexedValues(values_ns=called[row] - called[row - 1] - period_ns, index=row, absent=absent)
    return {"lateness": _lateness(columns, row, period_ns, absent.size, path), "jitter": jitter}


def _lateness(columns: Columns, row: Int64s, period_ns: int, overdue: int, path: Path) -> IndexedValues:
    """How late each call is on the grid of the timer; periods without a call are absent."""
    due, real = np.asarray(columns["expected_ns"]), np.asarray(columns["real_ns"])
    rows = due.size
    if np.any(due == UNKNOWN_NS):
        return IndexedValues(values_ns=no_values(), index=no_values(), undecidable=_NOT_KNOWN)
    check_wall_times(path, due, real)
    check_times(path, real - due)
    # To the nearest period: the grid of a timer moves by whole periods, except for the rounding of its clock.
    skipped = np.zeros(rows, np.int64)
    skipped[row] = np.maximum((due[row] - due[row - 1] + period_ns // 2) // period_ns - 1, 0)
    if (total := int(skipped.sum(dtype=np.float64))) > MAX_ABSENT:
        raise UsageError(f"{path}: {total} periods were skipped: none with more than {MAX_ABSENT} is read")
    loops = np.arange(rows) + np.cumsum(skipped)
    absent = without(loops, rows + total + overdue)
    return IndexedValues(values_ns=real - due, index=np.arange(rows), absent=absent)


def _period_ns(stated: Stated, path: Path) -> int:
    period_ns = stated.requested.get("period_ns")
    if not isinstance(period_ns, int) or not 0 < period_ns < 1 << 62:
        raise UsageError(f"{path.with_suffix('.json')}: requested.period_ns: a whole number above 0, got {period_ns!r}")
    return period_ns


STREAM = StreamKind(
    word="timer",
    suite="observed_timers",
    summary="timers of programs that run already",
    columns=("timestamp_ns", "expected_ns", "real_ns", "segment"),
    named_by="node",
    # Its name begins with what it is, and has its period.
    begins_with="timer",
    words=("of {node}", "({clock} clock)"),
    hidden=("period_ns",),
    at="timestamp_ns",
    is_between_rows=True,
    filled={"segment": 0, "expected_ns": UNKNOWN_NS, "real_ns": "timestamp_ns"},
    has_period=True,
    overdue="a call was due {} ago and did not come, though its program lives: it hangs, or was cancelled",
    is_shown=True,
    live_words=("timer", ""),
    is_traced=True,
)
KIND = MeasurementKind(
    series=_series,
    called={"lateness": "lateness", "jitter": "jitter"},
    times=times_in("timestamp_ns"),
    subject="of the timer",
    stream=STREAM,
)
