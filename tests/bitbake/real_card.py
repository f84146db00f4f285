"""Cards as openembedded-core's own wic makes them: partitions, file systems and boot files.

`make test-yocto` runs this beside real_layers.py. The root file system is that of the emulated board; the boot files,
which would have to be built, are stand-ins. wic needs parted, mtools, dosfstools and e2fsprogs on this machine.
"""

import io
import json
import os
import re
import subprocess
import tarfile
from dataclasses import dataclass
from pathlib import Path

import pytest

from bitbake.yocto import Yocto
from rtgen.board import build as board

pytestmark = [pytest.mark.bitbake, pytest.mark.timeout(1800)]

SECTOR = 512
MIB = 2**20
# Of the image.
VARIABLES = ("IMAGE_BOOT_FILES", "IMAGE_FSTYPES", "WKS_FULL_PATH")
FAT, LINUX = "c", "83"


@dataclass(frozen=True, kw_only=True, slots=True)
class Card:
    """A machine's card by its .wks: alignment of the partitions, and the size of the first (None: wic chooses)."""

    align_kib: int
    boot_mib: int | None


# wic's plugin for those of the other machines takes boot loaders that only a build makes.
CARDS = {
    "pandaboard-es": Card(align_kib=4096, boot_mib=64),
    "beaglebone-yocto": Card(align_kib=4, boot_mib=32),
    "raspberrypi4-64": Card(align_kib=4096, boot_mib=None),
    "raspberrypi5": Card(align_kib=4096, boot_mib=None),
}


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


def create(wic: Path, yocto: Yocto, variables: dict[str, str], root: Path, folder: Path) -> subprocess.CompletedProcess:
    """Run wic as do_image_wic does; the card is in `folder`/card."""
    image = yocto.profile.image.name
    places = {"IMAGE_ROOTFS": root, "DEPLOY_DIR_IMAGE": folder / "deploy", "STAGING_DATADIR": folder / "deploy"}
    lines = {**variables, **places, "RECIPE_SYSROOT_NATIVE": "/"}
    (folder / "variables").mkdir()
    (folder / f"variables/{image}.env").write_text("".join(f'{name}="{value}"\n' for name, value in lines.items()))
    command = [wic, "create", variables["WKS_FULL_PATH"], "--vars", folder / "variables", "-e", image]
    path = f"{yocto.top / 'bitbake/bin'}:/usr/sbin:/usr/bin:/sbin:/bin"
    return subprocess.run(
        [*command, "--skip-build-check", "-o", folder / "card", "-w", folder / "work"],
        env={**os.environ, "BUILDDIR": str(folder), "PATH": path},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip


def variables_of(yocto: Yocto, machine: str) -> dict[str, str]:
    """The image's variables for a machine; no other recipe is parsed."""
    build = yocto.top / "build-cards"
    yocto.configure(build, machine)
    (recipe,) = yocto.layer.glob(f"recipes-core/*/{yocto.profile.image.name}.bb")
    return yocto.variables(f"--buildfile={recipe}", names=VARIABLES, build=build)


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
def test_card(yocto, wic, root_file_system, machine, tmp_path):
    if machine not in yocto.profile.machines:
        pytest.skip(f"{yocto.name} has no {machine}")
    variables = variables_of(yocto, machine)
    assert any(kind.split(".")[0] == "wic" for kind in variables["IMAGE_FSTYPES"].split())
    files = boot_files(variables["IMAGE_BOOT_FILES"])
    deploy(files, tmp_path)
    done = create(wic, yocto, variables, root_file_system, tmp_path)
    assert done.returncode == 0, done.stdout
    (card,) = (tmp_path / "card").glob("*.direct")

    table = json.loads(subprocess.run(["sfdisk", "--json", card], check=True, capture_output=True).stdout)
    assert table["partitiontable"]["label"] == "dos"
    boot, root = table["partitiontable"]["partitions"]
    expected = CARDS[machine]
    assert (boot["type"], boot["bootable"], root["type"]) == (FAT, True, LINUX)
    assert {part["start"] * SECTOR % (expected.align_kib * 1024) for part in (boot, root)} == {0}
    assert boot["start"] > 0 and root["start"] >= boot["start"] + boot["size"]
    assert (root["start"] + root["size"]) * SECTOR <= card.stat().st_size
    if expected.boot_mib is not None:
        assert boot["size"] * SECTOR == expected.boot_mib * MIB

    label = subprocess.run(
        ["mlabel", "-s", "-i", f"{card}@@{boot['start'] * SECTOR}", "::"], capture_output=True, text=True
    )
    assert label.stdout.split()[-1] == "boot"
    for name, path in files.items():
        assert content(card, boot["start"] * SECTOR, path) == (tmp_path / "deploy" / name).read_text(), path

    system = tmp_path / "root.ext4"
    with card.open("rb") as stream:
        stream.seek(root["start"] * SECTOR)
        system.write_bytes(stream.read(root["size"] * SECTOR))
    subprocess.run(["e2fsck", "-f", "-n", system], check=True, capture_output=True)
    assert read(system, "/usr/lib/os-release") == (root_file_system / "usr/lib/os-release").read_text()
    assert re.search(r"^(/dev/mmcblk0p1|UUID=\S+)\t/boot\tvfat\t", read(system, "/etc/fstab"), re.MULTILINE)
    header = subprocess.run(["dumpe2fs", "-h", system], check=True, capture_output=True, text=True).stdout
    assert "Filesystem volume name:   root\n" in header
    if machine == "pandaboard-es":
        figures = dict(line.split(":", 1) for line in header.splitlines() if ":" in line)
        free = int(figures["Free blocks"]) * int(figures["Block size"])
        assert free >= yocto.profile.machines[machine].sd_card.root_extra_mib * MIB * 0.9


def read(system: Path, path: str) -> str:
    """A file of an ext4 image."""
    return subprocess.run(["debugfs", "-R", f"cat {path}", system], check=True, capture_output=True, text=True).stdout


def test_boot_files_that_are_larger_than_their_partition(yocto, wic, tmp_path):
    variables = variables_of(yocto, "pandaboard-es")
    deploy(boot_files(variables["IMAGE_BOOT_FILES"]), tmp_path)
    with (tmp_path / "deploy/zImage").open("wb") as stream:
        stream.truncate(65 * MIB)
    (tmp_path / "root").mkdir()
    done = create(wic, yocto, variables, tmp_path / "root", tmp_path)
    assert done.returncode != 0
    assert "is larger than allowed size 65536 kB" in done.stdout
    assert not list((tmp_path / "card").glob("*.direct"))
