"""Programs that run already are observed, and what was measured of them becomes runs like any other."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path, PurePosixPath

import numpy as np

from rtfiles import atomic
from rtfiles.output import counted, listed
from rtrun.analysis.histogram import Int64s
from rtrun.causes.outliers import AFTER_NS
from rtrun.execution import clock_record
from rtrun.execution.board import Clock, utc_now
from rtrun.execution.late_values import LateValue, LateValueRecord, LateValues
from rtrun.execution.run_execution import STATED
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.live import LiveFigures, Snapshot
from rtrun.flows.recorder import FlowRecorder
from rtrun.flows.streams import streams
from rtrun.flows.values import Stream, differences
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.output import Thread, Uname
from rtrun.kinds.timer import UNKNOWN_NS
from rtrun.plan.observation import ObservationPlan, StreamDeadline, StreamKind
from rtrun.plan.suites import Value
from rtrun.plan.trace import PARAMETER
from rtrun.probes import session
from rtrun.probes.hits import ObservedProgram
from rtrun.probes.libraries.description import events
from rtrun.probes.placement import Placement, place, refusals
from rtrun.probes.programs import FoundProgram, find_programs
from rtrun.probes.session import Began, Finished
from rtrun.results import run_directory
from rtrun.results.observed import ObservedOutput, Provenance, TracedValue, write_stream
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus, TargetFacts
from rtrun.targets import deploy
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.inspection import kernel_trace, platform_signs
from rtrun.targets.inspection.facts import fact_text
from rtrun.targets.inspection.platform import KnownPlatform
from rtrun.targets.link import Link

SUITE = "observation"
# Events that nothing is read from here, and their number in a second of a busy machine.
_FOR_PEOPLE = ("osnoise",)
_KERNEL_EVENTS_PER_S = 80_000
# Parameters that name programs.
_PARTIES = ("publisher", "subscriber", "node")
# A number and what tells streams apart, in a name that file systems take.
_NAME_MAX = 100
_NAMES_SHOWN = 8
GRAPH = "graph.json"
# Seen for paths of topics, and for the causes of late values: they come several times for each message.
_OF_PATHS = ("wait", "guard_trigger", "request_take", "response_take")


@dataclass(frozen=True, kw_only=True, slots=True)
class Watched:
    """A target with the programs to observe, and the probes for them."""

    link: Link
    scripts: PurePosixPath
    state: inspection.TargetState
    equipment: inspection.Equipment
    platform: KnownPlatform
    found: tuple[FoundProgram, ...]
    placement: Placement


@dataclass(frozen=True, kw_only=True, slots=True)
class ObservationResult:
    """What was observed: the flows, the programs that were there at any time, what was placed, and how it ended."""

    flows: FlowAccumulator
    programs: tuple[ObservedProgram, ...]
    began: Began
    finished: Finished | None
    start_time: str
    end_time: str
    late: LateValueRecord | None = None
    """Late values, with the kernel's traces of some; None: they were not asked for."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is missing in it, a sentence each."""
        lines = [*refusals(self.began.refused)]
        if self.finished and self.finished.lost_events:
            lines.append(f"{counted(self.finished.lost_events, 'event')} lost by the kernel: what was then is left out")
        if self.finished and self.finished.rests:
            lines.append(f"{counted(self.finished.rests, 'rest')} of the probes: more events than the limit")
        if self.finished and not self.finished.is_clean:
            lines.append("the probes were not seen to be taken off: the next call takes off what is left")
        return tuple(dict.fromkeys(lines))


def watch(link: Link, plan: ObservationPlan) -> Watched:
    """Look at a target without changing it, and resolve the probes for its programs. Raises TargetError."""
    wanted = [event for event in events() if plan.followed or plan.trace or event not in _OF_PATHS]
    equipment = inspection.inspect(link)
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    found = find_programs(link, scripts)
    if not found and link.check(["id", "-u"]).strip() != "0":
        raise TargetError(f"{link.target.address}: observing takes root: the programs of other users cannot be seen")
    return Watched(
        link=link,
        scripts=scripts,
        state=inspection.read_state(link, scripts / "state.sh"),
        equipment=equipment,
        platform=platform_signs.find_platform(link),
        found=found,
        placement=place(link, found, events=wanted),
    )


def observe(
    watched: Watched,
    plan: ObservationPlan,
    *,
    on_second: Callable[[Snapshot], None],
    recorder: FlowRecorder | None = None,
    now: Clock = utc_now,
) -> ObservationResult:
    """Observe for the time of the plan, or until Ctrl-C, which ends it as its time does.

    `on_second` is called about once a second with the figures so far. Raises TargetError where there is nothing to
    observe, or the target cannot be observed.
    """
    if not watched.placement.probes:
        nothing = "; ".join(refusals(watched.placement.refused)) or "no program runs there that uses ROS"
        raise TargetError(f"{watched.link.target.address}: {nothing}")
    alive = {each.program.pid: each.program for each in watched.found}
    seen = {(each.pid, each.start_ticks): each for each in alive.values()}
    flows: FlowAccumulator | None = None
    figures: LiveFigures | None = None
    began, finished = Began(placed=(), refused=()), None
    late = LateValueRecord(plan.trace, kernel_trace.read_symbols(watched.link)) if plan.trace else None
    start_time = now().isoformat()
    stream = session.observe(
        watched.link,
        watched.scripts,
        watched.placement,
        watched.found,
        for_s=plan.for_s,
        kernel_events=[each for each in kernel_trace.read_events() if each not in _FOR_PEOPLE] if late else (),
        limit_per_s=session.LIMIT_PER_S + (_KERNEL_EVENTS_PER_S if late else 0),
    )
    try:
        for each in stream:
            if isinstance(each, Began):
                began = each
            elif isinstance(each, Finished):
                finished = each
            elif each.begin_ns:
                if flows is None or figures is None:
                    flows = FlowAccumulator(
                        begin_ns=each.begin_ns,
                        paths=plan.followed,
                        recorder=recorder,
                        on_turn=late.turn if late else None,
                    )
                    flows.observe(alive.values())
                    figures = LiveFigures(flows, plan.deadlines, late.look if late else None)
                for pid in each.ended:
                    alive.pop(pid, None)
                for program in each.programs:
                    alive[program.program.pid] = program.program
                    seen[program.program.pid, program.program.start_ticks] = program.program
                if each.ended or each.programs:
                    flows.observe(alive.values())
                if each.realtime_offset_ns is not None:
                    flows.offset("system", each.until_ns, each.realtime_offset_ns)
                if late is not None:
                    late.record(each)
                flows.feed([*each.hits, *each.gaps])
                on_second(figures.snapshot(each.until_ns))
                if late is not None:
                    late.cut(each.until_ns)
    except KeyboardInterrupt:
        stream.close()
        if flows is None:
            raise
    if flows is None or figures is None:
        raise TargetError(f"{watched.link.target.address}: the probes were placed, but nothing was recorded")
    flows.finish()
    if late is not None:
        figures.snapshot(flows.newest_ns)
        late.cut(flows.newest_ns + AFTER_NS)
    return ObservationResult(
        flows=flows,
        programs=tuple(seen.values()),
        began=began,
        finished=finished,
        start_time=start_time,
        end_time=now().isoformat(),
        late=late,
    )


def write(results: Path, watched: Watched, plan: ObservationPlan, observation: ObservationResult) -> tuple[str, ...]:
    """Write a run for each stream, one for each deadline of what was not seen, and one of the observation itself.

    Returns what was left out, a sentence each. Raises InfrastructureError where they cannot be written: none is then.
    """
    run_directory.make_results(results)
    number = _next_number(results)
    with run_directory.together(results, f"{number:03}") as staged:
        return _write(staged, number, watched, plan, observation)


def _write(
    results: Path, number: int, watched: Watched, plan: ObservationPlan, observation: ObservationResult
) -> tuple[str, ...]:
    names: set[str] = set()
    left_out: list[str] = []
    outputs: list[ObservedOutput] = []
    without_value: list[tuple[Stream, str]] = []
    for stream in streams(observation.flows):
        late = observation.late.streams.get(stream.source) if observation.late else None
        output = _output(stream, late)
        remarks = stream.remarks or (() if output is not None else ("too few calls to be measured",))
        left_out += (f"{' '.join(map(str, stream.identity.values()))}: {remark}" for remark in remarks)
        if output is None:
            without_value.append((stream, "; ".join(remarks)))
            continue
        outputs.append(output)
        _write_run(results / _name(number, output, names), watched, plan, observation, output)
    for deadline in plan.deadlines:
        if not any(deadline.is_of(output.suite, output.parameters) for output in outputs):
            why = (text for stream, text in without_value if deadline.is_of(stream.kind.suite, stream.identity))
            reason = f"{deadline.kind} {deadline.name}: {next(why, None) or _not_seen(deadline, outputs)}"
            left_out.append(reason)
            nothing = ObservedOutput(
                suite=deadline.kind.suite,
                parameters={deadline.kind.named_by: deadline.name},
                columns={},
                asked=0,
                measured=0,
            )
            _write_run(results / _name(number, nothing, names), watched, plan, observation, nothing, reason=reason)
    _write_observation(results / f"{number:03}", watched, observation)
    return tuple(left_out)


def _not_seen(deadline: StreamDeadline, outputs: Sequence[ObservedOutput]) -> str:
    """That a stream with a deadline was not there, and which of its kind were."""
    seen = dict.fromkeys(
        str(output.parameters[deadline.kind.named_by]) for output in outputs if output.suite == deadline.kind.suite
    )
    others = f"; seen were {listed(seen, _NAMES_SHOWN)}" if seen else ""
    return f"it was not seen{others}"


def _next_number(results: Path) -> int:
    taken = [int(match[1]) for path in results.iterdir() if (match := re.match(r"([0-9]{1,9})(?![0-9])", path.name))]
    return max(taken, default=0) + 1


def _name(number: int, output: ObservedOutput, taken: set[str]) -> str:
    """A name for a run that no other has."""
    words = [output.suite.removeprefix("observed_"), *(str(value) for value in output.parameters.values())]
    plain = re.sub(r"[^A-Za-z0-9._]+", "-", "-".join(words)).strip("-")[:_NAME_MAX]
    name, again = f"{number:03}-{plain}", 1
    while name in taken:
        again += 1
        name = f"{number:03}-{plain}-{again}"
    taken.add(name)
    return name


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


def _write_run(
    folder: Path,
    watched: Watched,
    plan: ObservationPlan,
    observation: ObservationResult,
    output: ObservedOutput,
    *,
    reason: str | None = None,
) -> None:
    """Write and close the run of a stream; with a `reason` one that failed."""
    programs = _programs(observation, output, _PARTIES)
    # The program that has the values: of messages it is that of the subscriber.
    measuring = _programs(observation, output, ("subscriber",)) if "subscriber" in output.parameters else programs
    deadline_ns = next(
        (each.deadline_ns for each in plan.deadlines if each.is_of(output.suite, output.parameters)), None
    )
    name = folder.name
    record = _record(watched, observation, name, output.suite, programs)
    record = record.model_copy(
        update={"run": name, "parameters": dict(output.parameters), "deadline_ns": deadline_ns, "outputs": [name]}
    )
    if output.limit_ns is not None:
        threshold = {PARAMETER: round(output.limit_ns / 1000)}
        output = replace(output, parameters={**output.parameters, **threshold})
        record = record.model_copy(update={"parameters": dict(output.parameters), "trace": plan.trace})
    with run_directory.filling(folder) as partial:
        if reason is None:
            state = watched.state
            step_ns = clock_record.record(state, []).step_ns or 1
            provenance = Provenance(
                version=version("meta-rt-tests"),
                host=fact_text(state.host) or "",
                kernel=Uname(
                    release=fact_text(state.kernel_release) or "",
                    version=fact_text(state.kernel_version) or "",
                    machine=fact_text(state.machine) or "",
                ),
                start_time=observation.start_time,
                end_time=observation.end_time,
            )
            threads = [_thread(thread) for program in measuring for thread in program.threads]
            write_stream(partial, name, replace(output, clock_step_ns=step_ns), provenance, threads)
        else:
            record = record.model_copy(update={"status": RunStatus.FAILED, "reason": reason, "outputs": []})
        run_directory.close(partial, folder, record)


def _programs(observation: ObservationResult, output: ObservedOutput, parties: Sequence[str]) -> list[ObservedProgram]:
    """The programs that parameters of a stream name; all of them where none is known by its name."""
    known = observation.flows.situation.pids
    pids = {pid for key in parties for pid in known.get(str(output.parameters.get(key)), ())}
    return [each for each in observation.programs if each.pid in pids] or list(observation.programs)


def _record(
    watched: Watched, observation: ObservationResult, name: str, suite: str, programs: Sequence[ObservedProgram]
) -> RunRecord:
    target = watched.link.target
    return RunRecord(
        schema=2,
        run=name,
        campaign=name.partition("-")[0],
        suite=suite,
        subject="attached",
        parameters={},
        platform=watched.platform.platform,
        platform_evidence=watched.platform.evidence,
        status=RunStatus.OK,
        reason=None,
        start_time=observation.start_time,
        end_time=observation.end_time,
        programs=[
            ProgramRecord(
                name=each.name,
                argv=list(each.argv),
                pid=each.pid,
                threads=[_thread(thread) for thread in each.threads],
                locked_bytes=each.locked_bytes,
            )
            for each in programs
        ],
        outputs=[],
        target=TargetFacts(
            name=target.place or target.name,
            address=str(target.address),
            preempt_rt=inspection.is_preempt_rt(watched.state),
            cpus=watched.equipment.cpus,
            clock=clock_record.record(watched.state, []),
            **{name: getattr(watched.state, name) for name in STATED},
        ),
        files={},
    )


def _thread(thread: "object") -> Thread:
    return Thread.model_validate(thread, from_attributes=True, strict=False)


def _write_observation(folder: Path, watched: Watched, observation: ObservationResult) -> None:
    """Write the run of the observation itself: which probes were placed, what is missing."""
    import json

    graph = {
        "schema": 1,
        "placed": [{"event": each.event, "path": each.path} for each in observation.began.placed],
        "refused": [
            {"event": each.event, "path": each.path, "reason": each.reason} for each in observation.began.refused
        ],
        "remarks": list(observation.remarks),
    }
    with run_directory.filling(folder) as partial:
        atomic.write_text(partial / GRAPH, json.dumps(graph, indent=1))
        run_directory.close(partial, folder, _record(watched, observation, folder.name, SUITE, observation.programs))
