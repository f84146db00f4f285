"""The initial RAM disk: busybox, the drivers of the disk, and a script that mounts it."""

import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

INIT = Path(__file__).with_name("init.sh")


@dataclass(frozen=True)
class CpioEntry:
    """One file of a cpio archive; `mode` is st_mode with its type, `device` the major and minor of a device node."""

    name: str
    mode: int
    data: bytes = b""
    device: tuple[int, int] = (0, 0)


def archive(busybox: bytes, modules: dict[str, bytes]) -> bytes:
    """Return the RAM disk. `modules` maps file names to contents, in the order of loading.

    Not compressed: the emulated CPU would take longer to expand it than QEMU takes to load it.
    """
    return cpio(list(entries(busybox, modules)))


def entries(busybox: bytes, modules: dict[str, bytes]) -> Iterator[CpioEntry]:
    """The files of the RAM disk."""
    for folder in ("bin", "dev", "lib", "proc", "root", "sys"):
        yield CpioEntry(folder, stat.S_IFDIR | 0o755)
    # The kernel opens it for the first program, before any file system is mounted.
    yield CpioEntry("dev/console", stat.S_IFCHR | 0o600, device=(5, 1))
    yield CpioEntry("bin/busybox", stat.S_IFREG | 0o755, busybox)
    yield CpioEntry("init", stat.S_IFREG | 0o755, INIT.read_bytes())
    for name, data in modules.items():
        yield CpioEntry(f"lib/{name}", stat.S_IFREG | 0o644, data)
    yield CpioEntry("lib/modules.list", stat.S_IFREG | 0o644, "".join(f"{name}\n" for name in modules).encode())


def cpio(files: list[CpioEntry]) -> bytes:
    """Pack files in the format of the kernel's RAM disks: "newc", see Documentation/driver-api/early-userspace."""
    packed = bytearray()
    for number, file in enumerate([*files, CpioEntry("TRAILER!!!", 0)], start=1):
        name = file.name.encode() + b"\0"
        links = 2 if stat.S_ISDIR(file.mode) else 1
        # inode, mode, uid, gid, links, time, size, device (2), device node (2), length of the name, no checksum
        fields = (number, file.mode, 0, 0, links, 0, len(file.data), 0, 0, *file.device, len(name), 0)
        packed += b"070701" + b"".join(b"%08X" % field for field in fields) + name
        packed += bytes(-len(packed) % 4)
        packed += file.data
        packed += bytes(-len(packed) % 4)
    return bytes(packed)
