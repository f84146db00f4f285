"""Which probes observe which libraries of a target: the symbols of its own files, resolved here and cached."""

import hashlib
import re
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from rtfiles import cache
from rtfiles.untrusted import MIB, read_bytes
from rtrun.probes.hits import RAW
from rtrun.probes.libraries.description import Argument, Named, Probe, libraries
from rtrun.probes.programs import MappedLibrary, ObservableProgram
from rtrun.probes.symbols import FILE_BYTES_MAX, LibrarySymbols, NotProbed, read_symbols
from rtrun.probes.values import recorded
from rtrun.targets.errors import ConnectionLost, TargetError, TargetGone

if TYPE_CHECKING:
    from rtrun.targets.link import Link

KIND = "probed-libraries"
# Limits for the different files of all programs together: their number, their bytes, and the time to bring them here.
# Further files get no probes. A robot has a handful, and each of its containers has one more of each.
FILES_MAX = 256  #: different files in which probes are placed
FILES_BYTES_MAX = 512 * MIB  #: bytes of all these files
FETCH_S = 600.0  #: bringing these files here
# Long enough for a board to compute the checksums of some MiB from an SD card.
LOOK_S = 120.0
# Since Linux 5.3 several probes may form one event, and the kernel recognizes a second probe at the same place of the
# same file.
_SHARED_SINCE = (5, 3)
# Each path is compared with the mapping: a program in a container, or in a folder of its own, sees other files by the
# same path, and the file may have been replaced. tracefs ends a path at a blank and a line at #, and the kernel writes
# a newline in a path as \012: a file with such a path is opened by its mapping.
_LOOK = r"""
cat /proc/sys/kernel/osrelease
done=
while IFS=' ' read -r key pid range path; do
    case $done in *" $key "*) continue ;; esac
    mapped=/proc/$pid/map_files/$range
    for file in "$path" "/proc/$pid/root$path" "$mapped"; do
        case $file in *[[:space:]#\\]*) continue ;; esac
        [ "$file" -ef "$mapped" ] && break
    done
    true <"$file" || continue
    # Of one that is too large there is no need to know how much: anybody can make a sparse file of any size.
    size=$(head -c 67108865 <"$file" | wc -c) && digest=$(head -c 67108864 <"$file" | sha256sum) &&
        printf '%s\n' "$pid $range $size ${digest%% *} $file" &&
        done="$done $key "
done 2>/dev/null
exit 0
"""
_LOOKED = re.compile(r"(\d{1,7}) ([0-9a-f]{1,16}-[0-9a-f]{1,16}) (\d{1,20}) ([0-9a-f]{64}) (/\S{1,4200})", re.ASCII)


@dataclass(frozen=True, kw_only=True, slots=True)
class PlacedProbe:
    """A probe to be placed: `name` is that of its event in the target's trace, `line` is its definition for tracefs.

    watch_probes.sh takes the line, without the group: ``p NAME SHA256 PATH:OFFSET ARGUMENT...``.
    """

    name: str
    line: str
    event: str
    arguments: Mapping[str, Argument]
    constants: Mapping[str, str | int]
    path: str
    """The library's path, as its programs see it."""
    is_stepped: bool = False
    """Whether each call takes microseconds longer than at other probes."""

    @property
    def needs_raw(self) -> bool:
        """Whether its times may be of CLOCK_MONOTONIC_RAW."""
        return any(
            isinstance(argument, Named) and RAW in argument.names.values() for argument in self.arguments.values()
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class RefusedProbe:
    """A probe that is not placed; `event` is empty if no probe of this library is placed."""

    path: str
    event: str
    reason: str


def refusals(refused: Sequence[RefusedProbe]) -> tuple[str, ...]:
    """The probes that were not placed, and why: a sentence for each library and reason."""
    alike: dict[tuple[str, str], list[str]] = {}
    for probe in refused:
        alike.setdefault((probe.path, probe.reason.rpartition(": ")[2]), []).append(probe.event)
    return tuple(
        f"no probe {', '.join(dict.fromkeys(events)) if all(events) else 'at all'} in {path}: {reason}"
        for (path, reason), events in alike.items()
    )


def costly(placed: Sequence[PlacedProbe]) -> tuple[str, ...]:
    """The probes that cost more than others: a sentence for each library."""
    events: dict[str, list[str]] = {}
    for probe in placed:
        if probe.is_stepped:
            events.setdefault(probe.path, []).append(probe.event)
    return tuple(
        f"each {' or '.join(dict.fromkeys(names))} in {path} takes some 10 us longer: the kernel single-steps there"
        for path, names in events.items()
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Placement:
    """The probes for some programs."""

    probes: tuple[PlacedProbe, ...]
    refused: tuple[RefusedProbe, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class _LibraryFile:
    """A library's file on the target, as it can be opened there."""

    size_bytes: int
    sha256: str
    path: str


def place(link: "Link", found: Sequence[ObservableProgram], *, events: Collection[str]) -> Placement:
    """Resolve the probes for the libraries of these programs; only their files are read from the target.

    `events` are the canonical names of the events to be observed. Raises TargetError.
    """
    mapping = [(program, mapped_library) for program in found for mapped_library in program.mapped]
    users: dict[tuple[str, int], list[tuple[ObservableProgram, MappedLibrary]]] = {}
    for program, mapped_library in mapping:
        users.setdefault((mapped_library.device, mapped_library.inode), []).append((program, mapped_library))
    release, files = _look(link, [pair for pairs in list(users.values())[:FILES_MAX] for pair in pairs])
    is_shared = release >= _SHARED_SINCE
    resolved = _resolve_all(link, files.values())

    def symbols_of(mapped_library: MappedLibrary) -> LibrarySymbols | NotProbed:
        if mapped_library.is_deleted:
            return NotProbed("its file was replaced while the program runs: restart the program")
        file = files.get((mapped_library.device, mapped_library.inode))
        if file is None:
            return NotProbed("its file cannot be read, as its program has ended meanwhile, or this user is not root")
        return resolved[file.sha256]

    probes: list[PlacedProbe] = []
    refused: list[RefusedProbe] = []
    numbers: dict[str, int] = {}
    left_out: dict[str, RefusedProbe] = {}
    for number_of_file, (key, of_file) in enumerate(users.items()):
        # The file may be deleted under one of its names.
        mapped = next((mapped_library for _, mapped_library in of_file if not mapped_library.is_deleted), of_file[0][1])
        if number_of_file >= FILES_MAX:
            reason = f"probes are placed in {FILES_MAX} different files at most"
            left_out.setdefault(mapped.library, RefusedProbe(path=mapped.path, event="", reason=reason))
            continue
        symbols = symbols_of(mapped)
        besides = [
            {mapped_library.library: symbols_of(mapped_library) for mapped_library in program.mapped}
            for program, _ in of_file
        ]
        if isinstance(symbols, NotProbed):
            refused.append(RefusedProbe(path=mapped.path, event="", reason=symbols.reason))
            continue
        file = files[key]
        number = numbers.setdefault(file.sha256 if is_shared else str(key), len(numbers))
        library = libraries()[mapped.library]
        for index, probe in enumerate(library.probes):
            if probe.event not in events or not probe.is_in(mapped.path):
                continue
            is_for = _is_for_any(probe, besides)
            if isinstance(is_for, NotProbed):
                refused.append(RefusedProbe(path=mapped.path, event=probe.event, reason=is_for.reason))
            if is_for is not True:
                continue
            name = f"{probe.event}_{number}_{index}"
            # By the checksum, watch_probes.sh sees that the path still names this file.
            line = line_of(probe, symbols, f"{name} {file.sha256}", file.path, library.without)
            if isinstance(line, NotProbed):
                refused.append(RefusedProbe(path=mapped.path, event=probe.event, reason=line.reason))
                continue
            probes.append(
                PlacedProbe(
                    name=name,
                    line=line,
                    event=probe.event,
                    arguments=probe.arguments[symbols.architecture],
                    constants=probe.constants,
                    path=mapped.path,
                    is_stepped=symbol_of(probe, symbols) in symbols.stepped,
                )
            )
    return Placement(probes=tuple(probes), refused=(*refused, *left_out.values()))


def _is_for_any(probe: Probe, besides: Sequence[Mapping[str, LibrarySymbols | NotProbed]]) -> bool | NotProbed:
    """Whether a probe is for the release of the programs that map a file; `besides` has the libraries of each program.

    Programs of unknown release do not count if the release of another one is known.
    """
    answers = [_is_for(probe, beside) for beside in besides]
    known = {answer for answer in answers if not isinstance(answer, NotProbed)}
    if len(known) == 2:
        return NotProbed("its arguments differ between releases, and its programs are of several")
    return known.pop() if known else answers[0]


def _is_for(probe: Probe, symbols: Mapping[str, LibrarySymbols | NotProbed]) -> bool | NotProbed:
    """Whether a probe is for the release of a program's libraries."""
    for beside, expected in ((probe.only_with, True), (probe.only_without, False)):
        if beside is None:
            continue
        other = symbols.get(beside.library, NotProbed("the program does not map it"))
        if isinstance(other, NotProbed):
            return NotProbed(f"its arguments differ between releases, which {beside.library} tells: {other.reason}")
        if (beside.symbol in other.offsets) is not expected:
            return False
    return True


def line_of(probe: Probe, symbols: LibrarySymbols, name: str, path: str, without: str) -> str | NotProbed:
    """The line that defines a probe in tracefs."""
    values = probe.arguments.get(symbols.architecture)
    if values is None:
        return NotProbed(f"nothing is known of its arguments on {symbols.architecture}")
    symbol = symbol_of(probe, symbols)
    if symbol is None:
        return NotProbed(f"it has no function {probe.symbols[0]}: {without}")
    offset = symbols.offsets[symbol]
    if isinstance(offset, NotProbed):
        return NotProbed(f"{symbol}: {offset.reason}")
    words = [f"{value}={fetch}" for value, fetch in recorded(values).items()]
    return " ".join(["p", name, f"{path}:{offset:#x}", *words])


def symbol_of(probe: Probe, symbols: LibrarySymbols) -> str | None:
    """The function that a probe takes; None if a library has none of them."""
    return next((symbol for symbol in probe.symbols if symbol in symbols.offsets), None)


def _look(
    link: "Link", users: Collection[tuple[ObservableProgram, MappedLibrary]]
) -> tuple[tuple[int, ...], dict[tuple[str, int], _LibraryFile]]:
    """Ask for the kernel's release, and for the files that these processes map, by device and inode.

    A process may have ended meanwhile: each file is read through the first process that shows it.
    """
    asked = {(program.program.pid, library.range): library for program, library in users if not library.is_deleted}
    stdin = "".join(
        f"{library.device}-{library.inode} {pid} {library.range} {library.path}\n"
        for (pid, _), library in asked.items()
    )
    first, *lines = link.check(["sh", "-c", _LOOK], deadline_s=LOOK_S, stdin=stdin).split("\n")
    release = tuple(int(number) for number in re.findall(r"\d{1,4}", first, re.ASCII)[:2])
    files = {}
    for line in filter(None, lines):
        match = _LOOKED.fullmatch(line)
        key = (int(match[1]), match[2]) if match is not None else None
        if match is None or key not in asked:
            raise TargetError(f"{link.target.address}: no answer about a library: {line[:80]!r}")
        library, path, size_bytes = asked[key], match[5], int(match[3])
        mapped = f"/proc/{key[0]}/map_files/{library.range}"
        if path not in (library.path, f"/proc/{key[0]}/root{library.path}", mapped):
            raise TargetError(f"{link.target.address}: asked about {library.path}, it answers about {path[:200]!r}")
        files[library.device, library.inode] = _LibraryFile(size_bytes=size_bytes, sha256=match[4], path=path)
    return release, files


def _resolve_all(link: "Link", files: Collection[_LibraryFile]) -> dict[str, LibrarySymbols | NotProbed]:
    """The functions of each file, by its SHA-256; if a file cannot be read, the next of the same content is tried."""
    resolved: dict[str, LibrarySymbols | NotProbed] = {}
    size_bytes, end_s = 0, time.monotonic() + FETCH_S
    for file in files:
        if isinstance(resolved.get(file.sha256), LibrarySymbols):
            continue
        size_bytes += min(file.size_bytes, FILE_BYTES_MAX)
        if size_bytes > FILES_BYTES_MAX or time.monotonic() > end_s:
            limit = f"{FILES_BYTES_MAX // MIB} MiB in {FETCH_S:g} s"
            resolved[file.sha256] = NotProbed(f"the libraries before it took the room or time there is: {limit}")
        else:
            resolved[file.sha256] = _resolve(link, file)
    return resolved


def _resolve(link: "Link", file: _LibraryFile) -> LibrarySymbols | NotProbed:
    """Find all functions that any probe may need in a file of the target, which is brought here once.

    Its program may end meanwhile, and anybody may change a library of their own: then only this file gets no probes.
    """
    if file.size_bytes > FILE_BYTES_MAX:
        return NotProbed(f"it has more than {FILE_BYTES_MAX} bytes, as no library has")

    def download(folder: Path) -> None:
        path = PurePosixPath(file.path)
        link.do(lambda connection: connection.download(path.parent, {path.name: file.size_bytes}, folder))
        data = read_bytes(folder / path.name, max_bytes=FILE_BYTES_MAX)
        if hashlib.sha256(data).hexdigest() != file.sha256:
            raise TargetError(f"{file.path} changed")
        (folder / path.name).rename(folder / "library")

    known = libraries().values()
    probes = [probe for library in known for probe in library.probes]
    names = {symbol for probe in probes for symbol in probe.symbols}
    names |= {beside.symbol for probe in probes for beside in (probe.only_with, probe.only_without) if beside}
    try:
        library = cache.entry(KIND, file.sha256, download) / "library"
    except (ConnectionLost, TargetGone):
        raise
    except TargetError:
        return NotProbed("its file cannot be read any more: its program has ended meanwhile, or the file was changed")
    return read_symbols(library, names)
