"""Services: how long a client waited for each answer, and which part of that was whose."""

from pathlib import Path

import numpy as np

from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.messages import LATENCY, NOT_SEEN_NS
from rtrun.kinds.rows import Columns, Stated, check_times, times_in
from rtrun.kinds.spans import spans
from rtrun.kinds.values import IndexedValues

_PARTS = {
    "there": ("begin_ns", "taken_ns"),
    "work": ("taken_ns", "answered_ns"),
    "back": ("answered_ns", "end_ns"),
}
"""Each part of the time that a client waited: from when until when."""


def _series(columns: Columns, stated: Stated, path: Path) -> dict[str, IndexedValues]:
    series = spans(LATENCY, columns, stated, path)
    for part, (begin, end) in _PARTS.items():
        is_seen = (columns[begin] != NOT_SEEN_NS) & (columns[end] != NOT_SEEN_NS)
        index = np.flatnonzero(is_seen)
        values = columns[end][index] - columns[begin][index]
        check_times(path, values)
        series[part] = IndexedValues(values_ns=values, index=index)
    return series


STREAM = StreamKind(
    word="service",
    suite="observed_services",
    summary="calls of services of programs that run already, from the request to its answer",
    columns=("begin_ns", "end_ns", "taken_ns", "answered_ns"),
    named_by="service",
    words=("{service}", "{client}", "-> {server}"),
    at="end_ns",
    overdue="a request was sent {} ago and has no answer, though its client lives",
    is_shown=True,
)
KIND = MeasurementKind(
    series=_series,
    called={LATENCY: "latency"},
    times=times_in("end_ns"),
    subject="of the service",
    stream=STREAM,
)
