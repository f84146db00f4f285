"""Callbacks: how long one took."""

from functools import partial

from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.spans import series, times

STREAM = StreamKind(
    word="callback",
    suite="observed_callbacks",
    summary="how long callbacks take in programs that run already",
    columns=("begin_ns", "end_ns"),
    named_by="node",
    words=("{callback}", "of {node}", "(thread {thread})"),
    usual={"thread": 1},
    at="end_ns",
    overdue="a call began {} ago and has not ended",
    is_traced=True,
)
KIND = MeasurementKind(
    series=partial(series, "duration"),
    called={"duration": "duration"},
    times=times,
    subject="of the callback",
    stream=STREAM,
    is_of_callbacks=True,
)
