"""The programs of a target that can be observed: the processes that map a library with probes, and their threads."""

import itertools
import re
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from sys import getsizeof
from typing import TYPE_CHECKING

from rtfiles.output import counted
from rtfiles.untrusted import MIB, whole_number
from rtrun.kinds.limits import COUNT_MAX, CPUS_MAX, PID_MAX, RT_PRIORITY_MAX
from rtrun.probes.hits import ObservedProgram, ProgramThread
from rtrun.probes.libraries.description import libraries
from rtrun.probes.loops import is_asked_for, thread_name
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection.facts import POLICIES
from rtrun.targets.shell import TooMuch

if TYPE_CHECKING:
    from rtrun.targets.connection import Connection
    from rtrun.targets.link import Link

# Limits for a listing, for the live programs of an observation, and for all that it ever had. More are left out.
PROGRAMS_MAX = 2000  #: observed programs
THREADS_MAX = 20_000  #: threads of observed programs
TEXT_BYTES_MAX = 16 * MIB  #: names, paths and arguments of all observed programs, in memory
PROGRAM_BYTES_MAX = 8 * MIB  #: what describes an observed program, as it comes: a thread takes some 350 bytes
ARGUMENTS_MAX = 1000  #: arguments of an observed program
LIBRARIES_MAX = 16  #: libraries with probes of an observed program
CPU_SETS_MAX = 256  #: different sets of CPUs on which observed threads may run
# A slow board with some hundred processes needs a second.
FIND_S = 60.0
# A name has 15 bytes at most (kernel threads have some more) and may contain anything: brackets, newlines. A byte that
# is not UTF-8 is read as four characters.
NAME_CHARACTERS_MAX = 256  #: characters of a thread's name
_STAT = re.compile(r"^(\d{1,7}) \((.{0,256}?)\) [A-Za-z]((?: -?\d{1,20}){38,80})$", re.ASCII | re.DOTALL | re.MULTILINE)
_MAPS = re.compile(r"([0-9a-f]{1,16}-[0-9a-f]{1,16}) ([0-9a-f]{1,8}:[0-9a-f]{1,8}) (\d{1,20}) (/.{1,16384})", re.ASCII)
_CPUS_CHARACTERS_MAX = 65536  #: characters of a set of CPUs of an observed thread
# The sets share these numbers, which would otherwise take more memory than the sets.
_EVERY_CPU = tuple(range(CPUS_MAX))
_DELETED = " (deleted)"
LINE_BYTES_MAX = 64 * 1024  #: a line of an observation
CUT = "…"
"""Ends an argument that was not read to its end, and stands for arguments that were not read."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MappedLibrary:
    """A library with probes as a process maps it; `range` names the mapping below /proc/PID/map_files.

    All processes see the same `device` and `inode` of one file, unless each has a file system of its own.
    """

    library: str
    path: str
    range: str
    device: str
    inode: int
    is_deleted: bool
    """The file was removed or replaced."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ObservableProgram:
    """A program and the libraries with probes that it maps; none if only its loops are observed."""

    program: ObservedProgram
    mapped: tuple[MappedLibrary, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundPrograms:
    """The programs of a target; `left_out` counts those beyond a limit."""

    found: tuple[ObservableProgram, ...]
    left_out: int


def left_out_in_words(number: int) -> str:
    """What is unknown because programs were left out, in words."""
    return (
        f"{counted(number, 'program')} beyond {PROGRAMS_MAX} programs, {THREADS_MAX} threads or "
        f"{TEXT_BYTES_MAX // MIB} MiB of names: their streams are named by their processes"
    )


def pattern() -> str:
    """What find_programs.sh is called with."""
    return f"/({'|'.join(library.file for library in libraries().values())})( .deleted.)?$"


def find_programs(link: "Link", scripts: PurePosixPath, names: Sequence[str] = ()) -> FoundPrograms:
    """Ask a target for the programs that can be observed, without changing anything there. Raises TargetError.

    `names` are those of loops, as PROGRAM or PROGRAM/THREAD.
    """
    script = str(scripts / "find_programs.sh")
    asked = "\n".join(thread_name(name) for name in names if name.isprintable())

    def ask(connection: "Connection") -> FoundPrograms:
        # Read line by line: a large system prints more than is accepted from a command that is read as a whole.
        reader, data = ProgramReader(str(link.target.address), names), bytearray()

        def take(chunk: bytes) -> None:
            data.extend(chunk)
            *lines, rest = data.split(b"\n")
            if len(rest) > LINE_BYTES_MAX:
                raise TooMuch(f"{LINE_BYTES_MAX} bytes in a line")
            data[:] = rest
            for line in lines:
                reader.take(bytes(line))

        status, stderr = connection.shell.execute([script, pattern(), asked], [], take, FIND_S)
        if status != 0:
            last = stderr.strip().rpartition("\n")[2][:300]
            raise TargetError(f"{link.target.address}: find_programs.sh ended with exit status {status}: {last}")
        return reader.end()

    return link.do(ask)


class ProgramReader:
    """Reads a listing of find_programs.sh, a line at a time. A process that ended meanwhile is left out.

    `names` are those of loops. Raises TargetError, with the origin, for anything that the script would not print.
    Programs beyond a limit are left out and counted: a system may have any number of programs, and the others can still
    be observed.
    """

    def __init__(self, origin: str, names: Sequence[str] = ()) -> None:
        self._origin = origin
        self._names = names
        self._pid: int | None = None
        self._lines: list[str] = []
        self._line_bytes = 0
        self._found: dict[int, ObservableProgram] = {}
        self._room = _Room()
        self._left_out = 0
        self._cpu_sets = _CpuSets()

    def take(self, raw: bytes) -> ObservableProgram | None:
        """Take a line, without its end; return the program that it completes."""
        line = raw.decode("utf-8", "backslashreplace")
        try:
            return self._take(line, len(raw))
        except ValueError as error:
            raise TargetError(f"{self._origin}: what find_programs.sh printed cannot be read: {error}") from None

    @property
    def found(self) -> tuple[ObservableProgram, ...]:
        """The programs so far."""
        return tuple(self._found.values())

    def cut(self) -> None:
        """Expect no more lines of this listing: leave out a program that is not complete."""
        self._pid, self._lines = None, []

    def end(self) -> FoundPrograms:
        """All programs, once everything was taken."""
        if self._pid is not None:
            within = f"it ends within program {self._pid}"
            raise TargetError(f"{self._origin}: what find_programs.sh printed cannot be read: {within}")
        return FoundPrograms(found=self.found, left_out=self._left_out)

    def _take(self, line: str, size_bytes: int) -> ObservableProgram | None:
        word, _, rest = line.partition(" ")
        if self._pid is None:
            if line:
                if word != "program":
                    raise ValueError(f"expected 'program PID', got {line[:40]!r}")
                self._pid, self._line_bytes = whole_number(rest, lowest=1, highest=PID_MAX), 0
        elif word == "end" and rest == str(self._pid):
            lines, pid = self._lines, self._pid
            self._lines, self._pid = [], None
            return self._added(pid, lines)
        elif self._line_bytes <= PROGRAM_BYTES_MAX:
            # The object of a short line takes as much memory as the line.
            self._line_bytes += size_bytes + 64
            self._lines.append(line)
        return None

    def _added(self, pid: int, lines: Sequence[str]) -> ObservableProgram | None:
        program = _program(pid, lines, lambda ranges: self._cpu_sets.share(ranges, lambda: _cpus(ranges)))
        if program is None or not (program.mapped or is_asked_for(program.program, self._names)):
            return None
        if not self._room.take(program.program):
            self._left_out += 1
            return None
        self._found[pid] = program
        return program


class _CpuSets:
    """The sets of CPUs that threads may run on. Threads that may run on the same CPUs share one set."""

    def __init__(self) -> None:
        self._known: dict[Hashable, tuple[int, ...]] = {}

    def share(self, key: Hashable, cpus: Callable[[], tuple[int, ...]]) -> tuple[int, ...]:
        """The set of this key, made by `cpus` if the key is new; empty if there are too many sets."""
        if key not in self._known:
            if len(self._known) >= CPU_SETS_MAX:
                return ()
            self._known[key] = cpus()
        return self._known[key]


class _Room:
    """The unused part of the limits on programs that are kept."""

    def __init__(self) -> None:
        self._programs, self._threads, self._text_bytes = PROGRAMS_MAX, THREADS_MAX, TEXT_BYTES_MAX

    def take(self, program: ObservedProgram) -> bool:
        """Reserve room for a program; False if there is none."""
        left = self._programs - 1, self._threads - len(program.threads), self._text_bytes - _text_bytes(program)
        if min(left) < 0:
            return False
        self._programs, self._threads, self._text_bytes = left
        return True

    def give_back(self, program: ObservedProgram) -> None:
        self._programs += 1
        self._threads += len(program.threads)
        self._text_bytes += _text_bytes(program)


class Roster:
    """The programs of an observation: those that live now, and all that it ever saw, with their last state.

    Both have the limits of a listing. `left_out` counts programs for which one of them had no room. Each listing has
    sets of CPUs of its own; all that is kept here has CPU_SETS_MAX together.
    """

    def __init__(self, found: Iterable[ObservableProgram], left_out: int = 0) -> None:
        self.left_out = left_out
        self._alive: dict[int, ObservedProgram] = {}
        self._seen: dict[tuple[int, int], ObservedProgram] = {}
        self._room, self._room_of_seen, self._cpu_sets = _Room(), _Room(), _CpuSets()
        for program in found:
            self.begin(program.program)

    @property
    def alive(self) -> tuple[ObservedProgram, ...]:
        return tuple(self._alive.values())

    @property
    def seen(self) -> tuple[ObservedProgram, ...]:
        return tuple(self._seen.values())

    def begin(self, program: ObservedProgram) -> None:
        """A program is there, or its threads have changed."""
        self.end(program.pid)
        program = replace(program, threads=tuple(map(self._kept, program.threads)))
        key = program.pid, program.start_ticks
        is_new = key not in self._seen
        if not is_new:
            self._room_of_seen.give_back(self._seen.pop(key))
        is_alive, is_seen = self._room.take(program), self._room_of_seen.take(program)
        if is_alive:
            self._alive[program.pid] = program
        if is_seen:
            self._seen[key] = program
        self.left_out += is_new and not (is_alive and is_seen)

    def _kept(self, thread: ProgramThread) -> ProgramThread:
        return replace(thread, cpus=self._cpu_sets.share(thread.cpus, lambda: thread.cpus))

    def end(self, pid: int) -> None:
        """A program has ended."""
        if pid in self._alive:
            self._room.give_back(self._alive.pop(pid))


def _text_bytes(program: ObservedProgram) -> int:
    """What the texts of a program take in memory: a single character may make all of a text four times as long."""
    names = (
        program.name,
        program.file,
        *program.argv,
        *program.libraries,
        *(thread.name for thread in program.threads),
    )
    return sum(map(getsizeof, names))


def _program(pid: int, lines: Iterable[str], cpus_of: Callable[[str], tuple[int, ...]]) -> ObservableProgram | None:
    """Read the lines of one process; None if it has ended."""
    arguments: list[str] = []
    stat: list[str] = []
    cpus: dict[int, tuple[int, ...]] = {}
    mapped: dict[str, MappedLibrary] = {}
    locked, file = "0", ""
    for line in lines:
        word, _, rest = line.partition(" ")
        if word == "argument" and len(arguments) < ARGUMENTS_MAX:
            arguments.append(rest.replace("\1", "\n"))
        elif word == "cut" and len(arguments) < ARGUMENTS_MAX:
            arguments.append(f"{rest}{CUT}".replace("\1", "\n"))
        elif word == "file":
            file = rest[:NAME_CHARACTERS_MAX].removesuffix(_DELETED).replace("\1", "\n")
        elif word == "locked":
            locked = rest.removesuffix(" kB")
        elif word == "stat":
            # A name may have several lines: each comes with this word.
            stat.append(rest)
        elif word == "cpus" and len(cpus) < THREADS_MAX:
            tid, _, ranges = rest.replace("\t", " ").partition(" ")
            cpus[whole_number(tid, lowest=1, highest=PID_MAX)] = cpus_of(ranges.strip())
        elif word == "maps" and len(mapped) < LIBRARIES_MAX and (library := _mapped(rest)) is not None:
            mapped.setdefault(library.path, library)
    threads, start_ticks, name = [], None, ""
    for match in itertools.islice(_STAT.finditer("\n".join(stat)), THREADS_MAX):
        thread, ticks = _thread(match, cpus)
        threads.append(thread)
        if thread.tid == pid:
            start_ticks, name = ticks, thread.name
    if start_ticks is None:
        return None
    program = ObservedProgram(
        pid=pid,
        start_ticks=start_ticks,
        name=name,
        argv=tuple(arguments),
        locked_bytes=whole_number(locked, lowest=0, highest=COUNT_MAX // 1024) * 1024,
        libraries=tuple(mapped),
        threads=tuple(threads),
        file=file,
    )
    return ObservableProgram(program=program, mapped=tuple(mapped.values()))


def _thread(match: re.Match[str], cpus: dict[int, tuple[int, ...]]) -> tuple[ProgramThread, int]:
    """A thread and its start time; proc(5) numbers the fields from 1, and match[3] begins with the fourth."""
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


def _cpus(ranges: str) -> tuple[int, ...]:
    if len(ranges) > _CPUS_CHARACTERS_MAX:
        raise ValueError(f"a list of CPUs of {len(ranges)} characters")
    cpus: list[int] = []
    # In ascending order, as the kernel prints them: no CPU may come twice.
    lowest = 0
    for part in ranges.split(","):
        first, _, last = part.partition("-")
        begin = whole_number(first, lowest=lowest, highest=CPUS_MAX - 1)
        lowest = whole_number(last or first, lowest=begin, highest=CPUS_MAX - 1) + 1
        cpus += _EVERY_CPU[begin:lowest]
    return tuple(cpus)


def _mapped(line: str) -> MappedLibrary | None:
    """A mapping; None if its file is not a library with probes after all."""
    match = _MAPS.fullmatch(line)
    if match is None:
        raise ValueError(f"no mapping of a file: {line[:80]!r}")
    path = match[4].removesuffix(_DELETED)
    library = next((name for name, description in libraries().items() if description.is_file(path)), None)
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
