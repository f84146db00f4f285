"""What every card starts, whatever loads it."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True, slots=True)
class Boot:
    """Files of the kernel and its initial RAM disk, and the kernel's arguments."""

    kernel: Path
    ram_disk: Path
    command_line: str
