"""What a program of a suite writes: the types of its json."""

from typing import Annotated, Literal

from pydantic import Field

from rtfiles.config import Config
from rtrun.kinds.limits import ClockStepNs, Count, Cpu, CpuDmaLatencyUs, CpuTimeNs, MeanNs, Pid, Priority, TimeNs
from rtrun.kinds.rows import Stated
from rtrun.plan.suites import Asked, Parameters
from rtrun.results.rate import Rate

# Each that is wrong is an error of its own.
LIST_MAX = 20_000
_LISTED = Field(max_length=LIST_MAX)
# Threads of a suite that have no part in the measurement: of normal scheduling, on spare CPUs, whatever was asked for.
NON_MEASURING_THREADS = frozenset({"rt_blocks", "rt_traces"})


class Thread(Config):
    """A thread of the measuring program, as the kernel showed it."""

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
    """None: not known, as of programs that ran already."""
    cpu_dma_latency_us: CpuDmaLatencyUs | None = None
    """The lowest latency that any program held in /dev/cpu_dma_latency, or the kernel's default; None: not known."""
    facts: dict[str, str] = Field(default_factory=dict)
    """Of the middleware, as it says itself: versions, and parameters that are given by the environment."""


class Uname(Config):
    """The kernel measured on, as uname names it."""

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
        """How many have an outcome."""
        return self.measured + self.not_fired + self.missing

    @property
    def loops(self) -> int:
        """How often it did what it does."""
        return self.measured


class Indices(Config):
    """The indices of what each of the counts counts, the first 1000."""

    not_fired: Annotated[list[Count], _LISTED]
    missing: Annotated[list[Count], _LISTED]
    duplicate: Annotated[list[Count], _LISTED]
    out_of_order: Annotated[list[Count], _LISTED]


class Entry(Config):
    """One value of a list of the highest or lowest."""

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
    """Names of the files written beside the json."""

    logs: list[str]
    npy: str


class Traces(Config):
    """Values above a limit that the kernel trace was asked for, and the traces that were kept."""

    above_limit: Count
    files: list[str]


class Costs(Config):
    """What all threads of a program cost together while it measured."""

    minor_faults: Count
    """Page faults without reading from a disk."""
    major_faults: Count
    voluntary_switches: Count
    involuntary_switches: Count
    cpu_time_ns: CpuTimeNs
    allocations: Count | None = None
    """Calls of malloc and its relatives; None: they were not counted."""
    frees: Count | None = None
    allocations_of_measuring_thread: Count | None = None

    @property
    def page_faults(self) -> int:
        """Of both sorts."""
        return self.minor_faults + self.major_faults


class ProgramHead(Config):
    """What the json of every program begins with: what was requested, and in effect."""

    schema_number: Literal[1] = Field(alias="schema")
    suite: str
    program: str
    middleware: str = "roscpp"
    """Through which it measured; that of 2014 where it does not say."""
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
    """None: nothing was measured, or it does not say."""


class Record(ProgramHead):
    """``<output>.json``, as docs/formats.md has it."""

    counts: Counts
    indices: Indices
    summary: dict[str, Summary]
    files: Files
    columns: list[str]
    """Of the npy, as in suites.yml."""
    rate: Rate
    traces: Traces

    @property
    def stated(self) -> Stated:
        """What its samples are checked against."""
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
    """How many messages were asked for, and sent."""

    asked: Asked
    sent: Count

    @property
    def loops(self) -> int:
        """How often it did what it does."""
        return self.sent


class SenderRecord(ProgramHead):
    """``<output>-publisher.json``: a program without samples."""

    counts: SentCounts
    rate: Rate


class ExecutorRecord(Config):
    """A thread of nodes: what was asked of it, when it stopped receiving; `foreign` messages came from elsewhere."""

    name: str
    policy: str
    priority: Priority
    cpus: str
    left_ns: TimeNs
    foreign: Count


class HostedNodeRecord(Config):
    """A node: its activations, and points of its period that it skipped."""

    name: str
    activations: Count
    skipped: Count


class HostRecord(ProgramHead):
    """``process-<name>.json``: a process of a topology; its nodes' tables are next to it."""

    start_ns: TimeNs
    measured_ns: TimeNs
    executors: Annotated[list[ExecutorRecord], _LISTED]
    nodes: Annotated[list[HostedNodeRecord], _LISTED]
