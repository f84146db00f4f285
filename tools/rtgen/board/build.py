"""Put kernel, initial RAM disk and root file system of a machine together, and keep the board by content.

A board for QEMU is a folder with board.json, a card for real hardware a folder with the image of the card.
"""

import json
import os
from pathlib import Path
from typing import Any

from rtfiles import atomic, cache
from rtfiles.errors import UsageError
from rtgen import debian
from rtgen.board import card, disk, initrd
from rtgen.board.kernel import Kernel, built_kernel, debian_kernel
from rtgen.board.machine import Machine, Qemu, architectures, find

SCHEMA = 2
HERE = Path(__file__).parent


def build(name: str, place: Path, built: bool = False, login: Path | None = None) -> Path:
    """Build the board of this machine; return `place`/<name>, a link to it in the cache.

    It runs Debian's kernel or, if `built`, the one of `rtgen kernel build`. `login` is a file of public keys that may
    log in, for a card only. The first build takes about a minute, and that of the kernel; an unchanged board is taken
    from the cache. Raises UsageError for an unknown machine, a file without keys, or when this user may not unpack
    packages; InfrastructureError when a package or tool fails.
    """
    machine = find(name)
    if login is not None and machine.medium is None:
        raise UsageError(f"{name} runs in QEMU with a key of its own, --authorized-key is for cards")
    if login is not None:
        card.check_login(login)
    folder = assemble(name, machine, built_kernel(name) if built else debian_kernel(machine), login)
    atomic.replace_link(place / name, folder)
    return place / name


def assemble(name: str, machine: Machine, kernel: Kernel, login: Path | None = None) -> Path:
    """The folder of a board in the cache: this machine with this kernel."""
    root = root_file_system(machine, kernel)

    def build_in(folder: Path) -> None:
        modules = {
            Path(file).name: (kernel.modules / file).read_bytes() for file in kernel.files_of([*machine.modules])
        }
        ram_disk = initrd.archive((root / disk.BUSYBOX).read_bytes(), modules)
        if machine.medium is not None:
            card.build(machine, kernel, root, ram_disk, login, folder)
        elif machine.qemu is not None:
            link_board(name, machine, machine.qemu, kernel, root, ram_disk, folder)

    inputs = [HERE / name for name in ("build.py", "initrd.py", "init.sh", "card.py", "uefi.py", "u_boot.py")]
    keys = [login.read_bytes()] if login is not None else []
    return cache.entry("board", cache.digest([name, repr(machine), str(root), *inputs, *keys]), build_in)


def root_file_system(machine: Machine, kernel: Kernel) -> Path:
    """The folder of `disk.build` in the cache, which machines with the same packages, kernel and modules share."""
    recipe = [HERE / name for name in ("disk.py", "kernel.py", "packages.yml", "applets.txt", "root")]
    names = disk.package_names(machine)
    identity = [*map(str, debian.source()), machine.architecture, *names, kernel.release, *machine.modules]
    return cache.entry(
        "disk",
        cache.digest([*identity, kernel.config, kernel.image, Path(debian.__file__), *recipe]),
        lambda folder: disk.build(machine, kernel, folder),
    )


def link_board(
    name: str, machine: Machine, qemu: Qemu, kernel: Kernel, root: Path, ram_disk: bytes, folder: Path
) -> None:
    """Write the board of a machine in QEMU into an empty folder. What others share is linked, not copied."""
    for file in (disk.IMAGE, disk.KEY, f"{disk.KEY}.pub"):
        os.link(root / file, folder / file)
    os.link(kernel.image, folder / "vmlinuz")
    if machine.dtb is not None:
        os.link(kernel.dtbs / machine.dtb, folder / machine.dtb)
    (folder / "initrd").write_bytes(ram_disk)
    packages = debian.versions((root / disk.LIST).read_text(encoding="utf-8").splitlines())
    record = board_record(name, machine, qemu, kernel, packages, (root / disk.HOST_KEY).read_text(encoding="utf-8"))
    atomic.write_text(folder / "board.json", json.dumps(record, indent=2) + "\n")


def board_record(
    name: str, machine: Machine, qemu: Qemu, kernel: Kernel, packages: dict[str, str], host_key: str
) -> dict[str, Any]:
    """The content of board.json, which docs/formats.md describes."""
    kvm = None
    if qemu.kvm is not None:
        kvm = {"processor": architectures()[machine.architecture].processor, "arguments": qemu.kvm}
    return {
        "schema": SCHEMA,
        "machine": name,
        "qemu": qemu.model_dump() | {"kvm": kvm},
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
