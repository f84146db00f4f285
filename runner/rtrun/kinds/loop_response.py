"""Responses of loops: from the time at which a thread was due until it sleeps until its next time."""

from rtrun.kinds.kind import StreamKind
from rtrun.kinds.spans import kind_of_spans

STREAM = StreamKind(
    word="loop-response",
    suite="observed_loop_responses",
    summary="how long after they were due threads sleep again that sleep until a time",
    columns=("begin_ns", "end_ns", "run_ns"),
    named_by="program",
    narrowed_by="thread",
    words=("{program}/{thread}", "({clock} clock)"),
    at="end_ns",
    overdue="it was due {} ago and has not slept again",
)
KIND = kind_of_spans("response", "of the loop", STREAM)
