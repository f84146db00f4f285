"""Turn measured streams into normal runs: a run directory for each, and one for each that is missing."""

import contextlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.errors import InfrastructureError
from rtfiles.output import listed
from rtfiles.quantities import grouped, time
from rtrun.execution import clock_record
from rtrun.execution.late_values import LateValue, LateValues
from rtrun.execution.observation import defect_in_words
from rtrun.flows.values import Stream, typical_step
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.known import STREAMS
from rtrun.kinds.lateness import is_late
from rtrun.kinds.loop import STREAM as LOOP
from rtrun.kinds.values import Int64s
from rtrun.plan.observation import StreamDeadline
from rtrun.plan.run import UNTRACED
from rtrun.plan.suites import Value
from rtrun.plan.trace import PARAMETER
from rtrun.results import run_directory
from rtrun.results.columns import pieces
from rtrun.results.observed import ObservedOutput, Provenance, TracedValue, write_stream
from rtrun.results.output import Uname
from rtrun.results.record import ProgramRecord, RunRecord, RunStatus
from rtrun.targets.inspection.facts import TargetState, fact_text

# Characters of a folder's name: room for a number and what tells streams apart, and file systems take it.
_NAME_MAX = 100  # characters
_NAMES_SHOWN = 8
_TOPICS_SHOWN = 3
# Parameters that name programs.
_PARTIES = ("publisher", "subscriber", "node", "sink", "program", "client", "server")
# Those of them whose program has the values, where that is not all.
_MEASURING = ("subscriber", "client")


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamFacts:
    """What all streams of a run share.

    `record` is the record of the run that has the streams, `trace` the limit above which it kept traces of them.
    `parameters` tell them from the streams of another run. `programs` takes the parameters of a stream and the keys of
    those that name programs, and finds these programs. `loops` are named without a deadline.
    """

    record: RunRecord
    state: TargetState
    start_time: str
    end_time: str
    deadlines: Sequence[StreamDeadline]
    programs: Callable[[Mapping[str, Value], Sequence[str]], Sequence[ProgramRecord]]
    parameters: Mapping[str, Value] = field(default_factory=dict)
    trace: str = ""
    loops: Sequence[str] = ()

    @property
    def asked_for(self) -> tuple[tuple[StreamKind, str], ...]:
        """Kind and name of each stream that is asked for: it has a deadline, or is a loop that is named."""
        of_deadlines = ((deadline.kind, deadline.name) for deadline in self.deadlines)
        asked = dict.fromkeys((*of_deadlines, *((LOOP.word, name) for name in self.loops)))
        return tuple((STREAMS[kind], name) for kind, name in asked)

    def deadline_ns(self, output: ObservedOutput) -> int | None:
        """The deadline of a stream; None: it has none."""
        return next(
            (deadline.deadline_ns for deadline in self.deadlines if deadline.is_of(output.suite, output.parameters)),
            None,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class WrittenStreams:
    """What was not written, one sentence each.

    `left_out` tells what is missing in streams, `not_kept` the streams that could not be written, `unseen` those that
    were asked for and not seen.
    """

    left_out: tuple[str, ...]
    not_kept: tuple[str, ...]
    unseen: tuple[str, ...]


def write_streams(
    folder: Path,
    facts: StreamFacts,
    streams: Iterable[Stream],
    late: Mapping[object, LateValues],
    *,
    keeps_what_fits: bool = False,
) -> WrittenStreams:
    """Write a run for each stream next to `folder`, and a failed one for each that was asked for and not seen.

    `late` has the late values of each stream by its source. Raises InfrastructureError if a run cannot be written. With
    `keeps_what_fits` it goes on instead: an observation cannot be measured again, and a defect of ours in one stream is
    no reason to lose the others.
    """
    names: set[str] = set()
    not_kept: list[str] = []
    left_out: list[str] = []
    outputs: list[ObservedOutput] = []
    without_value: list[tuple[Stream, str]] = []
    noted = not_kept if keeps_what_fits else None
    for stream in streams:
        if stream.trouble:
            with _noting(noted, _in_words(stream)):
                raise InfrastructureError(stream.trouble)
            continue
        output = None
        with _noting(noted, _in_words(stream)):
            output = _output(stream, facts.parameters, late.get(stream.source) or LateValues())
        remarks = stream.remarks or (() if output is not None else ("too few calls to be measured",))
        left_out += (f"{_in_words(stream)}: {remark}" for remark in remarks)
        if output is None:
            without_value.append((stream, "; ".join(remarks)))
            continue
        deadline_ns = facts.deadline_ns(output)
        if deadline_ns is not None and is_late(stream.open_ns, deadline_ns):
            # A value that is still open is a miss, even if it comes later.
            more = sum(is_late(open_ns, deadline_ns) for open_ns in stream.more_open_ns)
            output = replace(output, asked=output.asked + 1 + more, missing=output.missing + 1 + more)
            others = f"; and {grouped(more)} more" * bool(more)
            left_out.append(f"{_in_words(stream)}: {stream.kind.overdue.format(time(stream.open_ns))}{others}")
        # The run of the stream has its values. Those of all streams may be more than the memory holds.
        outputs.append(replace(output, columns={}, traced=()))
        with _noting(noted, _in_words(stream)):
            _write_run(_beside(folder, output, facts.parameters, names), facts, output)
    unseen: list[str] = []
    for kind, name in facts.asked_for:
        alike = [output for output in outputs if output.suite == kind.suite]
        if not any(kind.is_named(name, output.parameters) for output in alike):
            why = (
                text for stream, text in without_value if stream.kind is kind and kind.is_named(name, stream.identity)
            )
            reason = f"{kind.word} {name}: {next(why, None) or _not_seen(kind, alike, outputs, facts)}"
            unseen.append(reason)
            nothing = ObservedOutput(
                suite=kind.suite,
                parameters={kind.named_by: name, **facts.parameters},
                columns={},
                asked=0,
                measured=0,
            )
            with _noting(noted, name):
                _write_run(_beside(folder, nothing, facts.parameters, names), facts, nothing, reason=reason)
    return WrittenStreams(left_out=tuple(left_out), not_kept=tuple(not_kept), unseen=tuple(unseen))


@contextlib.contextmanager
def _noting(not_kept: list[str] | None, name: str) -> Iterator[None]:
    """Note what cannot be kept, if there is a list for it."""
    try:
        yield
    except Exception as error:
        if not_kept is None:
            raise
        not_kept.append(f"{name}: {error if isinstance(error, InfrastructureError) else defect_in_words(error)}")


def _in_words(stream: Stream) -> str:
    return " ".join(map(str, stream.identity.values()))


def put_aside(folder: Path) -> None:
    """Put aside what an earlier attempt at this run has left of its streams."""
    for path in folder.parent.iterdir():
        if path.name.startswith(f"{folder.name}-") and path.is_dir():
            closed = run_directory.closing_record(path)
            if closed is not None and closed.observed_by == folder.name:
                run_directory.put_aside(path)


def _not_seen(
    kind: StreamKind, alike: Sequence[ObservedOutput], outputs: Sequence[ObservedOutput], facts: StreamFacts
) -> str:
    """Say that a stream was not seen, and by which names others of its kind were."""
    seen = dict.fromkeys(str(output.parameters[kind.named_by]) for output in alike)
    if not seen:
        return "it was not seen"
    if kind.named_by != "node":
        return f"it was not seen; seen were {listed(seen, _NAMES_SHOWN)}"
    nodes = listed([_described(name, outputs, facts) for name in seen], _NAMES_SHOWN)
    return f"it was not seen; a node that ran before has the name of its program: name one of {nodes}"


def _described(node: str, outputs: Sequence[ObservedOutput], facts: StreamFacts) -> str:
    """The name of a node, with what people know it by: its process and its topics."""
    pids = [f"pid {program.pid}" for program in facts.programs({"node": node}, ["node"])]
    topics = dict.fromkeys(
        str(output.parameters["topic"])
        for output in outputs
        if "topic" in output.parameters and node in (output.parameters.get(party) for party in _PARTIES)
    )
    words = "; ".join(filter(None, [", ".join(pids), listed(topics, _TOPICS_SHOWN)]))
    return f"{node} ({words})" if words else node


def _beside(folder: Path, output: ObservedOutput, shared: Mapping[str, Value], taken: set[str]) -> Path:
    """A folder for a stream, different from those of all others."""
    own = (str(value) for key, value in output.parameters.items() if key not in shared)
    words = [output.suite.removeprefix("observed_"), *own]
    plain = re.sub(r"[^A-Za-z0-9._]+", "-", "-".join(words)).strip("-")[:_NAME_MAX]
    name, again = f"{folder.name}-{plain}", 1
    while name in taken:
        again += 1
        name = f"{folder.name}-{plain}-{again}"
    taken.add(name)
    return folder.with_name(name)


def _output(stream: Stream, shared: Mapping[str, Value], late: LateValues) -> ObservedOutput | None:
    """A stream as its samples hold it, with the traces of its late values; None: it has no value."""
    columns: dict[str, Int64s] = dict(stream.columns)
    parameters: dict[str, Value] = {**stream.identity, **shared}
    first = next(iter(columns.values()))
    rows = first.size
    lost = stream.counts.get("lost", 0)
    measured = rows
    if stream.kind.is_between_rows:
        measured = max(rows - 1, 0) - stream.cuts.size
    if not measured:
        return None
    if stream.kind.has_period:
        parameters["period_ns"] = stream.period_ns or typical_step(first, stream.cuts) or 0
    for name, value in stream.kind.filled.items():
        filled = columns[value] if isinstance(value, str) else np.broadcast_to(np.int64(value), rows)
        columns.setdefault(name, filled)
    passed_ns = int(first[-1] - first[0])
    return ObservedOutput(
        suite=stream.kind.suite,
        parameters=parameters,
        columns=columns,
        asked=measured + lost,
        measured=measured,
        missing=lost,
        duplicate=stream.counts.get("duplicate", 0),
        out_of_order=stream.counts.get("out_of_order", 0),
        # With more than one value per nanosecond, the times tell no rate.
        rate_hz=(rows - 1) * 1e9 / passed_ns if rows > 1 and rows - 1 <= passed_ns else None,
        above_limit=late.above_limit,
        limit_ns=late.limit_ns,
        traced=tuple(_traced(stream, late.kept)),
    )


def _traced(stream: Stream, kept: Sequence[LateValue]) -> Iterator[TracedValue]:
    """The late values that have a trace, with their indices in the samples."""
    for value in kept:
        if not value.text:
            continue
        row = _row_at(stream.columns[stream.kind.at], value.at_ns)
        if row is not None:
            yield TracedValue(
                index=int(stream.columns[stream.kind.index][row]) if stream.kind.index else row,
                value_ns=value.value_ns,
                limit_ns=value.limit_ns,
                at_ns=value.at_ns,
                tid=value.tid,
                text=value.text,
            )


def _row_at(times_ns: Int64s, at_ns: int) -> int | None:
    begin = 0
    for (piece,) in pieces(times_ns):
        rows = np.flatnonzero(piece == at_ns)
        if rows.size:
            return begin + int(rows[0])
        begin += piece.size
    return None


def _write_run(folder: Path, facts: StreamFacts, output: ObservedOutput, *, reason: str | None = None) -> None:
    """Write and close the run of a stream; with a `reason`, it has failed."""
    programs = facts.programs(output.parameters, _PARTIES)
    has_values = [parameter for parameter in _MEASURING if parameter in output.parameters]
    measuring = facts.programs(output.parameters, has_values) if has_values else programs
    name = folder.name
    updated: dict[str, Any] = {
        "run": name,
        "suite": output.suite,
        "subject": "attached",
        "parameters": dict(output.parameters),
        "deadline_ns": facts.deadline_ns(output),
        "programs": [*programs],
        "outputs": [name],
        # A stream without a limit has no traces.
        "trace": facts.trace if facts.trace == UNTRACED or output.limit_ns is not None else "",
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
                start_time=facts.start_time,
                end_time=facts.end_time,
            )
            threads = [thread for program in measuring for thread in program.threads]
            write_stream(partial, name, replace(output, clock_step_ns=step_ns), provenance, threads)
        run_directory.close(partial, folder, record)
