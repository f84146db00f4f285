"""Ages: how old the data at the end of a path of topics is."""

from functools import partial

from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.spans import series, times

STREAM = StreamKind(
    word="age",
    suite="observed_ages",
    summary="age of the data at the end of a path of topics",
    columns=("begin_ns", "end_ns"),
    named_by="path",
    words=("{path}", "to {publisher}", "-> {sink}"),
    at="end_ns",
    is_of_topologies=True,
)
KIND = MeasurementKind(
    series=partial(series, "age"),
    called={"age": "age"},
    times=times,
    subject="along the path",
    stream=STREAM,
)
