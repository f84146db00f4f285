"""Put kernel, initial RAM disk, root disk and board.json together, and keep them by content."""

import json
import os
from pathlib import Path
from typing import Any

from rtfiles import atomic, cache
from rtgen import debian
from rtgen.board import disk, initrd
from rtgen.board.kernel import Kernel, built_kernel, debian_kernel
from rtgen.board.machine import Machine, find

SCHEMA = 1
HERE = Path(__file__).parent


def build(name: str, place: Path, built: bool = False) -> Path:
    """Build the board of this machine; return `place`/<name>, a link to it in the cache.

    It runs Debian's kernel or, if `built`, the one of `rtgen kernel build`. The first build takes about a minute, and
    that of the kernel; an unchanged board is taken from the cache. Raises UsageError for an unknown machine or when
    this user may not unpack packages, InfrastructureError when a package or tool fails.
    """
    machine = find(name)
    folder = assemble(name, machine, built_kernel(name) if built else debian_kernel(machine))
    atomic.replace_link(place / name, folder)
    return place / name


def assemble(name: str, machine: Machine, kernel: Kernel) -> Path:
    """The folder of a board in the cache: this machine with this kernel."""
    recipe = [HERE / name for name in ("disk.py", "kernel.py", "packages.yml", "applets.txt", "root")]
    modules = list(machine.modules)
    identity = [*map(str, debian.source()), machine.architecture, kernel.release, *modules]
    root = cache.entry(
        "disk",
        cache.digest([*identity, kernel.config, kernel.image, Path(debian.__file__), *recipe]),
        lambda folder: disk.build(kernel, machine.architecture, modules, folder),
    )

    def build_in(folder: Path) -> None:
        # Machines with the same packages and modules share the disk: linked, not copied.
        for file in (disk.IMAGE, disk.KEY, f"{disk.KEY}.pub"):
            os.link(root / file, folder / file)
        os.link(kernel.image, folder / "vmlinuz")
        if machine.dtb is not None:
            os.link(kernel.dtbs / machine.dtb, folder / machine.dtb)
        drivers = {Path(file).name: (kernel.modules / file).read_bytes() for file in kernel.files_of(modules)}
        (folder / "initrd").write_bytes(initrd.archive((root / disk.BUSYBOX).read_bytes(), drivers))
        packages = debian.versions((root / disk.LIST).read_text(encoding="utf-8").splitlines())
        record = board_record(name, machine, kernel, packages, (root / disk.HOST_KEY).read_text(encoding="utf-8"))
        atomic.write_text(folder / "board.json", json.dumps(record, indent=2) + "\n")

    inputs = [HERE / name for name in ("build.py", "initrd.py", "init.sh")]
    return cache.entry("board", cache.digest([name, repr(machine), str(root), *inputs]), build_in)


def board_record(
    name: str, machine: Machine, kernel: Kernel, packages: dict[str, str], host_key: str
) -> dict[str, Any]:
    """The content of board.json, which docs/formats.md describes."""
    return {
        "schema": SCHEMA,
        "machine": name,
        "emulated": True,
        "qemu": machine.qemu.model_dump(),
        "kernel": "vmlinuz",
        "initrd": "initrd",
        "dtb": machine.dtb,
        "cmdline": f"{machine.cmdline} root=/dev/vda quiet",
        "disk": disk.IMAGE,
        "disk_format": "raw",
        "ssh": {"user": "root", "key": disk.KEY, "host_key": " ".join(host_key.split()[:2])},
        "kernel_release": kernel.release,
        "packages": packages | kernel.packages,
    }
