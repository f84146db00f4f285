"""run.json, the closing record of a run directory (docs/formats.md): one type for its writers and readers."""

import hashlib
import os
import time
from dataclasses import replace
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from rtfiles.config import Config, read_json
from rtfiles.errors import UsageError
from rtrun.kinds.limits import (
    ClockStepNs,
    Count,
    Cpu,
    CpuCount,
    ExitStatus,
    FrequencyKhz,
    LoadAverage,
    Percent,
    Pid,
    Priority,
    Range,
    RtRuntimeUs,
    Seed,
    SizeBytes,
    TemperatureMc,
    TimeNs,
)
from rtrun.plan.conditions import IDLE, Settings
from rtrun.plan.question import Question
from rtrun.plan.run import KernelName
from rtrun.plan.suites import Parameters, Subject, Value, middleware_of, suite, suites
from rtrun.plan.trace import PARAMETER as TRACE_PARAMETER
from rtrun.results.coverage import Coverage
from rtrun.results.output import Costs, Thread
from rtrun.results.rate import OFF_MAX, Rate
from rtrun.targets.inspection.control_groups import ControlGroup
from rtrun.targets.inspection.facts import Fact
from rtrun.targets.inspection.platform import Platform

FILE = "run.json"

UNKNOWN = "unknown"
"""The time of an imported file that does not state one."""


def moment(text: str) -> datetime | None:
    """A time of a record, in UTC; None for UNKNOWN. A time without a zone is UTC. Raises ValueError."""
    if text == UNKNOWN:
        return None
    time = datetime.fromisoformat(text)
    if not 1970 <= time.year < 2262:  # the range of 64-bit nanoseconds since 1970
        raise ValueError(f"a time of the years 1970 to 2261 is needed, got {text[:40]!r}")
    return time.astimezone(UTC) if time.tzinfo else time.replace(tzinfo=UTC)


def _check_moment(text: str) -> str:
    moment(text)
    return text


Name = Annotated[str, Field(min_length=1, max_length=255)]
Moment = Annotated[str, Field(max_length=64), AfterValidator(_check_moment)]
"""A time as in ISO 8601, or UNKNOWN."""


class RunStatus(StrEnum):
    """The outcome of a run. INVALID: it ended well, but not as asked for, or its numbers do not add up."""

    OK = "ok"
    FAILED = "failed"
    INCOMPLETE = "incomplete"
    INVALID = "invalid"


class UnrelatedEnd(StrEnum):
    """An early end of a run that had nothing to do with lateness."""

    INTERRUPTED = "interrupted"
    """By the user of the runner."""
    LINK_LOST = "link lost"
    DISK_FULL = "disk full"
    OTHER_SETUP = "other set-up"
    """The wrong thing ran."""


class ProgramRecord(Config):
    """A program that ran; without exit status, it was killed or ran on.

    `pid`, `threads` and `locked_bytes` (locked memory) belong to a program that ran already. `control_groups` are those
    that it was in, and their parents. `rate`, `costs` and `loops` come from its json; None where it has none, or where
    the json does not state them.
    """

    name: str
    argv: list[str]
    exit_status: ExitStatus | None = None
    pid: Pid | None = None
    threads: list[Thread] = Field(default_factory=list)
    locked_bytes: Count | None = None
    control_groups: list[ControlGroup] = Field(default_factory=list)
    rate: Rate | None = None
    costs: Costs | None = None
    loops: Count | None = None
    """Measurements made, or messages sent."""


class FileRecord(Config):
    """Size and checksum of a file in the run directory."""

    size_bytes: SizeBytes
    sha256: str


class Clock(Config):
    """The clock of a run: its name in the kernel, and what wakes its timers; `step_ns` may be unknown."""

    source: Fact
    event: Fact
    step_ns: ClockStepNs | None


class TargetFacts(Config):
    """The target at the begin of a run; for an imported file only the name is known."""

    name: str
    is_identified: bool = True
    """False: the run was imported, and its board is not set."""
    address: str = ""
    preempt_rt: bool | None = None
    cpus: CpuCount | None = None
    kernel_release: Fact = None
    kernel_version: Fact = None
    machine: Fact = None
    boot_id: Fact = None
    clocksource: Fact = None
    governor: Fact = None
    middleware_version: Fact = None
    """Of the middleware that the run measured through."""
    setup: Fact = None
    """The shell file that set up the middleware for the run."""
    suites_built_with: dict[str, str] = Field(default_factory=dict)
    """For suites built on the target: what they were built with, see docs/targets.md."""
    clock: Clock | None = None


class Requested(Config):
    """What a run asks for besides the parameters of its suite; None where it asks for nothing."""

    policy: str | None = None
    priority: Priority | None = None
    cpus: list[Cpu] | None = None
    loads: dict[str, Count] = Field(default_factory=dict)
    """Processes of each program next to the suite."""
    load_cpus: list[Cpu] | None = None
    governor: str | None = None
    busy_percent: Percent[int] | None = None


class Rival(Config):
    """A thread of another program with the suite's priority or above; DEADLINE comes before every priority.

    Its budget, where it is known, is `runtime_ns` in every `period_ns`.
    """

    name: str
    policy: str
    priority: Priority
    runtime_ns: TimeNs | None = None
    period_ns: TimeNs | None = None


class Observed(Config):
    """What was in effect while the suite measured: every value that was seen; for `loads`, the fewest processes."""

    policy: list[str] = Field(default_factory=list)
    priority: list[Priority] = Field(default_factory=list)
    cpus: list[Cpu] = Field(default_factory=list)
    loads: dict[str, Count] = Field(default_factory=dict)
    load_cpus: list[Cpu] = Field(default_factory=list)
    governor: list[str] = Field(default_factory=list)
    busy_percent: Percent[float] | None = None
    sched_rt_runtime_us: list[RtRuntimeUs] = Field(default_factory=list)
    temperature_mc: Range[TemperatureMc] | None = None
    frequency_khz: Range[FrequencyKhz] | None = None
    load_1min: Range[LoadAverage] | None = None
    rivals: list[Rival] = Field(default_factory=list)
    observations: Count = 0
    """How many observations were made while the suite measured."""


class RunRecord(Config):
    """run.json. `outputs` are the names of what the programs wrote, without their endings."""

    schema_number: Literal[2] = Field(alias="schema")
    run: str
    campaign: str
    attempt: str = ""
    suite: str
    subject: Subject = "started"
    parameters: Parameters
    deadline_ns: TimeNs | None = None
    """What the run was measured for; None: nothing of its own."""
    condition: str = IDLE
    settings: Settings = Field(default_factory=dict)
    repeat: Count = 1
    seed: Seed | None = None
    variant: str = ""
    """In a campaign with variants: the variant of this run."""
    kernel: KernelName | None = None
    """In a campaign with kernels: the kernel of this run."""
    trace: str = ""
    """The values that the campaign wants traced, as in `Run.trace`; the threshold in effect is in the parameters."""
    observed_by: str = ""
    """For a stream of an observation: the run that observed it."""
    coverage: Coverage | None = None
    """For an observation and its streams: how long it was asked to see, and how long it saw."""
    platform: Annotated[Platform, Field(strict=False)]
    platform_evidence: str
    """How the platform was found out."""
    status: Annotated[RunStatus, Field(strict=False)]
    reason: str | None
    unrelated_end: Annotated[UnrelatedEnd | None, Field(strict=False)] = None
    """None where the end may be related to lateness, and for a run that went to its end."""
    requested: Requested = Field(default_factory=Requested)
    in_effect: Observed = Field(default_factory=Observed)
    start_time: Moment
    end_time: Moment
    programs: list[ProgramRecord] = Field(default_factory=list)
    outputs: list[Name]
    refused: dict[str, str] = Field(default_factory=dict)
    """Files that were not copied from the target, name to reason."""
    target: TargetFacts
    files: dict[Name, FileRecord]

    def asked(self, question: Question) -> Question | None:
        """The question for this run, with its own deadline unless `question` names one; None: it has no deadline."""
        deadline_ns = question.deadline_ns or self.deadline_ns
        return replace(question, deadline_ns=deadline_ns) if deadline_ns else None

    @property
    def duration_s(self) -> float:
        """The time from begin to end, in seconds; 0 where it is unknown, or if the clock was set back in between."""
        start, end = moment(self.start_time), moment(self.end_time)
        return max(0.0, (end - start).total_seconds()) if start and end else 0.0

    @property
    def rates(self) -> dict[str, Rate]:
        """The rates of its programs that were asked for a rate, by name."""
        return {program.name: program.rate for program in self.programs if program.rate and program.rate.asked_hz}

    @property
    def is_off_rate(self) -> bool:
        """Whether the run is invalid, and its publisher missed the requested rate."""
        return self.status is RunStatus.INVALID and any(
            rate.off > OFF_MAX for name, rate in self.rates.items() if name in suite(self.suite).program_json
        )

    @property
    def preempt_rt(self) -> bool:
        """Whether the kernel was PREEMPT_RT; also true where that is not known, as for an imported file."""
        return self.target.preempt_rt is not False

    @property
    def circumstances(self) -> dict[str, Value]:
        """The parameters, and what ran or was set besides the suite; runs with equal circumstances are alike.

        Runs that keep the traces above the same quantile are alike, even though each has its own threshold. Where no
        middleware is named, the suite measured through its own.
        """
        condition: dict[str, Value] = {} if self.condition == IDLE else {"condition": self.condition}
        settings = {key: value for key, value in self.settings.items() if value not in (None, "")}
        of_campaign: dict[str, Value] = {"variant": self.variant, "kernel": self.kernel, "trace": self.trace}
        parameters = {key: value for key, value in self.parameters.items() if key != TRACE_PARAMETER or not self.trace}
        if self.suite in suites().suites:
            parameters["middleware"] = middleware_of(self.suite, parameters)
        return parameters | condition | settings | {key: value for key, value in of_campaign.items() if value}

    def to_json(self) -> str:
        """The text of run.json: what was set, without defaults."""
        return self.model_dump_json(by_alias=True, exclude_unset=True, indent=2) + "\n"


def is_closed(folder: Path) -> bool:
    """Whether a run directory has its closing record; without it, nothing in the directory may be analysed."""
    return (folder / FILE).is_file()


def read_record(folder: Path) -> RunRecord:
    """Read the closing record of a run directory. Raises UsageError when there is none, or it is wrong."""
    if not is_closed(folder):
        raise UsageError(f"{folder}: incomplete run, it has no {FILE}: nothing in it is analysed, run it again")
    record = read_json(folder / FILE, RunRecord)
    for name in [*record.files, *record.outputs]:
        if name in (".", "..") or "/" in name or "\0" in name:
            raise UsageError(f"{folder / FILE}: {name!r} is no name of a file in the run directory")
    return record


# A file changed so recently may change again within the same time stamp; FAT has a resolution of 2 s.
SETTLED_NS = 3_000_000_000
_digests: dict[tuple[int, ...], str] = {}


def _digest(path: Path) -> tuple[int, str]:
    """Size in bytes and SHA-256 of a file; an unchanged file is read only once."""
    with path.open("rb") as stream:
        state = os.fstat(stream.fileno())
        key = (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
        digest = _digests.get(key) or hashlib.file_digest(stream, "sha256").hexdigest()
    if time.time_ns() - state.st_ctime_ns > SETTLED_NS:
        _digests[key] = digest
    return state.st_size, digest


def check_file(folder: Path, record: RunRecord, name: str) -> None:
    """Refuse a file that is not the one that the record was closed with. Raises UsageError."""
    path = folder / name
    if name not in record.files:
        raise UsageError(f"{folder / FILE}: {name!r} is not among its files")
    if path.is_symlink() or not path.is_file():
        raise UsageError(f"{path}: named in {FILE}, but no such file")
    try:
        found = _digest(path)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    expected = record.files[name]
    if found != (expected.size_bytes, expected.sha256):
        raise UsageError(f"{path}: altered since the run was closed: size or checksum is not that in {FILE}")


def verify(folder: Path) -> RunRecord:
    """Return the record of a run directory if all files are those it was closed with. Raises UsageError."""
    record = read_record(folder)
    for name in record.files:
        check_file(folder, record, name)
    return record


def is_finished(folder: Path) -> bool:
    """Whether a run is closed with status ok and its files are those that it was closed with."""
    try:
        return verify(folder).status is RunStatus.OK
    except UsageError:
        return False
