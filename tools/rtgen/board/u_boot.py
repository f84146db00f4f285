"""What a card needs to start with U-Boot: Debian's ready-made U-Boot, kernel, device tree and RAM disk as files.

Their places for an OMAP4: the ROM reads MLO from the root folder of a FAT partition, the active primary partition of an
MBR. TI's manuals of related SoCs state this ("MMC/SD Read Sector Procedure in FAT Mode" in that of the AM335x,
SPRUH73); that of the OMAP4460, SWPU235, was not available. MLO is U-Boot's SPL and reads u-boot.img from there
(CONFIG_SPL_FS_LOAD_PAYLOAD_NAME). U-Boot's distro_bootcmd looks for extlinux/extlinux.conf on the bootable partition
(doc/develop/distro.rst of U-Boot).
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from rtgen import debian
from rtgen.board.boot import BootFiles, KernelBoot
from rtgen.board.machine import UBoot
from rtgen.board.packages import file_of

CONFIGURATION = """\
default linux
timeout 10
label linux
    kernel /{kernel}
    initrd /{ram_disk}
    fdt /{device_tree}
    append {command_line}
"""


def boot_files(
    architecture: str, u_boot: UBoot, source: debian.PackageSource, boots: Mapping[str, KernelBoot], work: Path
) -> BootFiles:
    """The files of the boot partition: those of U-Boot's package first, then a configuration for each kernel.

    The files of the first kernel have plain names.
    """
    origin = replace(source, release=u_boot.suite or source.release)
    others = {Path(name).name: file_of(u_boot.package, name, architecture, origin) for name in u_boot.files}
    by_kernel: dict[str, Path] = {}
    for name, boot in boots.items():
        mark = f"-{name}" if by_kernel else ""
        kernel, ram_disk, device_tree = f"zImage{mark}", f"initrd{mark}", f"board{mark}.dtb"
        assert boot.device_tree is not None
        others |= {kernel: boot.kernel, ram_disk: boot.ram_disk, device_tree: boot.device_tree}
        by_kernel[name] = work / f"{name}.conf"
        by_kernel[name].write_text(
            CONFIGURATION.format(
                kernel=kernel, ram_disk=ram_disk, device_tree=device_tree, command_line=boot.command_line
            ),
            encoding="utf-8",
        )
    return BootFiles(path="extlinux/extlinux.conf", by_kernel=by_kernel, others=others)
