"""run.json, the closing record of a run directory (docs/formats.md): one type for who writes it and who reads it."""

import hashlib
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from rtfiles.config import Config, read_json
from rtfiles.errors import UsageError
from rtrun.plan.conditions import IDLE
from rtrun.plan.run import KernelName
from rtrun.plan.suites import Value
from rtrun.plan.trace import PARAMETER as TRACE_PARAMETER
from rtrun.target.inspection import Fact
from rtrun.target.platform import Platform

FILE = "run.json"

Count = Annotated[int, Field(ge=0)]
Name = Annotated[str, Field(min_length=1, max_length=255)]
Range = list[int | float] | None
"""The lowest and the highest value."""


class RunStatus(StrEnum):
    """What became of a run. INVALID: it ended well, but not as asked for, or its numbers do not add up."""

    OK = "ok"
    FAILED = "failed"
    INCOMPLETE = "incomplete"
    INVALID = "invalid"


class ProgramRecord(Config):
    """A program that ran; no exit status: something else than the program ended it."""

    name: str
    argv: list[str]
    exit_status: int | None


class FileRecord(Config):
    """Size and checksum of a file in the run directory."""

    size_bytes: Count
    sha256: str


class Clock(Config):
    """The clock a run was measured with, as the kernel names it and what wakes its timers; `step_ns` may be unknown."""

    source: Fact
    event: Fact
    step_ns: int | None


class TargetFacts(Config):
    """The target at the begin of a run; of an imported file only the name is known."""

    name: str
    address: str = ""
    preempt_rt: bool | None = None
    cpus: Count | None = None
    kernel_release: Fact = None
    kernel_version: Fact = None
    machine: Fact = None
    boot_id: Fact = None
    clocksource: Fact = None
    governor: Fact = None
    roscpp_version: Fact = None
    ros_setup: Fact = None
    """The shell file that set up ROS for the run."""
    clock: Clock | None = None


class Requested(Config):
    """What a run asks for beside its suite's own parameters; None where it asks for nothing."""

    policy: str | None = None
    priority: int | None = None
    cpus: list[int] | None = None
    loads: dict[str, int] = Field(default_factory=dict)
    """Processes of each program beside the suite."""
    load_cpus: list[int] | None = None
    governor: str | None = None
    busy_percent: int | None = None


class Rival(Config):
    """A thread of another program with the priority of the suite or above."""

    name: str
    policy: str
    priority: int


class Observed(Config):
    """What was in effect while the suite measured: every value that was seen, of `loads` the fewest processes."""

    policy: list[str] = Field(default_factory=list)
    priority: list[int] = Field(default_factory=list)
    cpus: list[int] = Field(default_factory=list)
    loads: dict[str, int] = Field(default_factory=dict)
    load_cpus: list[int] = Field(default_factory=list)
    governor: list[str] = Field(default_factory=list)
    busy_percent: float | None = None
    sched_rt_runtime_us: list[int] = Field(default_factory=list)
    temperature_mc: Range = None
    frequency_khz: Range = None
    load_1min: Range = None
    rivals: list[Rival] = Field(default_factory=list)
    looks: Count = 0
    """Observations while the suite measured."""


class RunRecord(Config):
    """run.json; `outputs` are the names, without ending, of what the programs wrote."""

    schema_number: Literal[2] = Field(alias="schema")
    run: str
    campaign: str
    attempt: str = ""
    suite: str
    parameters: dict[str, Value]
    condition: str = IDLE
    settings: dict[str, Value] = Field(default_factory=dict)
    repeat: int = 1
    seed: int | None = None
    variant: str = ""
    """Of a campaign with variants: which of them this run is of."""
    kernel: KernelName | None = None
    """Of a campaign with kernels: which of them this run was measured on."""
    trace: str = ""
    """What the campaign asked traces for, as `Run.trace`; the threshold in effect is in the parameters."""
    platform: Annotated[Platform, Field(strict=False)]
    platform_evidence: str
    """How the platform is known."""
    status: Annotated[RunStatus, Field(strict=False)]
    reason: str | None
    requested: Requested = Field(default_factory=Requested)
    in_effect: Observed = Field(default_factory=Observed)
    start_time: str
    end_time: str
    programs: list[ProgramRecord]
    outputs: list[Name]
    refused: dict[str, str] = Field(default_factory=dict)
    """Files that were not taken from the target, name to reason."""
    target: TargetFacts
    files: dict[Name, FileRecord]

    @model_validator(mode="before")
    @classmethod
    def _read_schema_1(cls, data: Any) -> Any:
        """Of the first schema, which had `emulated`, as the target file stated it."""
        if not isinstance(data, dict) or data.get("schema") != 1:
            return data
        if not isinstance(data.get("emulated"), bool):
            raise ValueError("emulated: true or false is needed in a record of schema 1")
        platform = Platform.EMULATED if data["emulated"] else Platform.HARDWARE
        kept = {key: value for key, value in data.items() if key != "emulated"}
        return kept | {"schema": 2, "platform": platform, "platform_evidence": "stated, not found on the target"}

    @property
    def preempt_rt(self) -> bool:
        """Whether the kernel was PREEMPT_RT; true where nobody has asked it."""
        return self.target.preempt_rt is not False

    @property
    def circumstances(self) -> dict[str, Value]:
        """The parameters, and what was there beside the suite where there was something: runs of one are alike.

        Runs that keep the traces above one quantile are alike, though each has a threshold of its own.
        """
        condition: dict[str, Value] = {} if self.condition == IDLE else {"condition": self.condition}
        settings = {key: value for key, value in self.settings.items() if value not in (None, "")}
        of_campaign: dict[str, Value] = {"variant": self.variant, "kernel": self.kernel, "trace": self.trace}
        parameters = {key: value for key, value in self.parameters.items() if key != TRACE_PARAMETER or not self.trace}
        return parameters | condition | settings | {key: value for key, value in of_campaign.items() if value}

    def to_json(self) -> str:
        """The text of run.json: what was set, without what is left at its default."""
        return self.model_dump_json(by_alias=True, exclude_unset=True, indent=2) + "\n"


def is_closed(folder: Path) -> bool:
    """Whether a run directory has its closing record; without it, nothing in there may be analysed."""
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


def check_file(folder: Path, record: RunRecord, name: str) -> None:
    """Refuse a file that is not the one the record was closed with. Raises UsageError."""
    path = folder / name
    if name not in record.files:
        raise UsageError(f"{folder / FILE}: {name!r} is not among its files")
    if path.is_symlink() or not path.is_file():
        raise UsageError(f"{path}: named in {FILE}, but no such file")
    try:
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    expected = record.files[name]
    if path.stat().st_size != expected.size_bytes or digest != expected.sha256:
        raise UsageError(f"{path}: altered since the run was closed: size or checksum is not that in {FILE}")


def verify(folder: Path) -> RunRecord:
    """Return the record of a run directory whose files are all those that it was closed with. Raises UsageError."""
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
