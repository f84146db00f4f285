"""A cyclic timer: how late its callbacks came, and how far apart two of them were."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.errors import UsageError
from rtrun.kinds.kind import LogForm, MeasurementKind
from rtrun.kinds.rows import MAX_ABSENT, Columns, Stated, agree, check_times, check_wall_times, without
from rtrun.kinds.values import IndexedValues, Int64s, no_values

LATENESS, JITTER, GRID = "lateness", "jitter", "grid"
"""Its series."""
# Clocks that NTP disciplines drift from others by 500 ppm at most.
_NTP_DRIFT = 5e-4
# This many calls in a row are never all interrupted between their two stamps.
_FEW_CALLS = 16
_LEAST_STEP_NS = 1_000_000  # by more, NTP steps a clock; by less, it slews it


def _series(columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    """Lateness of each call, jitter of each period, and the grid from the first timestamp; all from the second on."""
    timestamp = np.asarray(columns["timestamp_ns"])
    check_times(path, timestamp)
    agree(path, "measured periods", max(len(timestamp) - 1, 0), stated.measured)
    index = np.arange(max(len(timestamp) - 1, 0))
    passed_ns = timestamp[1:] - timestamp[:1] if len(timestamp) else timestamp
    frequency_hz = _frequency_hz(stated, path)
    period_ns = _grid_ns(1, frequency_hz)
    return {
        LATENESS: _lateness(columns, stated, path, period_ns),
        JITTER: IndexedValues(values_ns=np.diff(timestamp) - period_ns, index=index),
        GRID: IndexedValues(values_ns=passed_ns - _grid_ns(index + 1, frequency_hz), index=index),
    }


def _lateness(columns: Columns, stated: Stated, path: Path, period_ns: int) -> IndexedValues:
    """How late each call is on the grid of the middleware; skipped periods are absent.

    roscpp moves its grid when it is two periods behind, rcl when it is one. The whole periods of such a move count as
    skipped, the rest as lateness of the call there. So a move of the grid hides nothing.
    """
    expected, real = np.asarray(columns["expected_ns"]), np.asarray(columns["real_ns"])
    check_wall_times(path, expected, real)
    passed = np.diff(expected)
    skipped = np.maximum(passed // period_ns - 1, 0)
    values = (real - expected)[1:] + np.where(passed > period_ns, passed % period_ns, 0)
    check_times(path, values)
    total = int(skipped.sum(dtype=np.float64))
    if total > MAX_ABSENT:
        raise UsageError(
            f"{path}: {total} periods were skipped: none with more than {MAX_ABSENT} is read; was the wall clock set?"
        )
    if stated.skipped is not None:
        agree(path, "skipped", total, stated.skipped)
    # The loop of each call, counted with the periods that were skipped before it.
    loops = np.arange(values.size) + np.cumsum(skipped)
    return IndexedValues(
        values_ns=values,
        index=np.arange(values.size),
        absent=without(loops, int(loops[-1]) + 1) if total else no_values(),
        undecidable=_clock_was_set(real - np.asarray(columns["timestamp_ns"]), period_ns),
    )


def _clock_was_set(offset: Int64s, period_ns: int) -> str:
    """Why calls cannot be judged as late or in time: the timer's grid jumped with the wall clock. Empty if it did not.

    `offset`, int64 (n,), is the wall clock minus the clock of the timestamps; slightly lower if a thread was
    interrupted between the two stamps of a call. So its highest value among a few calls shows whether one of the clocks
    was set.
    """
    if not offset.size:
        return ""
    highest = np.maximum.reduceat(offset, np.arange(0, max(1, offset.size - _FEW_CALLS + 1), _FEW_CALLS))
    most_ns = int(np.abs(np.diff(highest)).max(initial=0))
    if most_ns <= max(_LEAST_STEP_NS, period_ns) + _NTP_DRIFT * period_ns * _FEW_CALLS:
        return ""
    return (
        f"the wall clock, by which the timer keeps its grid, was set by {most_ns / 1e6:.3g} ms while it was measured: "
        "measure again when it is not (NTP steps it after a boot), or ask for the jitter (--of jitter)"
    )


def _grid_ns(periods: Any, frequency_hz: int) -> Any:
    """The length of `periods`, an int or an array, to the nearest nanosecond; in whole numbers, so it never drifts."""
    return (2 * periods * 10**9 + frequency_hz) // (2 * frequency_hz)


def _frequency_hz(stated: Stated, path: Path) -> int:
    frequency_hz = stated.requested.get("frequency_hz")
    if not isinstance(frequency_hz, int):
        raise UsageError(
            f"{path.with_suffix('.json')}: requested.frequency_hz: must be a whole number, got {frequency_hz!r}"
        )
    return frequency_hz


def _times(columns: Columns, values: IndexedValues) -> Int64s:
    # The first row is the origin of the first period.
    return np.asarray(columns["timestamp_ns"][values.index + 1])


KIND = MeasurementKind(
    series=_series,
    called={LATENESS: "lateness", JITTER: "jitter"},
    times=_times,
    subject="of the timer",
    # The first two periods.
    startup={LATENESS: 2, JITTER: 2, GRID: 2},
    clustered={JITTER: "successive", GRID: GRID},
    layer_below="cyclictest",
    logs=LogForm(
        suite="cyclic_timer_tests",
        main=JITTER,
        summary=re.compile(r"with a total of ([0-9]{1,12}) measurements"),
        series={"": JITTER},
        labels={"Jitter:": JITTER},
    ),
)
