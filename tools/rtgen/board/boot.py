"""What every card starts, whatever boot loader it has."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True, slots=True)
class KernelBoot:
    """The files of a kernel and its initial RAM disk, the kernel's arguments, and the device tree if it needs one."""

    kernel: Path
    ram_disk: Path
    command_line: str
    device_tree: Path | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class BootFiles:
    """The content of a boot partition: the file that firmware reads at `path`, one per kernel by name, and others.

    The file at `path` decides which kernel is started. `others` are the other files by their paths.
    """

    path: str
    by_kernel: Mapping[str, Path]
    others: Mapping[str, Path]
