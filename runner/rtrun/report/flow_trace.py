"""Messages and callbacks of observed programs as a trace that ui.perfetto.dev opens: Chrome's JSON format.

Slices are complete events (``X``), which nest on their thread. A message is an arrow (``s``, ``f``) from the slice
where it was published to the slice where it was received. Google's "Trace Event Format" names the fields.
"""

import json
from collections.abc import Iterable, Iterator
from typing import Any

from rtfiles.output import counted, printable
from rtrun.flows.recorder import FlowRecorder
from rtrun.probes.hits import ObservedProgram

# An arrow begins and ends at a slice. A moment gets the shortest slice, so that it lies within its callback.
_MOMENT_NS = 1


def flow_trace(recorder: FlowRecorder, programs: Iterable[ObservedProgram]) -> str:
    """The trace as JSON, times in microseconds of CLOCK_MONOTONIC; `programs` name themselves and their threads."""
    slices = sorted(_slices(recorder), key=lambda event: event["ts"])
    trace = {"traceEvents": [*_names(programs), *slices], "displayTimeUnit": "ns", "otherData": {}}
    if recorder.left_out:
        left_out = f"{counted(recorder.left_out, 'event')} left out, after the first {recorder.limit}"
        trace["otherData"] = {"left_out": left_out}
    return json.dumps(trace, indent=None, separators=(",", ":"))


def _slices(recorder: FlowRecorder) -> Iterator[dict[str, Any]]:
    for callback in recorder.callbacks:
        yield _slice(callback.name, callback.pid, callback.tid, callback.cpu, callback.begin_ns, callback.end_ns)
    for number, message in enumerate(recorder.messages, start=1):
        topic = printable(message.topic)
        ends = (
            ("s", "publish", message.from_pid, message.from_tid, message.from_cpu, message.publication_ns),
            ("f", "take", message.to_pid, message.to_tid, message.to_cpu, message.reception_ns),
        )
        for phase, what, pid, tid, cpu, at_ns in ends:
            yield _slice(f"{what} {topic}", pid, tid, cpu, at_ns, at_ns + _MOMENT_NS)
            arrow = {"ph": phase, "name": topic, "cat": "message", "id": number, "pid": pid, "tid": tid}
            # It ends at the slice that encloses it, not at the next one.
            yield arrow | {"ts": at_ns / 1000} | ({"bp": "e"} if phase == "f" else {})


def _slice(name: str, pid: int, tid: int, cpu: int, begin_ns: int, end_ns: int) -> dict[str, Any]:
    return {
        "ph": "X",
        "name": printable(name),
        "cat": "callback" if end_ns - begin_ns > _MOMENT_NS else "message",
        "pid": pid,
        "tid": tid,
        "ts": begin_ns / 1000,
        "dur": (end_ns - begin_ns) / 1000,
        "args": {"cpu": cpu},
    }


def _names(programs: Iterable[ObservedProgram]) -> Iterator[dict[str, Any]]:
    for program in programs:
        yield _name("process_name", program.pid, program.pid, program.name)
        for thread in program.threads:
            yield _name("thread_name", program.pid, thread.tid, thread.name)


def _name(what: str, pid: int, tid: int, name: str) -> dict[str, Any]:
    return {"ph": "M", "name": what, "pid": pid, "tid": tid, "args": {"name": printable(name)}}
