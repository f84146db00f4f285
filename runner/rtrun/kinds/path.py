"""Paths: how long after the first topic of a path its last topic reacted."""

from rtrun.kinds.kind import StreamKind
from rtrun.kinds.spans import kind_of_spans

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
KIND = kind_of_spans("reaction", "along the path", STREAM)
