"""Responses: how long after its due time a node of a topology had done its work."""

from rtrun.kinds.kind import StreamKind
from rtrun.kinds.spans import kind_of_spans

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
KIND = kind_of_spans("response", "of the node", STREAM)
