"""What a target has, inspected before a campaign, and its state before and after every run."""

import gzip
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError

from rtfiles.config import Config
from rtfiles.errors import UsageError
from rtfiles.invocation import as_called
from rtfiles.untrusted import JSON_BYTES_MAX, parse_json, read_text, real_number, whole_number
from rtrun.kinds.limits import (
    COUNT_MAX,
    CPUS_MAX,
    SIZE_MAX_BYTES,
    Count,
    FrequencyKhz,
    Pid,
    Priority,
    RtRuntimeUs,
    TemperatureMc,
    UptimeS,
)
from rtrun.plan.run import KernelName
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import architecture, work_folder

if TYPE_CHECKING:
    from rtrun.targets.config import Target
    from rtrun.targets.link import Link

SCRIPT = ON_TARGET / "inspect.sh"
MIDDLEWARE_SCRIPTS = {path.stem: path for path in sorted((ON_TARGET / "middleware").glob("*.sh"))}
STATE_SCRIPT = ON_TARGET / "state.sh"
_KERNEL_CONFIG = "zcat /proc/config.gz 2>/dev/null || cat /boot/config-$(uname -r) 2>/dev/null; exit 0"
# Numbers of sched_setscheduler(2), as in field 41 of /proc/<pid>/stat (proc(5)).
POLICIES = {0: "OTHER", 1: "FIFO", 2: "RR", 3: "BATCH", 5: "IDLE", 6: "DEADLINE"}
# The names of the lines that inspect.sh prints.
_CODE_NAME = re.compile("[a-z]{1,32}")
_FACTS = frozenset(("missing", "no_locks", "program", "elf", "debian", "cpus", "free_kib", "built"))
# The names of the lines that the script of a middleware prints.
_INSTALLED = frozenset(("setup", "server", "version", "program"))
# Comes before the output of the script of a middleware.
_MIDDLEWARE = "== middleware "
VERSION_MAX = 64  #: characters of the version of a middleware
# Limits of the file that says what suites were built with.
BUILT_WITH_MAX, BUILT_WITH_CHARACTERS = 32, 200
_NAME = re.compile("[a-z][a-z0-9_]{0,63}")
# Sections of state.sh kept as one text. Every other section is one value, or a list if it has several lines.
_TEXTS = ("cpuinfo", "memory", "os_release")
# Lines of /proc/cpuinfo that name a board (ARM) or a processor.
_MODELS = ("Model", "Hardware", "model name")
NAME_MAX = 100  #: characters of the name of a board or processor
_MEMORY = re.compile(r"^MemTotal:[ \t]*([0-9]{1,15}) kB$", re.ASCII | re.MULTILINE)

Fact = str | list[str] | None
"""What the target reports about itself: a list if there are several values, such as the governor of each CPU."""


def fact_text(fact: Fact) -> str | None:
    """A fact in one text; None if the target did not report it."""
    return " ".join(fact) if isinstance(fact, list) else fact


def _number(value: Any) -> Any:
    return whole_number(value) if isinstance(value, str) else value


def _numbers(value: Any) -> Any:
    lines = [value] if isinstance(value, str) else [] if value is None else value
    return [_number(line) for line in lines] if isinstance(lines, list) else value


def _uptime(value: Any) -> Any:
    # The second number is the idle time of the CPUs.
    return real_number(value.partition(" ")[0]) if isinstance(value, str) else value


class RtThread(Config):
    """A real-time thread. The policy is a number if its name is not known; a DEADLINE thread has priority 0."""

    tid: Pid
    name: str
    policy: str
    priority: Priority


class TargetState(Config):
    """The state of a target as stored in target.json; facts that the target does not have are None or empty.

    Numbers may be texts, as the kernel prints them.
    """

    boot_id: Fact = None
    kernel_release: Fact = None
    kernel_version: Fact = None
    machine: Fact = None
    host: Fact = None
    uptime: Annotated[UptimeS | None, BeforeValidator(_uptime)] = None
    """Seconds since the boot."""
    cmdline: Fact = None
    cpus_online: Fact = None
    realtime: Fact = None
    clocksource: Fact = None
    clockevent: Fact = None
    governor: Fact = None
    frequency_khz: Annotated[list[FrequencyKhz], BeforeValidator(_numbers)] = Field(default_factory=list)
    temperature_mc: Annotated[list[TemperatureMc], BeforeValidator(_numbers)] = Field(default_factory=list)
    sched_rt_runtime_us: Annotated[RtRuntimeUs | None, BeforeValidator(_number)] = None
    load: Fact = None
    memory: str | None = None
    os_release: str | None = None
    cpuinfo: str | None = None
    threads: Count = 0
    rt_threads: list[RtThread] = Field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class Installed:
    """What a target has of one middleware."""

    setup: str | None = None
    """The shell file that sets it up for its programs."""
    several: tuple[str, ...] = ()
    """The shell files, if there are several and the target file selects none."""
    server: str | None = None
    """The program that must run in addition to its programs."""
    version: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Equipment:
    """What a target has installed and how much room it has."""

    middlewares: Mapping[str, Installed]
    programs: dict[str, str]
    """Executable name to path, of suites installed on the target."""
    built_with: Mapping[str, str]
    """What the suites on the target were built with, if they were built there; otherwise empty."""
    cpus: int
    free_bytes: int
    architecture: str | None
    """The architecture of the target's programs, as `architecture.name` returns it; None if it is not known."""
    debian: str | None
    """The code name of the target's Debian, such as trixie; None on another system."""

    def installed(self, middleware: str) -> Installed:
        """What the target has of a middleware."""
        return self.middlewares.get(middleware, Installed())


def inspect(link: "Link") -> Equipment:
    """Find tools, middlewares and installed suites, once the work folder is ours alone.

    Raises TargetError naming what is missing and the remedy.
    """
    target = link.target
    work_folder.make(link)
    # Through standard input: nothing can be deployed before it is known that the tools for it are there.
    scripts = [SCRIPT.read_text(encoding="utf-8")]
    for name, path in MIDDLEWARE_SCRIPTS.items():
        scripts.append(f"echo '{_MIDDLEWARE}{name}'\n{path.read_text(encoding='utf-8')}")
    output = link.check(["sh", "-s", str(target.work_dir), target.setup or ""], stdin="".join([*scripts, "exit 0\n"]))
    own, *rest = re.split(rf"^{_MIDDLEWARE}(\w+)$", output, flags=re.MULTILINE)
    facts = _lines_by_name(own, _FACTS)
    found = {name: _lines_by_name(text, _INSTALLED) for name, text in zip(rest[::2], rest[1::2], strict=True)}
    if "missing" in facts:
        raise TargetError(
            f"{target.address}: the target lacks {', '.join(facts['missing'])}: install util-linux, coreutils"
        )
    if "no_locks" in facts:
        raise TargetError(
            f"{target.address}: files in {target.work_dir} cannot be locked ({facts['no_locks'][0][:200]}): the runner "
            "needs a kernel with CONFIG_FILE_LOCKING, and a work_dir on a file system that has locks"
        )
    programs = [*facts.get("program", []), *(path for lines in found.values() for path in lines.get("program", []))]
    return Equipment(
        middlewares={name: _installed(target, lines) for name, lines in found.items()},
        programs={PurePosixPath(path).name: path for path in reversed(programs)},
        built_with=_built_with(facts.get("built", [])),
        cpus=_count(facts.get("cpus"), lowest=1, highest=CPUS_MAX),
        free_bytes=_count(facts.get("free_kib"), lowest=0, highest=SIZE_MAX_BYTES // 1024) * 1024,
        architecture=architecture.name(_header(facts.get("elf", []))),
        debian=next((name for name in facts.get("debian", []) if _CODE_NAME.fullmatch(name)), None),
    )


def missing(link: "Link", needs: Sequence[str]) -> list[str]:
    """Which of these needs a target lacks, in the words of missing.sh; for commands that deploy nothing."""
    script = (ON_TARGET / "missing.sh").read_text(encoding="utf-8")
    return [line[:200] for line in link.check(["sh", "-s", *needs], stdin=script).splitlines()]


def _lines_by_name(text: str, known: Collection[str]) -> dict[str, list[str]]:
    """The values of lines ``name value``, of the names that are known."""
    facts: dict[str, list[str]] = {}
    for line in text.splitlines():
        name, _, value = line.partition(" ")
        if name in known:
            facts.setdefault(name, []).append(value)
    return facts


def _installed(target: "Target", facts: Mapping[str, Sequence[str]]) -> Installed:
    """What a target has of a middleware; if several are installed and its file selects none, the files that set them
    up."""
    setups = facts.get("setup", [])
    if target.setup is None and len(setups) > 1:
        return Installed(several=tuple(setups))
    setup = target.setup or (setups[0] if setups else None)
    servers = facts.get("server", [])
    root = str(PurePosixPath(setup).parent) + "/" if setup else ""
    return Installed(
        setup=setup,
        server=next((path for path in servers if path.startswith(root)), servers[0] if servers else None),
        version=next((text[:VERSION_MAX] for text in facts.get("version", [])), None),
    )


def several_of(target: "Target", equipment: Equipment, middleware: str) -> str | None:
    """Say that several of a middleware are installed and the target file selects none; else None."""
    setups = equipment.installed(middleware).several
    several = f"{target.address}: several ROS ({', '.join(setups)}): put one into the target file as ros_setup"
    return several if setups else None


def _count(values: Sequence[str] | None, *, lowest: int, highest: int) -> int:
    """The number that the target reports, or the lowest if it reports none."""
    try:
        return whole_number(values[0], lowest=lowest, highest=highest) if values else lowest
    except ValueError:
        return lowest


def _built_with(lines: Sequence[str]) -> dict[str, str]:
    """What build_suites.sh noted, in lines ``name value``."""
    pairs = (line.partition(" ")[::2] for line in lines[:BUILT_WITH_MAX])
    return {name: value[:BUILT_WITH_CHARACTERS] for name, value in pairs if _NAME.fullmatch(name) and value}


def _header(lines: Sequence[str]) -> bytes:
    try:
        return bytes.fromhex(" ".join(lines))
    except ValueError:
        return b""


def check_suites(suites: Path, target: "Target", equipment: Equipment) -> None:
    """Raise UsageError when a folder has no suites, or those of another architecture or release of Debian."""
    if not suites.is_dir():
        raise UsageError(f"{suites}: no such folder; suites are built with: {as_called('rtgen')} suites build")
    if not (suites / "build.json").is_file():
        raise UsageError(f"{suites}: has no build.json: name the folder that {as_called('rtgen')} suites build printed")
    release = built_for(suites)
    if release is not None and equipment.debian not in (None, release):
        raise UsageError(
            f"{suites}: suites for Debian {release}, but {target.address} has {equipment.debian}'s libraries: "
            f"build them by {as_called('rtgen')} suites build --suite {equipment.debian}"
        )
    made_for = architecture.of_folder(suites)
    if made_for is not None and equipment.architecture not in (None, made_for):
        raise UsageError(
            f"{suites}: suites for {made_for}, but {target.address} is {equipment.architecture}: "
            f"name suites that were built for its machine by {as_called('rtgen')} suites build --machine"
        )


def built_for(suites: Path) -> str | None:
    """The release of Debian whose libraries suites were linked against, by their build.json; None if it names none."""
    path = suites / "build.json"
    record = parse_json(read_text(path, max_bytes=JSON_BYTES_MAX), str(path))
    release = record.get("debian") if isinstance(record, dict) else None
    return release if isinstance(release, str) else None


def read_state(link: "Link", script: PurePosixPath) -> TargetState:
    """Return the present state of the target."""
    return parse_state(link.check(["sh", str(script)]))


def parse_state(text: str) -> TargetState:
    """Read the output of state.sh. Unknown sections are ignored, and so are values that cannot be right."""
    state: dict[str, Any] = {}
    sections = re.split(r"^== (\w+)$", text, flags=re.MULTILINE)
    for name, body in zip(sections[1::2], sections[2::2], strict=True):
        if name == "threads":
            *lines, count = body.strip().split("\n")
            state["threads"] = _count([count], lowest=0, highest=COUNT_MAX)
            state["rt_threads"] = [thread for line in lines if (thread := _thread(line))]
        elif name in _TEXTS:
            state[name] = body.strip() or None
        elif name in TargetState.model_fields and name != "rt_threads":
            # The longest sections have one line per CPU.
            lines = body.strip().splitlines()[:CPUS_MAX]
            state[name] = lines[0] if len(lines) == 1 else lines or None
    try:
        return TargetState(**state)
    except ValidationError as error:
        wrong = {problem["loc"][0] for problem in error.errors()}
        return TargetState(**{name: value for name, value in state.items() if name not in wrong})


def _thread(line: str) -> RtThread | None:
    """Read a line of /proc/<pid>/task/<tid>/stat; the name may hold blanks and brackets."""
    match = re.match(r"([0-9]{1,9}) \((.{0,64})\) (.+)$", line)
    fields = match.group(3).split() if match else []
    # proc(5) counts from 1 with pid and name before these: rt_priority is field 40, policy 41.
    if match is None or len(fields) < 39:
        return None
    try:
        policy = whole_number(fields[38])
        return RtThread(
            tid=whole_number(match.group(1)),
            name=match.group(2),
            policy=POLICIES.get(policy, str(policy)),
            priority=whole_number(fields[37], lowest=0 if POLICIES.get(policy) == "DEADLINE" else 1),
        )
    except ValueError:
        return None


def processor(state: TargetState) -> str | None:
    """The model of the board and of its processor, as /proc/cpuinfo names them; None if it names neither."""
    lines = [line.partition(":") for line in (state.cpuinfo or "").splitlines()]
    named = {key.strip(): value.strip()[:NAME_MAX] for key, _, value in lines if key.strip() in _MODELS}
    return ", ".join(dict.fromkeys(named[key] for key in _MODELS if named.get(key))) or None


def memory_kib(state: TargetState) -> int | None:
    """The memory that the kernel has, in KiB; None if it is not known."""
    found = _MEMORY.search(state.memory or "")
    return int(found[1]) if found else None


def is_preempt_rt(state: TargetState) -> bool:
    """Whether the kernel calls itself PREEMPT_RT. Only kernels with the out-of-tree patch have /sys/kernel/realtime."""
    return bool(re.search(r"\bPREEMPT[_ ]RT\b", str(state.kernel_version))) or state.realtime == "1"


def running_kernel(link: "Link") -> KernelName:
    """The kernel that the target runs, asked without anything deployed there."""
    state = parse_state(link.check(["sh", "-s"], stdin=STATE_SCRIPT.read_text(encoding="utf-8")))
    return "rt" if is_preempt_rt(state) else "standard"


def read_kernel_config(link: "Link") -> bytes:
    """Return the running kernel's configuration, gzipped; empty if the target does not have it."""
    text = link.check(["sh", "-c", _KERNEL_CONFIG])
    return gzip.compress(text.encode(), mtime=0) if text.strip() else b""
