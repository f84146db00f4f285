"""The image of a card or stick for real hardware; only its owner can log in."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.untrusted import read_text
from rtgen import debian
from rtgen.board import disk, u_boot, uefi
from rtgen.board.boot import BootFiles, KernelBoot
from rtgen.board.kernel import KernelFiles
from rtgen.board.machine import Machine
from rtgen.process import run

IMAGE = "card.img"
HOST_KEY = "/etc/ssh/ssh_host_ed25519_key"
LOGIN_KEYS = "/root/.ssh/authorized_keys"
# Enough for thousands of keys.
LOGIN_BYTES_MAX = 2**20  #: a file of public keys for the login to a card
MIB = 2**20
# Room for several kernels, and for a copy of one while boot-kernel replaces what is started: some 45 MB each with UEFI
# on arm64.
BOOT_MIB = 256
# Erase blocks of cards are a few MiB at most; partitions begin on them.
START_MIB = 4

Table = Literal["gpt", "dos"]
# The type of the boot partition in sfdisk's words: EFI system, or FAT32 (LBA) and active.
BOOT_TYPE: dict[Table, str] = {"gpt": "type=U", "dos": "type=c, bootable"}
ROOT_TYPE: dict[Table, str] = {"gpt": "type=L", "dos": "type=83"}


def build(
    machine: Machine,
    kernels: Mapping[str, KernelFiles],
    root: Path,
    ram_disks: Mapping[str, bytes],
    login: Path | None,
    source: debian.PackageSource,
    folder: Path,
) -> None:
    """Write card.img into an empty folder, from the root file system in `root`, a folder of `disk.build`.

    It starts the first kernel; with several kernels, its command boot-kernel selects another one. `login` is a file of
    public keys that may log in; without it, a key made for this image is put next to it. U-Boot or the stub for UEFI
    comes from `source`.
    """
    if login is None:
        for name in (disk.KEY, f"{disk.KEY}.pub"):
            shutil.copy(root / name, folder / name)
    work = folder / "work"
    work.mkdir()
    system = work / disk.IMAGE
    run(["cp", "--sparse=always", root / disk.IMAGE, system])
    if login is not None:
        shutil.copy(login, work / "login.pub")
    set_keys(system, None if login is None else work / "login.pub")
    boots = {}
    for name, kernel in kernels.items():
        (work / f"initrd-{name}").write_bytes(ram_disks[name])
        boots[name] = KernelBoot(
            kernel=kernel.image,
            ram_disk=work / f"initrd-{name}",
            command_line=f"{machine.cmdline} root=UUID={file_system_id(system)} quiet",
            device_tree=kernel.device_tree(machine.u_boot.device_tree) if machine.u_boot is not None else None,
        )
    if machine.u_boot is not None:
        boot_files = u_boot.boot_files(machine.architecture, machine.u_boot, source, boots, work)
        write_card(folder / IMAGE, "dos", files_by_path(boot_files, work), system)
    else:
        run(["debugfs", "-R", "dump /usr/lib/os-release os-release", system], folder=work)
        boot_files = uefi.boot_files(machine, source, boots, work / "os-release", work)
        write_card(folder / IMAGE, "gpt", files_by_path(boot_files, work), system)
    shutil.rmtree(work)


def files_by_path(boot_files: BootFiles, work: Path) -> dict[str, Path]:
    """The files of a boot partition by their paths on it, including those that the command boot-kernel needs."""
    first, *rest = boot_files.by_kernel.values()
    files = {**boot_files.others, boot_files.path: first}
    if rest:
        path = work / "kernel-path.txt"
        path.write_text(f"{boot_files.path}\n", encoding="utf-8")
        files |= {f"kernels/{name}": file for name, file in boot_files.by_kernel.items()} | {path.name: path}
    return files


def write_card(image: Path, table: Table, files: dict[str, Path], root: Path) -> None:
    """Write the image of a whole card: a FAT partition with files by their paths, and a root file system."""
    root_mib = -(-root.stat().st_size // MIB)
    # The last MiB is for the backup partition table of a GPT.
    with image.open("wb") as stream:
        stream.truncate((START_MIB + BOOT_MIB + root_mib + 1) * MIB)
    layout = [f"label: {table}", f"start={START_MIB}MiB, size={BOOT_MIB}MiB, {BOOT_TYPE[table]}"]
    layout += [f"size={root_mib}MiB, {ROOT_TYPE[table]}"]
    run(["sfdisk", "--quiet", image], stdin="".join(f"{line}\n" for line in layout).encode())
    boot = image.with_name("boot.fat")
    with boot.open("wb") as stream:
        stream.truncate(BOOT_MIB * MIB)
    run(["mkfs.vfat", "-F", "32", "-n", "BOOT", boot])
    folders = {Path()}
    for name, file in files.items():
        # One at a time, so that the first file in `files` is the first in its folder.
        for folder in reversed(Path(name).parents):
            if folder not in folders:
                run(["mmd", "-i", boot, f"::/{folder}"])
                folders.add(folder)
        run(["mcopy", "-i", boot, file, f"::/{name}"])
    for part, start_mib in ((boot, START_MIB), (root, START_MIB + BOOT_MIB)):
        run(["dd", f"if={part}", f"of={image}", "bs=1M", f"seek={start_mib}", "conv=notrunc,sparse", "status=none"])
    boot.unlink()


def set_keys(system: Path, login: Path | None) -> None:
    """Remove the host key from a root file system, as each board makes its own, and add keys for logging in."""
    commands = [f"rm {HOST_KEY}", f"rm {HOST_KEY}.pub"]
    if login is not None:
        commands += [f"rm {LOGIN_KEYS}", f"write {login.name} {LOGIN_KEYS}", f"sif {LOGIN_KEYS} mode 0100600"]
        commands += [f"sif {LOGIN_KEYS} {owner} 0" for owner in ("uid", "gid")]
    # In the folder of the keys, as debugfs accepts no path with blanks.
    place = login.parent if login is not None else None
    run(["debugfs", "-w", "-f", "-", system], stdin="".join(f"{line}\n" for line in commands).encode(), folder=place)
    # debugfs ends with status 0 whatever happens.
    if login is not None and run(["debugfs", "-R", f"cat {LOGIN_KEYS}", system]) != login.read_bytes().decode():
        raise InfrastructureError(f"{login}: debugfs could not write the keys into the image")
    if run(["debugfs", "-R", f"cat {HOST_KEY}", system]):
        raise InfrastructureError(f"{system}: debugfs could not remove the host key from the image")


def file_system_id(system: Path) -> str:
    """The UUID of an ext4 file system."""
    return run(["blkid", "-p", "-o", "value", "-s", "UUID", system]).strip()


def check_login(login: Path) -> None:
    """Raise UsageError if this is not a file of public keys."""
    text = read_text(login, max_bytes=LOGIN_BYTES_MAX)
    if "PRIVATE KEY" in text:
        raise UsageError(f"{login}: a private key, give the public one: {login}.pub")
    try:
        run(["ssh-keygen", "-l", "-f", login])
    except InfrastructureError as error:
        raise UsageError(f"{login}: no public key in it, ssh-keygen -t ed25519 makes one") from error
