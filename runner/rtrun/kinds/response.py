"""Responses: how long after its due time a node of a topology had done its work."""

from functools import partial

from rtrun.kinds.kind import MeasurementKind, StreamKind
from rtrun.kinds.spans import series, times

STREAM = StreamKind(
    word="response",
    suite="observed_responses",
    summary="how long after it was due a node of a topology has done its work",
    columns=("begin_ns", "end_ns"),
    named_by="node",
    words=("of {node}",),
    at="end_ns",
    is_of_topologies=True,
)
KIND = MeasurementKind(
    series=partial(series, "response"),
    called={"response": "response"},
    times=times,
    subject="of the node",
    stream=STREAM,
)
