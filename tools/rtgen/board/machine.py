"""Emulated boards, read from machines.yml."""

from pathlib import Path
from typing import Annotated

from pydantic import StringConstraints, model_validator

from rtfiles.config import Config, load
from rtfiles.errors import UsageError


class Machine(Config):
    """One emulated board: arguments of qemu-system-arm and of the kernel.

    `dtb` is the file name of the kernel's device tree, None where QEMU makes one.
    """

    summary: Annotated[str, StringConstraints(min_length=1)]
    arguments: list[str]
    dtb: str | None
    cmdline: str


class Machines(Config):
    """machines.yml: the boards, the default one, and the kernel modules that they load, each with a reason."""

    default: str
    modules: dict[str, str]
    machines: dict[str, Machine]

    @model_validator(mode="after")
    def _default_is_one_of_them(self) -> "Machines":
        if self.default not in self.machines:
            raise ValueError(f"default {self.default!r} is not one of {', '.join(self.machines)}")
        return self


def machines() -> Machines:
    """Read machines.yml."""
    return load(Path(__file__).with_name("machines.yml"), Machines)


def find(name: str) -> Machine:
    """The machine of this name; UsageError lists the known ones."""
    known = machines().machines
    if name not in known:
        raise UsageError(f"unknown machine {name!r}, known: {', '.join(known)}")
    return known[name]
