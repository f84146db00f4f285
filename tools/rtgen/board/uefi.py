"""What a card needs to start with UEFI: one EFI file that contains kernel, RAM disk and command line.

The EFI file is systemd's stub with the parts added as sections (UAPI group, "Unified Kernel Image"). On a medium
without boot entries, firmware finds it by its path, ``EFI/BOOT/BOOT<architecture>.EFI`` (UEFI specification 2.10,
3.5.1.1), on a FAT partition of type EFI system.
"""

import struct
from collections.abc import Mapping
from pathlib import Path

from rtgen import debian
from rtgen.board.boot import BootFiles, KernelBoot
from rtgen.board.machine import Machine, architectures
from rtgen.board.packages import file_of
from rtgen.process import run

PACKAGE = "systemd-boot-efi"
SECTION_ALIGNMENT = 4096


def boot_files(
    machine: Machine, source: debian.PackageSource, boots: Mapping[str, KernelBoot], os_release: Path, work: Path
) -> BootFiles:
    """The files of the boot partition: an EFI file for each kernel."""
    architecture = architectures()[machine.architecture]
    file = f"usr/lib/systemd/boot/efi/linux{architecture.uefi}.efi.stub"
    stub = file_of(PACKAGE, file, machine.architecture, source)
    by_kernel = {}
    for name, boot in boots.items():
        command_line = work / "cmdline"
        command_line.write_text(boot.command_line, encoding="utf-8")
        parts = {".osrel": os_release, ".cmdline": command_line, ".linux": boot.kernel, ".initrd": boot.ram_disk}
        by_kernel[name] = work / f"{name}.efi"
        write_efi_file(by_kernel[name], stub, architecture.triplet, parts)
    return BootFiles(path=f"EFI/BOOT/BOOT{architecture.uefi}.EFI".upper(), by_kernel=by_kernel, others={})


def write_efi_file(file: Path, stub: Path, triplet: str, parts: dict[str, Path]) -> None:
    """Write the stub with a section for each part, by the section's name."""
    address = image_end(stub.read_bytes())
    command: list[str | Path] = [f"{triplet}-objcopy"]
    for name, part in parts.items():
        command += ["--add-section", f"{name}={part}", "--change-section-vma", f"{name}={address:#x}"]
        address = aligned(address + part.stat().st_size)
    run([*command, stub, file])


def image_end(program: bytes) -> int:
    """The first free address after a program in PE format: ImageBase + SizeOfImage of its optional header (PE32+)."""
    (header,) = struct.unpack_from("<I", program, 0x3C)
    optional = header + 24
    (base,) = struct.unpack_from("<Q", program, optional + 24)
    (size,) = struct.unpack_from("<I", program, optional + 56)
    return aligned(base + size)


def aligned(address: int) -> int:
    """The address, or the next one where a section may begin."""
    return -(-address // SECTION_ALIGNMENT) * SECTION_ALIGNMENT
