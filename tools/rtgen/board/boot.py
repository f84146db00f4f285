"""What every card starts, whatever loads it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True, slots=True)
class KernelBoot:
    """Files of the kernel and its initial RAM disk, the kernel's arguments, and its device tree where it needs one."""

    kernel: Path
    ram_disk: Path
    command_line: str
    device_tree: Path | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class BootFiles:
    """What a boot partition holds: the file that firmware reads at `path`, one for each kernel by its name, and others.

    The kernel of the file that stands at `path` is started. `others` are the other files by their paths.
    """

    path: str
    by_kernel: Mapping[str, Path]
    others: Mapping[str, Path]
