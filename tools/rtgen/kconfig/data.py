"""The files in ``kconfig/``, read into types and checked against each other."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator

from rtfiles import config
from rtfiles.errors import UsageError
from rtfiles.wording import unknown
from rtgen.checkout import shipped

_VERSION = r"[0-9]{1,4}\.[0-9]{1,4}"
Version = Annotated[str, config.matching(_VERSION, "a version of the kernel like 6.1")]
_VALUE = re.compile(r'[ymn]|-?\d+|0x[0-9a-fA-F]+|"[^"]*"')


class KernelOption(config.Config):
    """A kernel option: its value, the reason, the source of that reason, and its kernels (since <= kernel < before)."""

    symbol: Annotated[str, config.matching("[A-Z0-9_]+", "a symbol of Kconfig without CONFIG_")]
    value: str | int
    reason: str = Field(min_length=1)
    source: str = Field(min_length=1)
    since: Version | None = None
    before: Version | None = None

    @field_validator("value")
    @classmethod
    def _check_value(cls, value: str | int) -> str | int:
        if not _VALUE.fullmatch(str(value)):
            raise ValueError(f"a value is y, m, n, a number or a text in double quotes, not {value!r}")
        return value

    def holds_for(self, kernel: str) -> bool:
        """Whether this option exists in that kernel (like ``6.1``)."""
        number = version_key(kernel)
        return (self.since is None or version_key(self.since) <= number) and (
            self.before is None or number < version_key(self.before)
        )


class Concern(config.Config):
    """``options/<concern>.yml``: options that serve one purpose."""

    schema_: Literal[1] = Field(alias="schema")
    summary: str
    options: list[KernelOption]


Architecture = Literal["arm", "arm64", "x86-64"]  # the keys of tree.ARCHITECTURES


# Number of releases from 3.0 up to X.0. From 6 on, each major version is assumed to have 20.
_BEFORE = {3: 0, 4: 20, 5: 41, 6: 61}
_OF_A_MAJOR = 20


class KernelVersion(config.Config):
    """A kernel version: the symbol that enables PREEMPT_RT, and the patch series if mainline lacks it."""

    rt_series: str | None
    rt_mainline: list[Architecture]
    rt_symbol: str
    proven: str | None


class KernelMachine(config.Config):
    """The concerns of a fragment, the bases on which it must take effect, and boards that run the same kernel.

    `since`: the first kernel with a fragment; None means every kernel.
    """

    summary: str
    architecture: Architecture
    since: Version | None = None
    bases: list[str] = Field(min_length=1)
    concerns: list[str] = Field(min_length=1)
    boards: list[str] = Field(default=[])
    dtbs: list[str] = Field(default=[])


class SourceFile(config.Config):
    """A file that Debian serves."""

    file: str
    sha256: Annotated[str, config.matching("[0-9a-f]{64}", "a SHA-256 of 64 lower-case hex digits")]
    package: str | None = None
    folder: str | None = None


class DebianSource(config.Config):
    """A pinned Debian kernel: its tree, and the RT patches of the same version (None: mainline needs none).

    `suites` are the Debian suites that may serve it, `release` is the patched tree's name for itself.
    """

    suites: list[str] = Field(min_length=1)
    source: str
    version: str
    release: str
    tree: SourceFile
    patches: SourceFile | None


class _Kernels(config.Config):
    schema_: Literal[1] = Field(alias="schema")
    kernels: dict[str, KernelVersion]


class _Machines(config.Config):
    schema_: Literal[1] = Field(alias="schema")
    machines: dict[str, KernelMachine]


class _Sources(config.Config):
    schema_: Literal[1] = Field(alias="schema")
    kernels: dict[str, DebianSource] = Field(min_length=1)


@dataclass(frozen=True, kw_only=True, slots=True)
class Basis:
    """The data to compare a kernel with: the options that exist in `options_of`, and the PREEMPT_RT of `rt_of`.

    `rt_of` is a version of ``kernels.yml``. `options_of` is the same version if it was selected, else the kernel
    itself.
    """

    options_of: str
    rt_of: str

    def remark(self, kernel: str) -> str:
        """A remark if the data belong to another kernel; empty if they belong to this one."""
        if self.rt_of == kernel:
            return ""
        return f" (by the data of {self.rt_of}{'' if self.options_of == self.rt_of else ', the nearest'})"


@dataclass(frozen=True, kw_only=True, slots=True)
class Data:
    """Everything in a ``kconfig/`` folder."""

    folder: Path
    kernels: dict[str, KernelVersion]
    machines: dict[str, KernelMachine]
    concerns: dict[str, Concern]
    sources: dict[str, DebianSource]

    def kernel(self, version: str) -> KernelVersion:
        """The kernel of that version. Raises UsageError, naming the known ones."""
        if version not in self.kernels:
            raise UsageError(unknown("kernel", version, known=self.kernels))
        return self.kernels[version]

    def basis(self, kernel: str, selected: str | None = None) -> Basis:
        """What a kernel of any version is compared with: its own data, the nearest, or those of a selected version.

        Of two equally near versions, the older one counts: the kernel may lack what the newer one has. Raises
        UsageError for an unknown selected version.
        """
        if selected is not None:
            self.kernel(selected)
            return Basis(options_of=selected, rt_of=selected)
        number = _release(kernel)
        nearest = min(self.kernels, key=lambda known: (abs(_release(known) - number), version_key(known)))
        return Basis(options_of=kernel, rt_of=nearest)

    def source(self, version: str | None = None) -> DebianSource:
        """The pinned source of a kernel; without a version, the first. Raises UsageError, naming the pinned ones."""
        chosen = next(iter(self.sources)) if version is None else version
        if chosen not in self.sources:
            raise UsageError(
                f"no source of kernel {chosen!r} is pinned in kconfig/sources.yml, pinned: {', '.join(self.sources)}"
            )
        return self.sources[chosen]

    def machine(self, name: str) -> KernelMachine:
        """The machine of that name. Raises UsageError, naming the known ones."""
        if name not in self.machines:
            raise UsageError(unknown("machine", name, known=self.machines))
        return self.machines[name]

    def fragment_of(self, board: str) -> str:
        """The machine whose kernel a board runs: the one that lists the board, or else the board itself.

        Raises UsageError for other boards, and for machines without device trees, whose kernels other layers build.
        """
        built = {name: machine for name, machine in self.machines.items() if machine.dtbs}
        runs = {name: name for name in built}
        runs |= {listed: name for name, machine in built.items() for listed in machine.boards}
        if board not in runs:
            raise UsageError(f"no kernel is built for machine {board}, only for {', '.join(runs)}")
        return runs[board]

    def kernels_of(self, machine: str) -> list[str]:
        """The kernel versions for which a machine has a fragment."""
        since = self.machine(machine).since
        return [kernel for kernel in self.kernels if since is None or version_key(since) <= version_key(kernel)]

    def rt_series(self, machine: str, kernel: str) -> str | None:
        """The patch series that a machine's kernel needs for PREEMPT_RT; None if mainline has it."""
        known = self.kernel(kernel)
        return None if self.machine(machine).architecture in known.rt_mainline else known.rt_series

    def options(self, machine: str, kernel: str) -> dict[str, tuple[KernelOption, ...]]:
        """The options of a machine that hold for a kernel of any version, by concern, in the order of the files."""
        return {
            concern: tuple(option for option in self.concerns[concern].options if option.holds_for(kernel))
            for concern in self.machine(machine).concerns
        }

    def wanted(self, machine: str, kernel: str) -> dict[str, str]:
        """The value that each symbol must have."""
        return {
            option.symbol: str(option.value) for group in self.options(machine, kernel).values() for option in group
        }


def _release(version: str) -> int:
    """The position of a version like ``6.12`` among all releases since 3.0."""
    major, minor = version_key(version)
    return _BEFORE.get(major, _BEFORE[6] + _OF_A_MAJOR * (major - 6)) + minor


def version_key(version: str) -> tuple[int, ...]:
    """A version like ``6.12`` as numbers that can be compared."""
    return tuple(int(part) for part in version.split("."))


def load(folder: Path | None = None) -> Data:
    """Read ``kernels.yml``, ``machines.yml``, ``sources.yml`` and ``options/*.yml`` (folder: ``kconfig/``).

    Raises UsageError for a malformed file, a concern without a file, or a symbol that two options set for one machine
    and kernel.
    """
    folder = folder or shipped("kconfig")
    data = Data(
        folder=folder,
        kernels=config.load(folder / "kernels.yml", _Kernels).kernels,
        machines=config.load(folder / "machines.yml", _Machines).machines,
        concerns={path.stem: config.load(path, Concern) for path in sorted((folder / "options").glob("*.yml"))},
        sources=config.load(folder / "sources.yml", _Sources).kernels,
    )
    for name, machine in data.machines.items():
        for concern in machine.concerns:
            if concern not in data.concerns:
                where = f"{folder / 'machines.yml'}: machines.{name}.concerns"
                raise UsageError(f"{where}: {unknown('concern', concern, known=data.concerns)}")
        for kernel in data.kernels_of(name):
            _refuse_twice(data, name, kernel)
    return data


def _refuse_twice(data: Data, machine: str, kernel: str) -> None:
    seen: dict[str, str] = {}
    for concern, options in data.options(machine, kernel).items():
        for option in options:
            if option.symbol in seen:
                raise UsageError(
                    f"{data.folder / 'options' / concern}.yml: {option.symbol} is given twice to {machine} {kernel}, "
                    f"the other is in {seen[option.symbol]}.yml: keep one, or separate them by since and before"
                )
            seen[option.symbol] = concern
