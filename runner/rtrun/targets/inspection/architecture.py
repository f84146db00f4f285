"""The architecture that a program is made for, by its ELF header (elf(5))."""

from pathlib import Path

HEADER_BYTES = 20
# e_machine in <elf.h>, for the architectures of Linux boards.
_MACHINES = {3: "x86", 8: "MIPS", 20: "PowerPC", 21: "PowerPC", 40: "ARM", 62: "x86", 183: "ARM", 243: "RISC-V"}


def name(header: bytes) -> str | None:
    """Name the architecture of a program by its first HEADER_BYTES bytes, as in ``64-bit ARM``; None for no ELF."""
    if len(header) < HEADER_BYTES or not header.startswith(b"\x7fELF"):
        return None
    width = {1: "32-bit", 2: "64-bit"}.get(header[4], "unknown")
    is_big_endian = header[5] == 2
    machine = int.from_bytes(header[18:20], "big" if is_big_endian else "little")
    return f"{width} {_MACHINES.get(machine, f'machine {machine}')}{', big-endian' if is_big_endian else ''}"


def of_folder(folder: Path) -> str | None:
    """Name the architecture of the suites in a folder of `rtgen suites build`; None when none is an ELF program."""
    for path in sorted(folder.glob("lib/*/*")):
        if path.is_file():
            with path.open("rb") as stream:
                made_for = name(stream.read(HEADER_BYTES))
            if made_for is not None:
                return made_for
    return None
