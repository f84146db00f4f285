"""Turn an observation into normal runs: a run directory for each stream, and one for the whole."""

import contextlib
import functools
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rtfiles.errors import InfrastructureError
from rtfiles.output import counted
from rtrun.execution.observation import ObservationResult
from rtrun.execution.stream_runs import StreamFacts, write_streams
from rtrun.flows.hazards import hazards
from rtrun.flows.streams import streams
from rtrun.plan.observation import ObservationPlan
from rtrun.plan.run import UNTRACED, Run
from rtrun.plan.suites import Value
from rtrun.probes.hits import ObservedProgram
from rtrun.results import run_directory
from rtrun.results.observed import Graph, PlacedEvent, RefusedEvent, write_graph
from rtrun.results.output import Thread
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus, UnrelatedEnd
from rtrun.targets.inspection.facts import TargetState

# The files written before the streams take less than one half, graph.json and run.json less than the other.
_ROOM_BYTES = 2**21


def write(
    partial: Path,
    folder: Path,
    run: Run,
    record: RunRecord,
    state: TargetState,
    result: ObservationResult,
    room: Path,
    troubles: Sequence[str] = (),
) -> RunRecord:
    """Write a run for each stream next to `folder`, and one for each that was asked for and not seen.

    `record` is the record of the observing run, with its outcome; `partial` is filled with what was placed and found.
    `state` is the state of the target, `room` is freed for the observation's own files, and `troubles` came after the
    observation. Returns the closing record. The run has failed if no stream that was asked for was seen. It is
    incomplete if something ended it early, or the disk does not take all of it. If it is ok, its reason tells what it
    has not seen. Raises InfrastructureError if not even the observation's own files can be written.
    """
    assert isinstance(run.subject, ObservationPlan)
    record = record.model_copy(
        update={
            "programs": [*record.programs, *map(_program, result.programs)],
            "start_time": result.start_time,
            "end_time": result.end_time,
            # The traces belong to its streams, each with its own limit.
            "trace": run.trace if run.trace == UNTRACED else "",
            "coverage": result.coverage,
        }
        | ({"unrelated_end": UnrelatedEnd.INTERRUPTED} if isinstance(result.cut_off, KeyboardInterrupt) else {})
    )
    if record.status is RunStatus.OK and result.coverage.in_words:
        record = record.model_copy(update={"reason": result.coverage.in_words})
    facts = StreamFacts(
        record=record.model_copy(update={"attempt": "", "observed_by": record.run}),
        state=state,
        start_time=result.start_time,
        end_time=result.end_time,
        deadlines=run.subject.deadlines,
        programs=functools.partial(_programs, result),
        trace=run.trace,
        loops=run.subject.named_loops,
    )
    written = write_streams(
        folder,
        facts,
        streams(result.flows),
        result.late.streams if result.late else {},
        keeps_what_fits=True,
    )
    with contextlib.suppress(OSError):
        room.unlink()
    not_kept = written.not_kept
    if record.status is RunStatus.OK and (result.broken or not_kept):
        more = f"{counted(len(not_kept), 'stream')} not kept: {not_kept[0]}" if not_kept else ""
        reason = "; ".join(filter(None, (record.reason, result.broken, more)))
        record = record.model_copy(update={"status": RunStatus.INCOMPLETE, "reason": reason})
    unseen = written.unseen
    if unseen and len(unseen) == len(facts.asked_for) and record.status in (RunStatus.OK, RunStatus.INCOMPLETE):
        reasons = [*([record.reason] if record.reason else []), *unseen]
        record = record.model_copy(update={"status": RunStatus.FAILED, "reason": "; ".join(reasons)})
    write_graph(
        partial,
        Graph(
            schema=1,
            placed=[PlacedEvent(event=probe.event, path=probe.path) for probe in result.began.placed],
            refused=[
                RefusedEvent(event=probe.event, path=probe.path, reason=probe.reason) for probe in result.began.refused
            ],
            remarks=[
                *result.remarks,
                *troubles,
                *written.left_out,
                *not_kept,
                *(unseen if record.status in (RunStatus.OK, RunStatus.INCOMPLETE) else ()),
            ],
            hazards=list(hazards(result.programs, with_pids=False)),
        ),
    )
    return record


def free_first_half(folder: Path) -> None:
    """Free room for what is written before the streams."""
    with contextlib.suppress(OSError):
        os.truncate(run_directory.room_of(folder), _ROOM_BYTES // 2)


@contextlib.contextmanager
def room(folder: Path) -> Iterator[None]:
    """Reserve disk space for an observation's own files: others may fill the disk first, or its streams may.

    Raises InfrastructureError if there is no space.
    """
    path = run_directory.room_of(folder)
    try:
        try:
            with path.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, _ROOM_BYTES)
        except OSError as error:
            raise InfrastructureError(f"{folder.parent}: cannot keep the results: {error.strerror}") from error
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def _programs(
    result: ObservationResult, parameters: Mapping[str, Value], parties: Sequence[str]
) -> Sequence[ProgramRecord]:
    """The programs that a stream's parameters name; all programs if none has such a name."""
    known = result.flows.state.pids
    pids = {pid for key in parties for pid in known.get(str(parameters.get(key)), ())}
    return [
        _program(program)
        for program in [program for program in result.programs if program.pid in pids] or result.programs
    ]


def _program(program: ObservedProgram) -> ProgramRecord:
    return ProgramRecord(
        name=program.name,
        argv=list(program.argv),
        pid=program.pid,
        threads=[_thread(thread) for thread in program.threads],
        locked_bytes=program.locked_bytes,
    )


def _thread(thread: "object") -> Thread:
    return Thread.model_validate(thread, from_attributes=True, strict=False)
