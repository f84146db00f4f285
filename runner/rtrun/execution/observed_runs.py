"""What was observed of programs becomes runs like any other: a run directory for each stream, and one of it all."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.output import listed
from rtrun.analysis.histogram import Int64s
from rtrun.execution import clock_record
from rtrun.execution.late_values import LateValue, LateValues
from rtrun.execution.observation import ObservationResult
from rtrun.flows.hazards import hazards
from rtrun.flows.streams import streams
from rtrun.flows.values import Stream, differences
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.output import Thread, Uname
from rtrun.kinds.timer import UNKNOWN_NS
from rtrun.plan.observation import StreamDeadline, StreamKind
from rtrun.plan.run import UNTRACED, Run
from rtrun.plan.suites import Value
from rtrun.plan.trace import PARAMETER
from rtrun.probes.hits import ObservedProgram
from rtrun.results import run_directory
from rtrun.results.observed import (
    Graph,
    ObservedOutput,
    PlacedEvent,
    Provenance,
    RefusedEvent,
    TracedValue,
    write_graph,
    write_stream,
)
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus
from rtrun.targets.inspection.facts import TargetState, fact_text

# Parameters that name programs.
_PARTIES = ("publisher", "subscriber", "node")
# A number and what tells streams apart, in a name that file systems take.
_NAME_MAX = 100
_NAMES_SHOWN = 8


def write(
    partial: Path, folder: Path, run: Run, record: RunRecord, state: TargetState, result: ObservationResult
) -> RunRecord:
    """Write a run for each stream beside `folder`, and one for each deadline of what was not seen.

    `record` is that of the run that observed, with what became of it; `partial` is filled with what was placed and
    found. Returns the record that it is to be closed with: it has failed where no stream with a deadline was seen.
    `state` is that of the target. Raises InfrastructureError where they cannot be written.
    """
    assert run.observation is not None
    deadlines = run.observation.deadlines
    record = record.model_copy(
        update={
            "programs": [*record.programs, *map(_program, result.programs)],
            "start_time": result.start_time,
            "end_time": result.end_time,
            # Its streams have traces, and each a limit of its own.
            "trace": run.trace if run.trace == UNTRACED else "",
        }
    )
    of_streams = _StreamFacts(
        run=run, record=record.model_copy(update={"attempt": "", "observed_by": record.run}), state=state, result=result
    )
    names: set[str] = set()
    left_out: list[str] = []
    outputs: list[ObservedOutput] = []
    without_value: list[tuple[Stream, str]] = []
    for stream in streams(result.flows):
        late = result.late.streams.get(stream.source) if result.late else None
        output = _output(stream, late)
        remarks = stream.remarks or (() if output is not None else ("too few calls to be measured",))
        left_out += (f"{' '.join(map(str, stream.identity.values()))}: {remark}" for remark in remarks)
        if output is None:
            without_value.append((stream, "; ".join(remarks)))
            continue
        outputs.append(output)
        _write_run(_beside(folder, output, names), of_streams, output)
    unseen: list[str] = []
    for deadline in deadlines:
        if not any(deadline.is_of(output.suite, output.parameters) for output in outputs):
            why = (text for stream, text in without_value if deadline.is_of(stream.kind.suite, stream.identity))
            reason = f"{deadline.kind} {deadline.name}: {next(why, None) or _not_seen(deadline, outputs)}"
            unseen.append(reason)
            nothing = ObservedOutput(
                suite=deadline.kind.suite,
                parameters={deadline.kind.named_by: deadline.name},
                columns={},
                asked=0,
                measured=0,
            )
            _write_run(_beside(folder, nothing, names), of_streams, nothing, reason=reason)
    if unseen and len(unseen) == len(deadlines) and record.status is RunStatus.OK:
        record = record.model_copy(update={"status": RunStatus.FAILED, "reason": "; ".join(unseen)})
    write_graph(
        partial,
        Graph(
            schema=1,
            placed=[PlacedEvent(event=each.event, path=each.path) for each in result.began.placed],
            refused=[
                RefusedEvent(event=each.event, path=each.path, reason=each.reason) for each in result.began.refused
            ],
            remarks=[*result.remarks, *left_out, *(unseen if record.status is RunStatus.OK else ())],
            hazards=list(hazards(result.programs, with_pids=False)),
        ),
    )
    return record


@dataclass(frozen=True, kw_only=True, slots=True)
class _StreamFacts:
    """What all streams of an observation share."""

    run: Run
    record: RunRecord
    state: TargetState
    result: ObservationResult


def put_aside(folder: Path) -> None:
    """Put aside what an earlier attempt at this run has left of its streams."""
    for path in folder.parent.iterdir():
        if path.name.startswith(f"{folder.name}-") and path.is_dir():
            closed = run_directory.closing_record(path)
            if closed is not None and closed.observed_by == folder.name:
                path.rename(run_directory.unused(path, "old"))


def _not_seen(deadline: StreamDeadline, outputs: Sequence[ObservedOutput]) -> str:
    """That a stream with a deadline was not there, and which of its kind were."""
    seen = dict.fromkeys(
        str(output.parameters[deadline.kind.named_by]) for output in outputs if output.suite == deadline.kind.suite
    )
    others = f"; seen were {listed(seen, _NAMES_SHOWN)}" if seen else ""
    return f"it was not seen{others}"


def _beside(folder: Path, output: ObservedOutput, taken: set[str]) -> Path:
    """A folder for a stream that no other has."""
    words = [output.suite.removeprefix("observed_"), *(str(value) for value in output.parameters.values())]
    plain = re.sub(r"[^A-Za-z0-9._]+", "-", "-".join(words)).strip("-")[:_NAME_MAX]
    name, again = f"{folder.name}-{plain}", 1
    while name in taken:
        again += 1
        name = f"{folder.name}-{plain}-{again}"
    taken.add(name)
    return folder.with_name(name)


def _output(stream: Stream, late: LateValues | None) -> ObservedOutput | None:
    """A stream as its samples hold it, with the traces of its late values; None where it has not one value."""
    columns: dict[str, Int64s] = dict(stream.columns)
    parameters: dict[str, Value] = dict(stream.identity)
    first = next(iter(columns.values()))
    rows = first.size
    lost = stream.counts.get("lost", 0)
    measured = rows
    if stream.kind in (StreamKind.TIMER, StreamKind.INTERVALS):
        segment = np.zeros(rows, np.int64)
        segment[stream.cuts[stream.cuts < rows]] = 1
        columns["segment"] = np.cumsum(segment)
        measured = differences(first, stream.cuts).size
    if stream.kind is StreamKind.TIMER and measured:
        parameters["period_ns"] = stream.period_ns or int(np.median(differences(first, stream.cuts)))
        columns.setdefault("expected_ns", np.full(rows, UNKNOWN_NS))
        columns.setdefault("real_ns", first)
    if stream.kind is StreamKind.MESSAGES:
        columns.setdefault("callback_end_ns", np.full(rows, NOT_SEEN_NS))
    if not measured:
        return None
    passed_ns = int(first[-1] - first[0])
    late = late or LateValues()
    return ObservedOutput(
        suite=stream.kind.suite,
        parameters=parameters,
        columns=columns,
        asked=measured + lost,
        measured=measured,
        missing=lost,
        duplicate=stream.counts.get("duplicate", 0),
        out_of_order=stream.counts.get("out_of_order", 0),
        rate_hz=(rows - 1) * 1e9 / passed_ns if rows > 1 and passed_ns > 0 else None,
        above_limit=late.above_limit,
        limit_ns=late.limit_ns,
        traced=tuple(_traced(stream, late.kept)),
    )


# The column that says when a value was there.
_TIMES = {
    StreamKind.MESSAGES: "reception_ns",
    StreamKind.TIMER: "timestamp_ns",
    StreamKind.CALLBACK: "end_ns",
    StreamKind.PATH: "end_ns",
}


def _traced(stream: Stream, kept: Sequence[LateValue]) -> Iterator[TracedValue]:
    """The late values that have a trace, by the indices that they have in the samples."""
    for one in kept:
        rows = np.flatnonzero(stream.columns[_TIMES[stream.kind]] == one.at_ns)
        if one.text and rows.size:
            row = int(rows[0])
            yield TracedValue(
                index=int(stream.columns["seq"][row]) if stream.kind is StreamKind.MESSAGES else row,
                value_ns=one.value_ns,
                limit_ns=one.limit_ns,
                at_ns=one.at_ns,
                text=one.text,
            )


def _write_run(folder: Path, facts: _StreamFacts, output: ObservedOutput, *, reason: str | None = None) -> None:
    """Write and close the run of a stream; with a `reason` one that failed."""
    run, result = facts.run, facts.result
    programs = _programs(result, output, _PARTIES)
    # The program that has the values: of messages it is that of the subscriber.
    measuring = _programs(result, output, ("subscriber",)) if "subscriber" in output.parameters else programs
    deadlines = run.observation.deadlines if run.observation else ()
    name = folder.name
    updated: dict[str, Any] = {
        "run": name,
        "suite": output.suite,
        "parameters": dict(output.parameters),
        "deadline_ns": next(
            (each.deadline_ns for each in deadlines if each.is_of(output.suite, output.parameters)), None
        ),
        "programs": [_program(each) for each in programs],
        "outputs": [name],
        # Of what has no limit there are no traces.
        "trace": run.trace if run.trace == UNTRACED or output.limit_ns is not None else "",
    }
    if output.limit_ns is not None:
        threshold = {PARAMETER: round(output.limit_ns / 1000)}
        output = replace(output, parameters={**output.parameters, **threshold})
        updated["parameters"] = dict(output.parameters)
    if reason is not None:
        updated |= {"status": RunStatus.FAILED, "reason": reason, "outputs": []}
    record = facts.record.model_copy(update=updated)
    with run_directory.filling(folder) as partial:
        if reason is None:
            state = facts.state
            step_ns = clock_record.record(state, []).step_ns or 1
            provenance = Provenance(
                version=version("meta-rt-tests"),
                host=fact_text(state.host) or "",
                kernel=Uname(
                    release=fact_text(state.kernel_release) or "",
                    version=fact_text(state.kernel_version) or "",
                    machine=fact_text(state.machine) or "",
                ),
                start_time=result.start_time,
                end_time=result.end_time,
            )
            threads = [_thread(thread) for program in measuring for thread in program.threads]
            write_stream(partial, name, replace(output, clock_step_ns=step_ns), provenance, threads)
        run_directory.close(partial, folder, record)


def _programs(result: ObservationResult, output: ObservedOutput, parties: Sequence[str]) -> list[ObservedProgram]:
    """The programs that parameters of a stream name; all of them where none is known by its name."""
    known = result.flows.situation.pids
    pids = {pid for key in parties for pid in known.get(str(output.parameters.get(key)), ())}
    return [each for each in result.programs if each.pid in pids] or list(result.programs)


def _program(each: ObservedProgram) -> ProgramRecord:
    return ProgramRecord(
        name=each.name,
        argv=list(each.argv),
        pid=each.pid,
        threads=[_thread(thread) for thread in each.threads],
        locked_bytes=each.locked_bytes,
    )


def _thread(thread: "object") -> Thread:
    return Thread.model_validate(thread, from_attributes=True, strict=False)
