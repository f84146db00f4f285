"""Where in a library's file a function begins, read from the file itself, which comes from a target.

A probe is placed at an offset of the file. Where that is not certain there is a reason instead: a probe at any other
place makes programs compute wrongly.
"""

import io
import struct
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from rtfiles.errors import UsageError
from rtfiles.untrusted import read_bytes
from rtrun.probes.libraries.description import Architecture

FILE_BYTES_MAX = 64 * 1024 * 1024
# libroscpp has 5000.
SYMBOLS_MAX = 200_000
# The parts of a file that are loaded, and those that a linker knows: of libraries there are 10 and 40.
SEGMENTS_MAX = 256
SECTIONS_MAX = 4096
# A symbol in the table of dynamic symbols, by the bits of the file, and which of its numbers are name, value, type and
# section.
_SYMBOL = {64: (struct.Struct("<IBBHQQ"), (0, 4, 1, 3)), 32: (struct.Struct("<IIIBBH"), (0, 1, 3, 5))}
_FUNCTION = 2
_UNDEFINED = 0
# The machine of ELF's header, its class in bits.
_ARCHITECTURES: dict[tuple[str, int], Architecture] = {
    ("EM_X86_64", 64): "x86_64",
    ("EM_AARCH64", 64): "aarch64",
    ("EM_ARM", 32): "armv7",
}
_EXECUTABLE = 1
# What functions begin with on x86 where jumps are guarded, as in Ubuntu: it does nothing. The kernel has it executed by
# a single step, which takes 9 us on a virtual machine; a push, which mostly follows, it does itself, in 0.7 us.
_ENDBR64 = bytes.fromhex("f30f1efa")


@dataclass(frozen=True, slots=True)
class NotProbed:
    """Why there is no probe at a function."""

    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LibrarySymbols:
    """The functions of one file that were looked for: the offset of each's first instruction, or why it has none.

    Names that are not in here are not in the file.
    """

    architecture: Architecture
    offsets: dict[str, int | NotProbed]


def read_symbols(path: Path, names: Collection[str]) -> LibrarySymbols | NotProbed:
    """Find functions in the table of dynamic symbols, which every library has. Nothing is raised for any file."""
    try:
        data = read_bytes(path, max_bytes=FILE_BYTES_MAX)
    except UsageError as error:
        return NotProbed(str(error))
    try:
        return _read(ELFFile(io.BytesIO(data)), data, names)
    except Exception as error:
        # pyelftools raises what Python raises of a damaged file: its own, of struct, of lists, of memory.
        return NotProbed(f"no library that can be read: {type(error).__name__}: {str(error)[:120]}")


def _read(file: ELFFile, data: bytes, names: Collection[str]) -> LibrarySymbols | NotProbed:
    machine, bits = str(file.header["e_machine"]), file.elfclass
    architecture = _ARCHITECTURES.get((machine, bits)) if file.little_endian else None
    if architecture is None:
        order = "little-endian" if file.little_endian else "big-endian"
        known = ", ".join(_ARCHITECTURES.values())
        return NotProbed(f"its architecture is {machine}, {bits} bits, {order}; probes are known for {known}")
    if file.num_segments() > SEGMENTS_MAX or file.num_sections() > SECTIONS_MAX:
        return NotProbed(f"it claims {file.num_segments()} segments and {file.num_sections()} sections")
    segments = [
        (each["p_vaddr"], each["p_offset"], each["p_filesz"])
        for each in file.iter_segments("PT_LOAD")
        if each["p_flags"] & _EXECUTABLE
    ]
    table = next((each for each in file.iter_sections("SHT_DYNSYM") if isinstance(each, SymbolTableSection)), None)
    if table is None:
        return NotProbed("it has no table of dynamic symbols: its section headers were stripped")
    entry, (name_at, value_at, type_at, section_at) = _SYMBOL[bits]
    count = table["sh_size"] // entry.size
    if count > SYMBOLS_MAX or table["sh_size"] > len(data):
        return NotProbed(f"its table claims {count} symbols, more than any library has")
    texts = table.stringtable["sh_offset"]
    # Each name to find, with its terminator. A text without one matches no name, however long it is.
    wanted = {name.encode(): name for name in names}
    longest = max(map(len, wanted), default=0) + 1
    offsets: dict[str, int | NotProbed] = {}
    for numbers in entry.iter_unpack(data[table["sh_offset"] : table["sh_offset"] + count * entry.size]):
        begin = texts + numbers[name_at]
        text, end, _ = data[begin : begin + longest].partition(b"\0")
        name = wanted.get(text) if end else None
        if name is None or numbers[section_at] == _UNDEFINED:
            continue
        offset = _offset(numbers[value_at], numbers[type_at] & 15, segments)
        if architecture == "x86_64" and isinstance(offset, int) and data.startswith(_ENDBR64, offset):
            offset += len(_ENDBR64)
        if name in offsets and offsets[name] != offset:
            offset = NotProbed("its table has two functions of this name")
        offsets[name] = offset
    return LibrarySymbols(architecture=architecture, offsets=offsets)


def _offset(value: int, kind: int, segments: Collection[tuple[int, int, int]]) -> int | NotProbed:
    """The offset in the file of an address, in the part of the file that is executed."""
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
