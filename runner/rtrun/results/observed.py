"""Observations of programs that run already, written like the output of a suite: ``<output>.npy`` and ``.json``."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from rtfiles import atomic
from rtfiles.config import Config, read_json
from rtrun.kinds.values import Int64s
from rtrun.plan.suites import Value, suite
from rtrun.results.columns import pieces
from rtrun.results.output import Counts, Files, Indices, InEffect, Record, Thread, Traces, Uname
from rtrun.results.rate import Rate
from rtrun.results.texts import StoredText

CLOCK = "CLOCK_MONOTONIC"
GRAPH = "graph.json"


class PlacedEvent(Config):
    """A probe that was placed: what it sees, and in which library."""

    event: str
    path: str


class RefusedEvent(PlacedEvent):
    """A probe that could not be placed, and why."""

    reason: str


class Graph(Config):
    """graph.json of an observation: its probes, and a line for each thing that is missing or threatens real time."""

    schema_number: Literal[1] = Field(alias="schema")
    placed: list[PlacedEvent]
    refused: list[RefusedEvent]
    remarks: list[str]
    hazards: list[str] = Field(default_factory=list)


def write_graph(folder: Path, graph: Graph) -> None:
    """Write graph.json into the run directory of an observation."""
    atomic.write_text(folder / GRAPH, graph.model_dump_json(by_alias=True, indent=1) + "\n")


def remarks_of(folders: Iterable[Path]) -> tuple[str, ...]:
    """What is missing in the observations of these run directories, and what threatens real time, each once.

    Raises UsageError for a damaged file.
    """
    graphs = {folder.name: read_json(folder / GRAPH, Graph) for folder in folders if (folder / GRAPH).is_file()}
    remarks: dict[str, tuple[str, list[str]]] = {}
    for name, graph in graphs.items():
        for text in graph.remarks:
            # Remarks that differ only in numbers are reported once.
            remarks.setdefault(re.sub("[0-9]+", "#", text), (text, []))[1].append(name)
    missing = (
        text if len(graphs) == 1 else f"{names[0]}{f' and {len(names) - 1} more' if names[1:] else ''}: {text}"
        for text, names in remarks.values()
    )
    return (*missing, *dict.fromkeys(text for graph in graphs.values() for text in graph.hazards))


@dataclass(frozen=True, kw_only=True, slots=True)
class TracedValue:
    """A value above a limit: its index in the samples, its time and thread, and the kernel's trace."""

    index: int
    value_ns: int
    limit_ns: int
    at_ns: int
    tid: int | None
    text: StoredText


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObservedOutput:
    """One thing that was observed: a pair of publisher and subscriber, a timer, a callback, a topic, a path of topics.

    `suite` is the suite of its kind, which names the `columns`, each int64 of shape (rows,). `parameters` distinguish
    it from every other stream of the target. `asked` is how many values there should be, as far as that is known;
    `measured` is how many there are, and `missing` how many never came.
    """

    suite: str
    parameters: Mapping[str, Value]
    columns: Mapping[str, Int64s]
    asked: int
    measured: int
    missing: int = 0
    duplicate: int = 0
    out_of_order: int = 0
    rate_hz: float | None = None
    clock_step_ns: int = 1
    above_limit: int = 0
    """How many values were above the trace limit; `limit_ns` is the last limit, None if there was none."""
    limit_ns: int | None = None
    traced: Sequence[TracedValue] = ()
    """The values whose trace was kept."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Provenance:
    """What all streams of an observation share; times are in ISO 8601."""

    version: str
    host: str
    kernel: Uname
    start_time: str
    end_time: str


def write_stream(
    folder: Path, output: str, stream: ObservedOutput, provenance: Provenance, threads: Sequence[Thread]
) -> None:
    """Write the samples of a stream, its traces, and the json next to them.

    `threads` are those of the program that has the values; for messages, the subscriber.
    """
    names = suite(stream.suite).columns
    _write_samples(folder / f"{output}.npy", [stream.columns[name] for name in names])
    record = Record(
        schema=1,
        suite=stream.suite,
        program=stream.suite,
        middleware="",
        version=provenance.version,
        complete=True,
        incomplete_reason=None,
        requested=dict(stream.parameters),
        in_effect=InEffect(
            threads=list(threads),
            clock=CLOCK,
            clock_resolution_ns=1,
            clock_step_ns=stream.clock_step_ns,
            mlockall=None,
            facts={},
        ),
        host=provenance.host,
        kernel=provenance.kernel,
        start_time=provenance.start_time,
        end_time=provenance.end_time,
        counts=Counts(
            asked=stream.asked,
            measured=stream.measured,
            not_fired=0,
            missing=stream.missing,
            duplicate=stream.duplicate,
            out_of_order=stream.out_of_order,
        ),
        indices=Indices(not_fired=[], missing=[], duplicate=[], out_of_order=[]),
        summary={},
        files=Files(logs=[], npy=f"{output}.npy"),
        columns=list(names),
        rate=Rate(asked_hz=None, achieved_hz=stream.rate_hz, overruns=None, skipped=None),
        traces=Traces(above_limit=stream.above_limit, files=_write_traces(folder, output, stream)),
    )
    atomic.write_text(folder / f"{output}.json", record.model_dump_json(by_alias=True, indent=2) + "\n")


def _write_samples(path: Path, columns: Sequence[Int64s]) -> None:
    """Write columns as the rows of an npy file, in pieces: they may not fit into memory."""
    header = {"descr": "<i8", "fortran_order": False, "shape": (columns[0].size, len(columns))}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        for some in pieces(*columns):
            file.write(np.stack(some, axis=1).astype("<i8", copy=False).data)


def _write_traces(folder: Path, output: str, stream: ObservedOutput) -> list[str]:
    """Write a file per trace and return the name for each value; values that share a trace share the file."""
    written: dict[StoredText, str] = {}
    names = []
    for value in stream.traced:
        name = f"{output}-trace-{value.index}.txt"
        seconds, rest_ns = divmod(value.at_ns, 1_000_000_000)
        head = (
            f"# {stream.suite}: {value.value_ns} ns at index {value.index} above {value.limit_ns} ns, "
            f"at {seconds}.{rest_ns // 1000:06} s of {CLOCK}{'' if value.tid is None else f' by thread {value.tid}'}\n"
        ).encode()
        shared = written.setdefault(value.text, name)
        with (folder / name).open("wb") as file:
            file.write(head)
            file.writelines(value.text.pieces() if shared == name else [f"# in {shared}\n".encode()])
        names.append(name)
    return names
