"""Machines that a board can be built for, each read from a file of its own in machines/."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, StringConstraints

from rtfiles.config import Config, load, parse, read_yaml
from rtfiles.errors import UsageError

HERE = Path(__file__).parent
ARCHITECTURES = HERE / "architectures.yml"
# Words of a command line or of a file name, and names of packages, modules and programs.
Text = Annotated[str, StringConstraints(min_length=1, pattern=r"^[^\x00-\x1f\x7f]+$")]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$")]


class Architecture(Config):
    """Debian's architecture: the prefix of its compiler, and the processor as ``uname -m`` names it."""

    triplet: Name
    processor: Name


class Qemu(Config):
    """How QEMU emulates a machine: its program and arguments, and the devices of the disk and the network."""

    binary: Name
    arguments: list[Text]
    disk_device: Text
    network_device: Text


class Machine(Config):
    """What a board is made of.

    `kernel` is a package of Debian, `dtb` the file name of the kernel's device tree (None where the machine provides
    one), `cmdline` the kernel's arguments except the root file system, `modules` what the initial RAM disk loads, in
    this order and after its dependencies, each with the reason.
    """

    summary: Text
    default: bool = False
    architecture: Name
    kernel: Name
    dtb: Name | None = None
    cmdline: Text
    modules: dict[Name, Text] = Field(min_length=1)
    qemu: Qemu


def architectures() -> dict[str, Architecture]:
    """The known architectures, by Debian's name."""
    data = read_yaml(ARCHITECTURES)
    return {name: parse(each, Architecture, f"{ARCHITECTURES}: {name}") for name, each in data.items()}


def machines(folder: Path = HERE / "machines") -> dict[str, Machine]:
    """Every machine by name. Raises UsageError, naming the file, for one that makes no sense."""
    return {path.stem: read_machine(path) for path in sorted(folder.glob("*.yml"))}


def read_machine(path: Path) -> Machine:
    """Read the file of a machine. Raises UsageError that names the file, the key and what is right."""
    machine = load(path, Machine)
    known = architectures()
    if machine.architecture not in known:
        raise UsageError(f"{path}: architecture: {machine.architecture!r} is unknown, known: {', '.join(known)}")
    return machine


def find(name: str) -> Machine:
    """The machine of this name. Raises UsageError that lists the known ones."""
    known = machines()
    if name not in known:
        raise UsageError(f"unknown machine {name!r}, known: {', '.join(known)}")
    return known[name]


def default_machine() -> str:
    """The name of the machine that is built when none is named."""
    return next(name for name, machine in machines().items() if machine.default)
