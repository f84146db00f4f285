"""Combine kernel, initial RAM disk and root file system of a machine, and keep the board by content.

A board for QEMU is a folder with board.json, a card for real hardware a folder with the image of the card.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rtfiles import atomic, cache
from rtfiles.errors import UsageError
from rtfiles.wording import unknown
from rtgen import debian
from rtgen.board import card, disk, initrd, packages
from rtgen.board.kernel import KernelFiles, built_kernel, debian_kernel
from rtgen.board.machine import Machine, Qemu, architectures, find
from rtgen.kconfig import data as kconfig

SCHEMA = 2
# The values of --kernel, besides the versions of kernels with a pinned source.
KINDS = ("debian", "both", "built")
HERE = Path(__file__).parent


def build(name: str, place: Path, kernel: str = "debian", login: Path | None = None, suite: str | None = None) -> Path:
    """Build the board of this machine; return `place`/<name>, a link to it in the cache.

    Its packages come from Debian's `suite` (None: the suite of this machine). Its `kernel` is Debian's with PREEMPT_RT
    (``debian``), both that and Debian's standard one (``both``), or one from `rtgen kernel build`: the first version
    (``built``) or a named one, such as ``7.2``. `login` is a file of public keys that may log in, for a card only. The
    first build takes about a minute, plus the build of the kernel; an unchanged board is taken from the cache. Raises
    UsageError for an unknown machine, suite or kernel, a file without keys, or when this user may not unpack packages;
    InfrastructureError when a package or tool fails.
    """
    machine = find(name)
    source = packages.source(suite)
    if login is not None and machine.medium is None:
        raise UsageError(f"{name} runs in QEMU with a key of its own, --authorized-key is for cards")
    if login is not None:
        card.check_login(login)
    if kernel not in KINDS and kernel not in (pinned := kconfig.load().sources):
        raise UsageError(f"--kernel: {unknown('kernel', kernel, known=[*KINDS, *pinned])}")
    if kernel == "both" and machine.standard_kernel is None:
        raise UsageError(f"{name}: no standard_kernel in the file of this machine: --kernel both is for others")
    if kernel in ("debian", "both"):
        kernels = {"rt": debian_kernel(machine.kernel, machine, source)}
    else:
        kernels = {"rt": built_kernel(name, None if kernel == "built" else kernel)}
    if kernel == "both" and machine.standard_kernel is not None:
        kernels["standard"] = debian_kernel(machine.standard_kernel, machine, source)
    folder = assemble(name, machine, kernels, source, login)
    atomic.replace_link(place / name, folder)
    return place / name


def assemble(
    name: str,
    machine: Machine,
    kernels: Mapping[str, KernelFiles],
    source: debian.PackageSource,
    login: Path | None = None,
) -> Path:
    """The folder of a board in the cache: this machine with these kernels by name; it starts the first one.

    Its packages come from `source`.
    """
    root = root_file_system(machine, kernels, source)

    def build_in(folder: Path) -> None:
        if machine.medium is not None:
            ram_disks = {name: ram_disk(machine, kernel, root) for name, kernel in kernels.items()}
            card.build(machine, kernels, root, ram_disks, login, source, folder)
        elif machine.qemu is not None:
            link_board(name, machine, machine.qemu, kernels, root, folder)

    inputs = [HERE / name for name in ("build.py", "initrd.py", "init.sh", "card.py", "uefi.py", "u_boot.py")]
    keys = [login.read_bytes()] if login is not None else []
    tree = machine.u_boot.device_tree if machine.u_boot is not None else machine.dtb
    trees = [kernel.device_tree(tree) for kernel in kernels.values()] if tree is not None else []
    return cache.entry("board", cache.digest([name, repr(machine), str(root), *inputs, *keys, *trees]), build_in)


def ram_disk(machine: Machine, kernel: KernelFiles, root: Path) -> bytes:
    """The initial RAM disk of a kernel, with busybox from the root file system in the folder `root`."""
    return initrd.archive((root / disk.BUSYBOX).read_bytes(), kernel.loadable([*machine.modules]))


def root_file_system(machine: Machine, kernels: Mapping[str, KernelFiles], source: debian.PackageSource) -> Path:
    """The folder of `disk.build` in the cache; machines with the same packages, kernels and modules share it."""
    recipe = [HERE / name for name in ("disk.py", "kernel.py", "packages.yml", "applets.txt", "root")]
    names = disk.package_names(machine, source.release)
    identity = [repr(source), machine.architecture, *names, *machine.modules]
    of_kernels = [part for kernel in kernels.values() for part in (kernel.release, kernel.config, kernel.image)]
    return cache.entry(
        "disk",
        cache.digest([*identity, *of_kernels, Path(debian.__file__), *recipe]),
        lambda folder: disk.build(machine, kernels.values(), source, folder),
    )


def link_board(
    name: str, machine: Machine, qemu: Qemu, kernels: Mapping[str, KernelFiles], root: Path, folder: Path
) -> None:
    """Write the board of a machine in QEMU into an empty folder. Shared files are linked, not copied."""
    for file in (disk.IMAGE, disk.KEY, f"{disk.KEY}.pub"):
        os.link(root / file, folder / file)
    entries = boot_entries(machine, kernels)
    for kernel, entry in zip(kernels.values(), entries.values(), strict=True):
        os.link(kernel.image, folder / entry["kernel"])
        if machine.dtb is not None:
            os.link(kernel.device_tree(machine.dtb), folder / entry["dtb"])
        (folder / entry["initrd"]).write_bytes(ram_disk(machine, kernel, root))
    versions = debian.versions((root / disk.LIST).read_text(encoding="utf-8").splitlines())
    for kernel in kernels.values():
        versions |= kernel.packages
    record = board_record(name, machine, qemu, entries, versions, (root / disk.HOST_KEY).read_text(encoding="utf-8"))
    atomic.write_text(folder / "board.json", json.dumps(record, indent=2) + "\n")


def boot_entries(machine: Machine, kernels: Mapping[str, KernelFiles]) -> dict[str, dict[str, Any]]:
    """The entry of each kernel in board.json: its files in the board's folder. Those of the first have plain names."""
    entries: dict[str, dict[str, Any]] = {}
    for name, kernel in kernels.items():
        mark = f"-{name}" if entries else ""
        dtb = machine.dtb and f"{Path(machine.dtb).stem}{mark}.dtb"
        entries[name] = {
            "kernel": f"vmlinuz{mark}",
            "initrd": f"initrd{mark}",
            "dtb": dtb,
            "kernel_release": kernel.release,
        }
    return entries


def board_record(
    name: str,
    machine: Machine,
    qemu: Qemu,
    entries: Mapping[str, dict[str, Any]],
    versions: dict[str, str],
    host_key: str,
) -> dict[str, Any]:
    """The content of board.json, which docs/formats.md describes."""
    kvm = None
    if qemu.kvm is not None:
        kvm = {"processor": architectures()[machine.architecture].processor, "arguments": qemu.kvm}
    return {
        "schema": SCHEMA,
        "machine": name,
        "qemu": qemu.model_dump() | {"kvm": kvm},
        **next(iter(entries.values())),
        **({"kernels": entries} if len(entries) > 1 else {}),
        "cmdline": f"{machine.cmdline} root=/dev/vda quiet",
        "disk": disk.IMAGE,
        "disk_format": "raw",
        "ssh": {"user": "root", "key": disk.KEY, "host_key": " ".join(host_key.split()[:2])},
        "packages": versions,
    }
