"""Paths: how long after the first topic of a path its last topic reacted."""

from functools import partial

from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.spans import series, times

STREAM = StreamKind(
    word="path",
    suite="observed_paths",
    summary="reaction time along a path of topics",
    columns=("begin_ns", "end_ns"),
    named_by="path",
    is_plain=True,
    words=("{path}", "to {publisher}", "-> {sink}"),
    at="end_ns",
    is_shown=True,
    is_traced=True,
)
KIND = MeasurementKind(
    series=partial(series, "reaction"),
    called={"reaction": "reaction"},
    times=times,
    subject="along the path",
    stream=STREAM,
)
