"""What a program of a suite writes: the types of its json."""

from typing import Annotated, Literal

from pydantic import Field

from rtfiles.config import Config
from rtrun.kinds.limits import ClockStepNs, Count, Cpu, CpuDmaLatencyUs, CpuTimeNs, MeanNs, Pid, Priority, TimeNs
from rtrun.kinds.rows import Stated
from rtrun.plan.suites import Asked, Parameters
from rtrun.results.rate import Rate

# A separate type for each, so that an error names the wrong one.
LIST_MAX = 20_000  #: entries of a list in a JSON file of a suite
_LISTED = Field(max_length=LIST_MAX)
# Threads of a suite that do not take part in the measurement: always with normal scheduling, on spare CPUs.
NON_MEASURING_THREADS = frozenset({"rt_blocks", "rt_traces"})


class Thread(Config):
    """A thread of the measuring program, as the kernel reports it."""

    tid: Pid
    name: str
    policy: str
    priority: Priority
    cpus: Annotated[list[Cpu], _LISTED]


class InEffect(Config):
    """What was in effect while measuring, read back."""

    threads: Annotated[list[Thread], _LISTED]
    clock: str
    clock_resolution_ns: ClockStepNs
    clock_step_ns: ClockStepNs
    mlockall: bool | None
    """None: not known, for example for programs that ran already."""
    cpu_dma_latency_us: CpuDmaLatencyUs | None = None
    """The lowest latency that any program held in /dev/cpu_dma_latency, or the kernel's default; None: not known."""
    facts: dict[str, str] = Field(default_factory=dict)
    """What the middleware reports about itself: versions, and parameters that the environment sets."""


class Uname(Config):
    """The kernel measured on, as uname reports it."""

    release: str
    version: str
    machine: str


class Counts(Config):
    """How many measurements were asked for, and what became of them."""

    asked: Asked
    measured: Count
    not_fired: Count
    missing: Count
    duplicate: Count
    out_of_order: Count

    @property
    def known(self) -> int:
        """How many measurements have an outcome."""
        return self.measured + self.not_fired + self.missing

    @property
    def loops(self) -> int:
        """How many times the program did its work: it measured."""
        return self.measured


class Indices(Config):
    """The first 1000 indices behind each count."""

    not_fired: Annotated[list[Count], _LISTED]
    missing: Annotated[list[Count], _LISTED]
    duplicate: Annotated[list[Count], _LISTED]
    out_of_order: Annotated[list[Count], _LISTED]


class Entry(Config):
    """One entry of a list of the highest or lowest values."""

    value_ns: TimeNs
    index: Count


class Summary(Config):
    """A program's own summary of one series; the numbers are None when n is 0."""

    n: Count
    min_ns: TimeNs | None
    mean_ns: TimeNs | MeanNs | None
    max_ns: TimeNs | None
    top: Annotated[list[Entry], _LISTED]
    lowest: Annotated[list[Entry], _LISTED]


class Files(Config):
    """Names of the files next to the json."""

    logs: list[str]
    npy: str


class Traces(Config):
    """Values above the trace limit, and the traces that were kept."""

    above_limit: Count
    files: list[str]


class Costs(Config):
    """What all threads of a program together cost while it measured."""

    minor_faults: Count
    """Page faults that read nothing from a disk."""
    major_faults: Count
    voluntary_switches: Count
    involuntary_switches: Count
    cpu_time_ns: CpuTimeNs
    allocations: Count | None = None
    """Calls of malloc and its relatives; None: not counted."""
    frees: Count | None = None
    allocations_of_measuring_thread: Count | None = None

    @property
    def page_faults(self) -> int:
        """Page faults of both kinds."""
        return self.minor_faults + self.major_faults


class ProgramHead(Config):
    """What the json of every program begins with: what was requested, and what was in effect."""

    schema_number: Literal[1] = Field(alias="schema")
    suite: str
    program: str
    middleware: str = "roscpp"
    """The middleware that it measured through; where the json names none, the one of 2014."""
    version: str
    complete: bool
    incomplete_reason: str | None
    requested: Parameters
    in_effect: InEffect
    host: str
    kernel: Uname
    start_time: str
    end_time: str
    costs: Costs | None = None
    """None: nothing was measured, or the json does not state it."""


class Record(ProgramHead):
    """``<output>.json``, as docs/formats.md describes it."""

    counts: Counts
    indices: Indices
    summary: dict[str, Summary]
    files: Files
    columns: list[str]
    """The columns of the npy, as in suites.yml."""
    rate: Rate
    traces: Traces

    @property
    def stated(self) -> Stated:
        """The values that its samples are checked against."""
        counts = self.counts
        return Stated(
            asked=counts.asked,
            measured=counts.measured,
            not_fired=counts.not_fired,
            missing=counts.missing,
            out_of_order=counts.out_of_order,
            skipped=self.rate.skipped,
            is_complete=self.complete,
            requested=self.requested,
        )


class SentCounts(Config):
    """How many messages were asked for, and how many were sent."""

    asked: Asked
    sent: Count

    @property
    def loops(self) -> int:
        """How many times the program did its work: it sent a message."""
        return self.sent


class SenderRecord(ProgramHead):
    """``<output>-publisher.json``: a program without samples."""

    counts: SentCounts
    rate: Rate


class ExecutorRecord(Config):
    """A thread of nodes: its settings, and when it stopped receiving; `foreign` messages came from elsewhere."""

    name: str
    policy: str
    priority: Priority
    cpus: str
    left_ns: TimeNs
    foreign: Count


class HostedNodeRecord(Config):
    """A node: its activations, and the points of its period that it skipped."""

    name: str
    activations: Count
    skipped: Count


class HostRecord(ProgramHead):
    """``process-<name>.json``: a process of a topology; the tables of its nodes are next to it."""

    start_ns: TimeNs
    measured_ns: TimeNs
    executors: Annotated[list[ExecutorRecord], _LISTED]
    nodes: Annotated[list[HostedNodeRecord], _LISTED]
