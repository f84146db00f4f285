"""Callbacks: how long one took."""

from rtrun.kinds.kind import StreamKind
from rtrun.kinds.spans import kind_of_spans

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
KIND = kind_of_spans("duration", "of the callback", STREAM, is_of_callbacks=True)
