"""The programs of a target that can be observed: the processes that map a library with probes, and their threads."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from rtfiles.untrusted import INT64_MAX, whole_number
from rtrun.plan.limits import CPUS_MAX, PID_MAX, RT_PRIORITY_MAX
from rtrun.probes.hits import ObservedProgram, ProgramThread
from rtrun.probes.libraries.description import libraries
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection.facts import POLICIES

if TYPE_CHECKING:
    from rtrun.targets.link import Link

PROGRAMS_MAX = 2000
THREADS_MAX = 20_000
ARGUMENTS_MAX = 1000
# A slow board with some hundred processes needs a second.
FIND_S = 60.0
NAME_CHARACTERS_MAX = 64
# A name has 15 bytes at most, of threads of the kernel some more, and may hold anything: brackets, newlines.
_STAT = re.compile(r"^(\d{1,7}) \((.{0,64}?)\) [A-Za-z]((?: -?\d{1,20}){38,80})$", re.ASCII | re.DOTALL | re.MULTILINE)
_MAPS = re.compile(r"([0-9a-f]{1,16}-[0-9a-f]{1,16}) ([0-9a-f]{1,8}:[0-9a-f]{1,8}) (\d{1,20}) (/.{1,4096})", re.ASCII)
_DELETED = " (deleted)"


@dataclass(frozen=True, kw_only=True, slots=True)
class MappedLibrary:
    """A library with probes as a process maps it; `range` names the mapping below /proc/PID/map_files.

    Of one file all processes have the same `device` and `inode`, unless each sees it through a file system of its own.
    """

    library: str
    path: str
    range: str
    device: str
    inode: int
    is_deleted: bool
    """The file was removed, or another one stands in its place."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundProgram:
    """A program and the libraries with probes that it maps."""

    program: ObservedProgram
    mapped: tuple[MappedLibrary, ...]


def pattern() -> str:
    """What find_programs.sh is called with."""
    return f"/({'|'.join(library.file for library in libraries().values())})( .deleted.)?$"


def find_programs(link: "Link", scripts: PurePosixPath) -> tuple[FoundProgram, ...]:
    """Ask a target for the programs that can be observed; it is not changed. Raises TargetError."""
    text = link.check([str(scripts / "find_programs.sh"), pattern()], deadline_s=FIND_S)
    return parse_programs(text, str(link.target.address))


def parse_programs(text: str, origin: str) -> tuple[FoundProgram, ...]:
    """Read what find_programs.sh printed. A process that ended meanwhile is left out.

    Raises TargetError with the origin for what is no output of it.
    """
    programs: dict[int, FoundProgram] = {}
    threads = 0
    try:
        for pid, lines in _blocks(text):
            found = _program(pid, lines)
            if found is not None:
                programs[pid] = found
                threads += len(found.program.threads)
            if len(programs) > PROGRAMS_MAX or threads > THREADS_MAX:
                raise ValueError(f"more than {PROGRAMS_MAX} programs or {THREADS_MAX} threads")
    except ValueError as error:
        raise TargetError(f"{origin}: what find_programs.sh printed cannot be read: {error}") from None
    return tuple(programs.values())


def _blocks(text: str) -> Iterator[tuple[int, list[str]]]:
    lines: list[str] | None = None
    pid = 0
    for line in text.split("\n"):
        word, _, rest = line.partition(" ")
        if lines is None:
            if line:
                if word != "program":
                    raise ValueError(f"expected 'program PID', got {line[:40]!r}")
                lines, pid = [], whole_number(rest, lowest=1, highest=PID_MAX)
        elif word == "end" and rest == str(pid):
            yield pid, lines
            lines = None
        else:
            lines.append(line)
    if lines is not None:
        raise ValueError(f"it ends within program {pid}")


def _program(pid: int, lines: Iterable[str]) -> FoundProgram | None:
    """Read the lines of one process; None where it has ended, or maps nothing any more."""
    parts: dict[str, list[str]] = {"argument": [], "locked": [], "stat": [], "cpus": [], "maps": []}
    part = parts["argument"]
    for line in lines:
        word, _, rest = line.partition(" ")
        if word in parts:
            part = parts[word]
            part.append(rest)
        elif part is parts["stat"] and line:
            # A name of a thread with a newline.
            part[-1] += f"\n{line}"
    cpus = dict(_cpus(line) for line in parts["cpus"][:THREADS_MAX])
    threads, start_ticks, name = [], None, ""
    for match in _STAT.finditer("\n".join(parts["stat"])):
        thread, ticks = _thread(match, cpus)
        threads.append(thread)
        if thread.tid == pid:
            start_ticks, name = ticks, thread.name
    mapped = tuple({each.path: each for each in map(_mapped, parts["maps"]) if each is not None}.values())
    if start_ticks is None or not mapped:
        return None
    locked = parts["locked"][0].removesuffix(" kB") if parts["locked"] else "0"
    program = ObservedProgram(
        pid=pid,
        start_ticks=start_ticks,
        name=name,
        argv=tuple(each.replace("\1", "\n") for each in parts["argument"][:ARGUMENTS_MAX]),
        locked_bytes=whole_number(locked, lowest=0, highest=INT64_MAX // 1024) * 1024,
        libraries=tuple(each.path for each in mapped),
        threads=tuple(threads),
    )
    return FoundProgram(program=program, mapped=mapped)


def _thread(match: re.Match[str], cpus: dict[int, tuple[int, ...]]) -> tuple[ProgramThread, int]:
    """A thread and its start time, of the fields that proc(5) numbers from 1; match[3] begins with the fourth."""
    fields = match[3].split()
    tid = whole_number(match[1], lowest=1, highest=PID_MAX)
    policy = whole_number(fields[41 - 4], lowest=0, highest=255)
    thread = ProgramThread(
        tid=tid,
        name=match[2][:NAME_CHARACTERS_MAX],
        policy=POLICIES.get(policy, str(policy)),
        priority=whole_number(fields[40 - 4], lowest=0, highest=RT_PRIORITY_MAX),
        cpus=cpus.get(tid, ()),
    )
    return thread, whole_number(fields[22 - 4], lowest=0)


def _cpus(line: str) -> tuple[int, tuple[int, ...]]:
    """A thread and the CPUs it may run on, of a line as ``12 0-1,3``."""
    tid, _, ranges = line.replace("\t", " ").partition(" ")
    cpus: set[int] = set()
    for each in ranges.strip().split(",")[:CPUS_MAX]:
        first, _, last = each.partition("-")
        begin = whole_number(first, lowest=0, highest=CPUS_MAX)
        cpus.update(range(begin, whole_number(last or first, lowest=begin, highest=CPUS_MAX) + 1))
    return whole_number(tid, lowest=1, highest=PID_MAX), tuple(sorted(cpus))


def _mapped(line: str) -> MappedLibrary | None:
    """A mapping; None where its file is no library with probes after all."""
    match = _MAPS.fullmatch(line)
    if match is None:
        raise ValueError(f"no mapping of a file: {line[:80]!r}")
    path = match[4].removesuffix(_DELETED)
    library = next((name for name, each in libraries().items() if each.is_file(path)), None)
    if library is None:
        return None
    return MappedLibrary(
        library=library,
        path=path,
        range=match[1],
        device=match[2],
        inode=whole_number(match[3], lowest=0, highest=2**64),
        is_deleted=match[4].endswith(_DELETED),
    )
