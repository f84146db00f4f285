"""What a card needs that starts by U-Boot: Debian's ready-made U-Boot, kernel, device tree and RAM disk as files.

Where they have to be, for an OMAP4: the ROM reads MLO from the root folder of a FAT partition, the active primary one
of an MBR. TI's manuals of related SoCs say so ("MMC/SD Read Sector Procedure in FAT Mode" in that of the AM335x,
SPRUH73); that of the OMAP4460, SWPU235, was not at hand. MLO is U-Boot's SPL and reads u-boot.img from there
(CONFIG_SPL_FS_LOAD_PAYLOAD_NAME). U-Boot's distro_bootcmd looks for extlinux/extlinux.conf on the bootable partition
(doc/develop/distro.rst of U-Boot).
"""

from dataclasses import replace
from pathlib import Path

from rtgen import debian
from rtgen.board.boot import Boot
from rtgen.board.machine import UBoot
from rtgen.board.packages import file_of

CONFIGURATION = """\
default linux
timeout 10
label linux
    kernel /zImage
    initrd /initrd
    fdt /board.dtb
    append {command_line}
"""


def boot_files(
    architecture: str, u_boot: UBoot, source: debian.Source, boot: Boot, device_tree: Path, work: Path
) -> dict[str, Path]:
    """The files of the boot partition by their paths on it; those that U-Boot's package has come first."""
    origin = replace(source, release=u_boot.suite or source.release)
    configuration = work / "extlinux.conf"
    configuration.write_text(CONFIGURATION.format(command_line=boot.command_line), encoding="utf-8")
    first = {Path(name).name: file_of(u_boot.package, name, architecture, origin) for name in u_boot.files}
    return first | {
        "zImage": boot.kernel,
        "initrd": boot.ram_disk,
        "board.dtb": device_tree,
        "extlinux/extlinux.conf": configuration,
    }
