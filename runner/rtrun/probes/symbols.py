"""Where a function begins in a library's file, read from the file itself, which comes from a target.

A probe is placed at an offset of the file. If the offset is not certain, there is a reason instead: a probe at any
other place makes programs compute wrongly.
"""

import re
import struct
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.untrusted import read_bytes
from rtrun.probes.libraries.description import Architecture
from rtrun.targets.inspection import architecture

FILE_BYTES_MAX = 64 * 1024 * 1024  #: a library of the target whose functions are searched
SYMBOLS_MAX = 200_000  #: symbols of such a library; libroscpp has 5000
# The parts of a file that are loaded, and those that a linker knows: libraries have about 10 and 40.
SEGMENTS_MAX = 256  #: segments of such a library
SECTIONS_MAX = 4096  #: sections of such a library
# elf(5): the structures of little-endian files by their bits, and which of their numbers are read. Header: where
# segments and sections begin, the size and the number of each. Segment: type, flags, offset, address, size. Section:
# type, offset, size, linked section. Symbol: name, value, type, section.
_BITS = {1: 32, 2: 64}
_HEADER = {64: struct.Struct("<18xH12xQQ6xHHHH2x"), 32: struct.Struct("<18xH8xII6xHHHH2x")}
_SEGMENT = {64: (struct.Struct("<IIQQ8xQ16x"), (0, 1, 2, 3, 4)), 32: (struct.Struct("<III4xI4xI4x"), (0, 4, 1, 2, 3))}
_SECTION = {64: struct.Struct("<4xI16xQQI20x"), 32: struct.Struct("<4xI8xIII12x")}
_SYMBOL = {64: (struct.Struct("<IBBHQQ"), (0, 4, 1, 3)), 32: (struct.Struct("<IIIBBH"), (0, 1, 3, 5))}
_LOADED, _DYNAMIC_SYMBOLS = 1, 11
_FUNCTION = 2
_UNDEFINED = 0
# The machine of ELF's header, its class in bits.
_ARCHITECTURES: dict[tuple[int, int], Architecture] = {(62, 64): "x86_64", (183, 64): "aarch64", (40, 32): "armv7"}
_EXECUTABLE = 1
# Functions on x86 begin with this instruction if jumps are guarded, as in Ubuntu; it does nothing. The kernel executes
# it by a single step, which takes 9 us on a virtual machine. It emulates a push, which mostly follows, in 0.7 us: also
# that of r8 to r15, a nop of one byte, calls and jumps to a fixed place (arch/x86/kernel/uprobes.c).
_ENDBR64 = bytes.fromhex("f30f1efa")
_EMULATED = re.compile(rb"\x41?[\x50-\x57]|[\x70-\x7f\x90\xe8\xe9\xeb]|\x0f[\x80-\x8f]")


@dataclass(frozen=True, slots=True)
class NotProbed:
    """Why there is no probe at a function."""

    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LibrarySymbols:
    """The wanted functions of one file: the offset of the first instruction of each, or why it has none.

    Names that are missing here are not in the file.
    """

    architecture: Architecture
    offsets: dict[str, int | NotProbed]
    stepped: frozenset[str] = frozenset()
    """Those at which the kernel has to execute the program's instruction by a single step."""


def read_symbols(path: Path, names: Collection[str]) -> LibrarySymbols | NotProbed:
    """Find functions in the table of dynamic symbols, which every library has. Raises nothing, whatever the file."""
    try:
        data = read_bytes(path, max_bytes=FILE_BYTES_MAX)
    except UsageError as error:
        return NotProbed(str(error))
    try:
        return _read(data, names)
    except (ValueError, OverflowError, struct.error) as error:
        return NotProbed(f"no library that can be read: {str(error)[:120]}")


def _read(data: bytes, names: Collection[str]) -> LibrarySymbols | NotProbed:
    """Read a file by offsets alone. Raises ValueError, and struct.error or OverflowError for offsets beyond its end."""
    if len(data) < architecture.HEADER_BYTES or not data.startswith(b"\x7fELF") or data[4] not in _BITS:
        raise ValueError("it does not begin as a program or library")
    bits = _BITS[data[4]]
    machine = int.from_bytes(data[18:20], "little")
    made_for = _ARCHITECTURES.get((machine, bits)) if data[5] == 1 else None
    if made_for is None:
        known = ", ".join(_ARCHITECTURES.values())
        return NotProbed(f"its architecture is {architecture.name(data)}; probes are known for {known}")
    _, segments_at, sections_at, segment_size, segment_count, section_size, section_count = _HEADER[bits].unpack_from(
        data
    )
    if segment_count > SEGMENTS_MAX or section_count > SECTIONS_MAX:
        return NotProbed(f"it claims {segment_count} segments and {section_count} sections")
    segment, places = _SEGMENT[bits]
    segments = []
    for number in range(segment_count):
        numbers = segment.unpack_from(data, segments_at + number * segment_size)
        kind, flags, offset, address, size = (numbers[place] for place in places)
        if kind == _LOADED and flags & _EXECUTABLE:
            segments.append((address, offset, size))
    sections = [
        _SECTION[bits].unpack_from(data, sections_at + number * section_size)
        for number in range(section_count if sections_at else 0)
    ]
    table = next((section for section in sections if section[0] == _DYNAMIC_SYMBOLS), None)
    if table is None:
        return NotProbed("it has no table of dynamic symbols: its section headers were stripped")
    _, symbols_at, table_bytes, linked = table
    entry, (name_at, value_at, type_at, section_at) = _SYMBOL[bits]
    count = table_bytes // entry.size
    if count > SYMBOLS_MAX or table_bytes > len(data):
        return NotProbed(f"its table claims {count} symbols, more than any library has")
    if linked >= len(sections):
        raise ValueError("its dynamic symbols have no names")
    texts = sections[linked][1]
    # Each name to find, with its terminator. A text without one matches no name, however long it is.
    wanted = {name.encode(): name for name in names}
    longest = max(map(len, wanted), default=0) + 1
    offsets: dict[str, int | NotProbed] = {}
    stepped: set[str] = set()
    for numbers in entry.iter_unpack(data[symbols_at : symbols_at + count * entry.size]):
        begin = texts + numbers[name_at]
        text, end, _ = data[begin : begin + longest].partition(b"\0")
        name = wanted.get(text) if end else None
        if name is None or numbers[section_at] == _UNDEFINED:
            continue
        offset = _offset(numbers[value_at], numbers[type_at] & 15, segments)
        if made_for == "x86_64" and isinstance(offset, int) and data.startswith(_ENDBR64, offset):
            offset += len(_ENDBR64)
        if made_for == "x86_64" and isinstance(offset, int) and not _EMULATED.match(data, offset):
            stepped.add(name)
        if name in offsets and offsets[name] != offset:
            offset = NotProbed("its table has two functions of this name")
        offsets[name] = offset
    return LibrarySymbols(architecture=made_for, offsets=offsets, stepped=frozenset(stepped))


def _offset(value: int, kind: int, segments: Collection[tuple[int, int, int]]) -> int | NotProbed:
    """The offset in the file of an address within an executable part."""
    if kind != _FUNCTION:
        return NotProbed(f"it is no plain function (its type is {kind})")
    if value % 2:
        return NotProbed(
            "its address is odd, as that of Thumb code, where the kernel may take a probe that makes the program "
            "compute wrongly; build the library as ARM code (-marm), with aligned functions (-O2)"
        )
    found = [value - address + offset for address, offset, size in segments if address <= value < address + size]
    if len(found) != 1:
        return NotProbed(f"its address {value:#x} is in {len(found)} executable parts of the file, not in one")
    return found[0]
