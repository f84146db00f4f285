"""The kernel that a board runs: Debian's ready-made one, or the one built from our fragment."""

import json
import lzma
import re
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import InfrastructureError
from rtgen import debian
from rtgen import kernel as kernel_build
from rtgen.board.machine import Machine
from rtgen.board.packages import unpacked
from rtgen.kconfig import data as kconfig


@dataclass(frozen=True)
class KernelFiles:
    """The files of a kernel that a board needs.

    `modules` is the folder ``lib/modules/<release>`` with modules.dep in it, `dtbs` a folder of ``*.dtb``.
    """

    release: str
    image: Path
    config: Path
    modules: Path
    dtbs: Path
    packages: dict[str, str]

    def device_tree(self, name: str) -> Path:
        """The device tree of this name, or ours for real time (``<name>-rt.dtb``) if the kernel has one.

        Raises InfrastructureError when it has neither.
        """
        for path in (self.dtbs / f"{Path(name).stem}-rt.dtb", self.dtbs / name):
            if path.exists():
                return path
        raise InfrastructureError(f"the kernel {self.release} has no device tree {name}")

    def files_of(self, modules: list[str]) -> list[str]:
        """Files below `modules` to load for these names, in order; see `module_files`."""
        return module_files((self.modules / "modules.dep").read_text(encoding="utf-8"), modules)

    def loadable(self, modules: list[str]) -> dict[str, bytes]:
        """The files of `files_of` by name, decompressed: Debian 13 compresses modules, and busybox's insmod cannot."""
        contents = {}
        for file in self.files_of(modules):
            packed = (self.modules / file).read_bytes()
            contents[Path(file).name.removesuffix(".xz")] = lzma.decompress(packed) if file.endswith(".xz") else packed
        return contents


def debian_kernel(package: str, machine: Machine, source: debian.PackageSource) -> KernelFiles:
    """The kernel of Debian's package for a machine, from the cache or downloaded (about 10 s)."""
    folder = unpacked([package], machine.architecture, source)
    releases = [path.name for path in (folder / "lib/modules").iterdir()]
    if len(releases) != 1:
        raise InfrastructureError(f"{package}: expected one kernel in {folder}, found {releases}")
    release = releases[0]
    return KernelFiles(
        release=release,
        image=folder / f"boot/vmlinuz-{release}",
        config=folder / f"boot/config-{release}",
        modules=folder / "lib/modules" / release,
        dtbs=folder / f"usr/lib/linux-image-{release}",
        packages={
            name: version for name, version in debian.installed(folder).items() if name.startswith("linux-image-")
        },
    )


def built_kernel(board: str, version: str | None = None) -> KernelFiles:
    """The kernel of `rtgen kernel build` for this board, from the cache or built (five minutes on two idle cores).

    Without a version, it is the first pinned one. Raises UsageError when there is no fragment for this board, no source
    for this version, or the options do not hold.
    """
    data = kconfig.load()
    machine = data.fragment_of(board)
    folder = kernel_build.build(data, machine, kernel_build.plan(data, machine, version), version)
    release = json.loads((folder / "kernel.json").read_text(encoding="utf-8"))["release"]
    return KernelFiles(
        release=release,
        image=folder / "vmlinuz",
        config=folder / "config",
        modules=folder / "modules" / release,
        dtbs=folder / "dtbs",
        packages={},
    )


def module_files(modules_dep: str, names: list[str]) -> list[str]:
    """The files of the named modules in the order of loading: dependencies first, each file once.

    `modules_dep` is the text of depmod's modules.dep; files are relative to its folder. A name that is missing there
    counts as built into the kernel.
    """
    dependencies_of: dict[str, list[str]] = {}
    by_name: dict[str, str] = {}
    for line in modules_dep.splitlines():
        file, _, dependencies = line.partition(":")
        # depmod lists the module to be loaded first at the end.
        dependencies_of[file] = dependencies.split()[::-1]
        by_name[module_name(file)] = file
    order: list[str] = []
    for name in names:
        file = by_name.get(module_name(name), "")
        for needed in [*dependencies_of.get(file, []), file]:
            if needed and needed not in order:
                order.append(needed)
    return order


def module_name(file: str) -> str:
    """The kernel's name of a module, from its file name."""
    return re.sub(r"\.ko(\.\w+)?$", "", Path(file).name).replace("-", "_")
