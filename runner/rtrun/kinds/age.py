"""Ages: how old the data at the end of a path of topics is."""

from rtrun.kinds.kind import StreamKind
from rtrun.kinds.spans import kind_of_spans

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
KIND = kind_of_spans("age", "along the path", STREAM)
