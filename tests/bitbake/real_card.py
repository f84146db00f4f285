"""Cards as openembedded-core's own wic makes them: partitions, file systems and boot files.

`make test-yocto` runs this beside real_layers.py. The root file system is that of the emulated board; the boot files,
which would have to be built, are stand-ins. wic needs parted, gdisk, mtools, dosfstools and e2fsprogs on this machine.
"""

import io
import itertools
import json
import os
import re
import subprocess
import tarfile
from dataclasses import dataclass
from pathlib import Path

import pytest

from bitbake.yocto import Yocto
from rtgen import debian
from rtgen.board import build as board
from rtgen.board import packages

pytestmark = [pytest.mark.bitbake, pytest.mark.timeout(1800)]

SECTOR = 512
MIB = 2**20
# Of the image.
VARIABLES = (
    "EFI_PROVIDER", "IMAGE_BOOT_FILES", "IMAGE_CLASSES", "IMAGE_FSTYPES", "INITRAMFS_FSTYPES", "INITRAMFS_IMAGE",
    "KERNEL_IMAGETYPE", "WKS_FULL_PATH", "_WKS_TEMPLATE",
)  # fmt: skip
# Types of partitions: with an MBR, and with a GPT, where parted chooses that of a FAT partition.
FAT, LINUX = "c", "83"
GPT_FAT, GPT_LINUX = "EBD0A0A2-B9E5-4433-87C0-68B6B72699C7", "0FC63DAF-8483-4772-8E79-3D69D8477DE4"


@dataclass(frozen=True, kw_only=True, slots=True)
class Card:
    """A machine's card by its .wks, where `boot_mib` is None with a size of the boot partition that wic chooses."""

    align_kib: int
    boot_mib: int | None = None
    boot_label: str = "boot"
    root_label: str = "root"
    efi: str | None = None
    """The name of the boot loader that UEFI starts from a removable medium."""


CARDS = {
    "pandaboard-es": Card(align_kib=4096, boot_mib=64),
    "beaglebone-yocto": Card(align_kib=4, boot_mib=32),
    "genericarm64": Card(align_kib=1024, efi="bootaa64.efi"),
    "genericx86-64": Card(align_kib=1024, boot_label="msdos", root_label="platform", efi="bootx64.efi"),
    "raspberrypi4-64": Card(align_kib=4096),
    "raspberrypi5": Card(align_kib=4096),
}
# By EFI_PROVIDER: what comes before a boot loader's name in DEPLOY_DIR_IMAGE.
LOADERS = {"grub-efi": "grub-efi-", "systemd-boot": "systemd-"}


@pytest.fixture(scope="session")
def root_file_system(tmp_path_factory):
    """A folder with the files of the emulated board."""
    place = tmp_path_factory.mktemp("board")
    image = board.build("qemu-armv7", place) / "root.img"
    folder = place / "root"
    folder.mkdir()
    subprocess.run(["debugfs", "-R", f"rdump / {folder}", image], check=True, capture_output=True)
    return folder


@pytest.fixture(scope="session")
def wic(yocto: Yocto, tmp_path_factory) -> Path:
    """The program. Since wrynose it is a repository of its own; its last state in openembedded-core is taken then."""
    core = yocto.top / "openembedded-core"
    program = core / "scripts/wic"
    if program.is_file():
        return program

    def git(*arguments: str) -> bytes:
        return subprocess.run(["git", "-C", core, *arguments], check=True, capture_output=True).stdout

    removed = git("log", "-1", "--diff-filter=D", "--format=%H", "--", "scripts/wic").decode().strip()
    folder = tmp_path_factory.mktemp("wic")
    with tarfile.open(fileobj=io.BytesIO(git("archive", f"{removed}^", "scripts", "meta/lib"))) as archive:
        # Debian 12's Python 3.11.2 has no filters yet.
        archive.extraction_filter = getattr(tarfile, "data_filter", lambda member, _: member)
        archive.extractall(folder)
    return folder / "scripts/wic"


@pytest.fixture(scope="session")
def native_sysroot(tmp_path_factory) -> Path:
    """This machine's programs, with Debian 13's sfdisk: wic of wrynose has options for it that Debian 12's lacks."""
    unpacked = packages.unpacked(["fdisk"], "amd64", debian.source("trixie"))
    folder = tmp_path_factory.mktemp("native")
    program = folder / "usr/sbin/sfdisk"
    program.parent.mkdir(parents=True)
    for other in Path("/usr/sbin").iterdir():
        (program.parent / other.name).symlink_to(other)
    (folder / "usr/bin").symlink_to("/usr/bin")
    program.unlink()
    libraries = f"{unpacked}/lib/x86_64-linux-gnu:{unpacked}/usr/lib/x86_64-linux-gnu"
    loader = f"{unpacked}/lib64/ld-linux-x86-64.so.2 --library-path {libraries}"
    program.write_text(f'#!/bin/sh\nexec {loader} {unpacked}/usr/sbin/sfdisk "$@"\n')
    program.chmod(0o755)
    return folder


def boot_files(value: str) -> dict[str, str]:
    """The path on the card of each file in IMAGE_BOOT_FILES, by its name; a pattern becomes a name that it matches."""
    files = {}
    for entry in value.split():
        source, _, target = entry.partition(";")
        name = source.replace("*", "any")
        if "*" in source:
            files[name] = str(Path(target, Path(name).name))
        else:
            files[name] = target or source
    return files


def create(
    wic: Path, native: Path, yocto: Yocto, variables: dict[str, str], root: Path, folder: Path
) -> subprocess.CompletedProcess:
    """Run wic as do_image_wic does; the card is in `folder`/card."""
    image = yocto.profile.image.name
    places = {"IMAGE_ROOTFS": root, "DEPLOY_DIR_IMAGE": folder / "deploy", "STAGING_DATADIR": folder / "deploy"}
    lines = {**variables, **places, "RECIPE_SYSROOT_NATIVE": native}
    # BitBake has what a .wks.in comes to as a value. The task that writes the file follows those that build the image.
    template = lines.pop("_WKS_TEMPLATE")
    wks = folder / "filled-in.wks" if template else variables["WKS_FULL_PATH"]
    if template:
        wks.write_text(template)
    (folder / "variables").mkdir()
    (folder / f"variables/{image}.env").write_text("".join(f'{name}="{value}"\n' for name, value in lines.items()))
    command = [wic, "create", wks, "--vars", folder / "variables", "-e", image]
    path = f"{yocto.top / 'bitbake/bin'}:/usr/sbin:/usr/bin:/sbin:/bin"
    return subprocess.run(
        [*command, "--skip-build-check", "-o", folder / "card", "-w", folder / "work"],
        env={**os.environ, "BUILDDIR": str(folder), "PATH": path},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip


def variables_of(yocto: Yocto, machine: str) -> dict[str, str]:
    """The image's variables for a machine; no other recipe is parsed."""
    build = yocto.work / "build-cards"
    yocto.configure(build, machine)
    (recipe,) = yocto.layer.glob(f"recipes-core/*/{yocto.profile.image.name}.bb")
    return yocto.variables(f"--buildfile={recipe}", names=VARIABLES, build=build)


def boot_files_of(card: Card, variables: dict[str, str], machine: str) -> dict[str, str]:
    """The path on the card of each file that is there for booting, by its name in DEPLOY_DIR_IMAGE."""
    if card.efi is None:
        return boot_files(variables["IMAGE_BOOT_FILES"])
    files = {variables["KERNEL_IMAGETYPE"]: variables["KERNEL_IMAGETYPE"]}
    if variables["INITRAMFS_IMAGE"]:
        initramfs = f"{variables['INITRAMFS_IMAGE']}-{machine}.{variables['INITRAMFS_FSTYPES']}"
        files[initramfs] = initramfs
    files[LOADERS[variables["EFI_PROVIDER"]] + card.efi] = f"EFI/BOOT/{card.efi}"
    return files


def deploy(files: dict[str, str], folder: Path) -> None:
    """Make a stand-in for each boot file, no two the same."""
    for name in files:
        path = folder / "deploy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"stand-in for {name}\n" * 1000)


def content(image: Path, offset: int, path: str) -> str:
    """A file of the FAT file system at an offset of an image, as mtools read it."""
    command = ["mtype", "-i", f"{image}@@{offset}", f"::{path}"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@pytest.mark.parametrize("machine", CARDS)
def test_card(yocto, wic, native_sysroot, root_file_system, machine, tmp_path):
    if machine not in yocto.profile.machines:
        pytest.skip(f"{yocto.name} has no {machine}")
    expected = CARDS[machine]
    variables = variables_of(yocto, machine)
    assert any(kind.split(".")[0] == "wic" for kind in variables["IMAGE_FSTYPES"].split())
    files = boot_files_of(expected, variables, machine)
    deploy(files, tmp_path)
    done = create(wic, native_sysroot, yocto, variables, root_file_system, tmp_path)
    assert done.returncode == 0, done.stdout
    (card,) = (tmp_path / "card").glob("*.direct")

    table = json.loads(subprocess.run(["sfdisk", "--json", card], check=True, capture_output=True).stdout)
    table = table["partitiontable"]
    assert table["label"] == ("gpt" if expected.efi else "dos")
    partitions = table["partitions"]
    (boot,) = [partition for partition in partitions if partition["type"] == (GPT_FAT if expected.efi else FAT)]
    (root,) = [partition for partition in partitions if partition["type"] == (GPT_LINUX if expected.efi else LINUX)]
    assert boot.get("bootable") or boot.get("attrs") == "LegacyBIOSBootable"
    aligned = [partition["start"] * SECTOR % (expected.align_kib * 1024) for partition in (boot, root)]
    assert aligned == [0, 0] and boot["start"] > 0
    for partition, following in itertools.pairwise(partitions):
        assert following["start"] >= partition["start"] + partition["size"]
    assert (partitions[-1]["start"] + partitions[-1]["size"]) * SECTOR <= card.stat().st_size
    if expected.boot_mib is not None:
        assert boot["size"] * SECTOR == expected.boot_mib * MIB

    offset = boot["start"] * SECTOR
    label = subprocess.run(["mlabel", "-s", "-i", f"{card}@@{offset}", "::"], capture_output=True, text=True)
    assert label.stdout.split()[-1] == expected.boot_label
    for name, path in files.items():
        assert content(card, offset, path) == (tmp_path / "deploy" / name).read_text(), path
    if expected.efi:
        entry = {"grub-efi": "EFI/BOOT/grub.cfg", "systemd-boot": "loader/entries/boot.conf"}
        started = content(card, offset, entry[variables["EFI_PROVIDER"]])
        assert f"linux /{variables['KERNEL_IMAGETYPE']}" in started
        assert f"root=PARTUUID={root['uuid'].lower()}" in started

    system = tmp_path / "root.ext4"
    with card.open("rb") as stream:
        stream.seek(root["start"] * SECTOR)
        system.write_bytes(stream.read(root["size"] * SECTOR))
    subprocess.run(["e2fsck", "-f", "-n", system], check=True, capture_output=True)
    assert read(system, "/usr/lib/os-release") == (root_file_system / "usr/lib/os-release").read_text()
    assert re.search(r"^(/dev/\S+1|(PART)?UUID=\S+)\t/boot\tvfat\t", read(system, "/etc/fstab"), re.MULTILINE)
    header = subprocess.run(["dumpe2fs", "-h", system], check=True, capture_output=True, text=True).stdout
    assert f"Filesystem volume name:   {expected.root_label}\n" in header
    if machine == "pandaboard-es":
        figures = dict(line.split(":", 1) for line in header.splitlines() if ":" in line)
        free = int(figures["Free blocks"]) * int(figures["Block size"])
        assert free >= yocto.profile.machines[machine].sd_card.root_extra_mib * MIB * 0.9


def read(system: Path, path: str) -> str:
    """A file of an ext4 image."""
    return subprocess.run(["debugfs", "-R", f"cat {path}", system], check=True, capture_output=True, text=True).stdout


def test_boot_files_that_are_larger_than_their_partition(yocto, wic, native_sysroot, tmp_path):
    variables = variables_of(yocto, "pandaboard-es")
    deploy(boot_files(variables["IMAGE_BOOT_FILES"]), tmp_path)
    with (tmp_path / "deploy/zImage").open("wb") as stream:
        stream.truncate(65 * MIB)
    (tmp_path / "root").mkdir()
    done = create(wic, native_sysroot, yocto, variables, tmp_path / "root", tmp_path)
    assert done.returncode != 0
    assert "is larger than allowed size 65536 kB" in done.stdout
    assert not list((tmp_path / "card").glob("*.direct"))
