"""Loops: how late a thread runs that sleeps until a time, whichever call it sleeps in."""

from pathlib import Path

import numpy as np

from rtfiles.errors import UsageError
from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.rows import MAX_ABSENT, Columns, Stated, agree, check_uptimes, not_come, times_in, without
from rtrun.kinds.values import IndexedValues


def _series(columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    """How late each activation ran; the periods that were skipped are absent."""
    due, running, skipped = (np.asarray(columns[name]) for name in ("due_ns", "running_ns", "skipped"))
    rows = due.size
    check_uptimes(path, due, running)
    agree(path, "measured", rows, stated.measured)
    overdue = not_come(stated, rows, rows, "activations did not come", path)
    if rows and int(skipped.min()) < 0:
        raise UsageError(f"{path}: row {int(skipped.argmin())}: less than no period was skipped")
    if (total := int(skipped.sum(dtype=np.float64))) > MAX_ABSENT:
        raise UsageError(f"{path}: {total} periods were skipped: none with more than {MAX_ABSENT} is read")
    absent = without(np.arange(rows) + np.cumsum(skipped), rows + total + overdue.size)
    return {"lateness": IndexedValues(values_ns=running - due, index=np.arange(rows), absent=absent)}


STREAM = StreamKind(
    word="loop",
    suite="observed_loops",
    summary="how late threads run that sleep until a time",
    columns=("due_ns", "interrupt_ns", "waking_ns", "running_ns", "skipped"),
    named_by="program",
    narrowed_by="thread",
    words=("{program}/{thread}", "({clock} clock)"),
    at="running_ns",
    overdue="it was due {} ago and has not run, though its program lives",
    is_shown=True,
    live_words=("loop", "activation"),
    is_traced=True,
)
KIND = MeasurementKind(
    series=_series,
    called={"lateness": "lateness"},
    times=times_in("running_ns"),
    subject="of the loop",
    stream=STREAM,
)
