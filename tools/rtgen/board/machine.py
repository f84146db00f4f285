"""Machines that a board can be built for, each with its own file in machines/."""

import functools
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from rtfiles.config import Config, load, matching, parse, read_yaml
from rtfiles.errors import UsageError
from rtfiles.wording import unknown

HERE = Path(__file__).parent
ARCHITECTURES = HERE / "architectures.yml"
# Words of a command line or of a file name, and names of packages, modules and programs.
Text = Annotated[str, matching(r"[^\x00-\x1f\x7f]+", "one line of text")]
Name = Annotated[
    str, matching(r"[A-Za-z0-9][A-Za-z0-9._+-]*", "a name of letters, digits and . _ + -, a letter or digit first")
]


class DebianArchitecture(Config):
    """A Debian architecture: the prefix of its compiler, the processor as in ``uname -m``, and UEFI's name for it."""

    triplet: Name
    processor: Name
    uefi: Name | None


class Qemu(Config):
    """How QEMU emulates a machine: its program and arguments, and the devices of the disk and the network.

    `kvm` are further arguments that run the machine with KVM on a host with the same processor; None: not possible.
    """

    binary: Name
    arguments: list[Text]
    kvm: list[Text] | None = None
    disk_device: Text
    network_device: Text


class UBoot(Config):
    """Debian's package of U-Boot, its files that the ROM and U-Boot look for on a card, the kernel's device tree.

    `suite` is the Debian release with the package; None: the release of the board.
    """

    package: Name
    suite: Name | None = None
    files: list[Text] = Field(min_length=1)
    device_tree: Name


class Machine(Config):
    """What a board is made of.

    `kernel` is Debian's package of a kernel with PREEMPT_RT, `standard_kernel` that of a kernel without it. `dtb` is
    the file name of the kernel's device tree (None if the machine provides one), `cmdline` the kernel's arguments
    except the root file system. `modules` are loaded by the initial RAM disk, in this order and after their
    dependencies, each with the reason. A machine either runs in QEMU or starts from a card or stick; `medium` names
    what looks for the kernel there.
    """

    summary: Text
    default: bool = False
    architecture: Name
    kernel: Name
    standard_kernel: Name | None = None
    dtb: Name | None = None
    cmdline: Text
    modules: dict[Name, Text] = Field(min_length=1)
    qemu: Qemu | None = None
    medium: Literal["uefi", "u-boot"] | None = None
    u_boot: UBoot | None = None

    @model_validator(mode="after")
    def _qemu_or_medium(self) -> "Machine":
        if (self.qemu is None) == (self.medium is None):
            raise ValueError("give qemu (how QEMU runs it) or medium (how it starts from a card), and not the other")
        if (self.u_boot is not None) != (self.medium == "u-boot"):
            raise ValueError("give u_boot (which U-Boot) with medium: u-boot, and only with it")
        return self


@functools.cache
def architectures() -> dict[str, DebianArchitecture]:
    """The known architectures, by Debian's name, read once."""
    data = read_yaml(ARCHITECTURES)
    return {name: parse(entry, DebianArchitecture, f"{ARCHITECTURES}: {name}") for name, entry in data.items()}


def machines(folder: Path = HERE / "machines") -> dict[str, Machine]:
    """Every machine by name, one of them the default. Raises UsageError, naming the file, for an invalid one."""
    known = {path.stem: read_machine(path) for path in sorted(folder.glob("*.yml"))}
    defaults = [name for name, machine in known.items() if machine.default]
    if len(defaults) != 1:
        named = f"{', '.join(defaults)} have" if defaults else "none has"
        raise UsageError(f"{folder}: default: true belongs into the file of one machine, {named} it")
    return known


def read_machine(path: Path) -> Machine:
    """Read the file of a machine. Raises UsageError that names the file, the key and what is allowed."""
    machine = load(path, Machine)
    known = architectures()
    if machine.architecture not in known:
        raise UsageError(f"{path}: architecture: {unknown('architecture', machine.architecture, known=known)}")
    if machine.medium == "uefi" and known[machine.architecture].uefi is None:
        raise UsageError(f"{path}: medium: {machine.architecture} has no name in UEFI, see {ARCHITECTURES}")
    return machine


def find(name: str) -> Machine:
    """The machine of this name. Raises UsageError that lists the known ones."""
    known = machines()
    if name not in known:
        raise UsageError(unknown("machine", name, known=known))
    return known[name]


def default_machine() -> str:
    """The machine that is built when none is named."""
    return next(name for name, machine in machines().items() if machine.default)
