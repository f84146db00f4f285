"""The very image of each card, started in QEMU: `make test-boards`.

UEFI machines start by real firmware from a USB stick. QEMU has no OMAP4, so of the PandaBoard's card the kernel, the
RAM disk and the root file system start on another ARM machine; what its ROM and U-Boot read is compared with what they
need.
"""

import os
import re
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rtgen import debian
from rtgen.board import card
from rtgen.board.build import build
from rtgen.board.kernel import built_kernel, debian_kernel
from rtgen.board.machine import find, machines

pytestmark = [pytest.mark.boards, pytest.mark.qemu, pytest.mark.timeout(1800)]

# Generous: firmware and kernel are emulated beside whatever else runs here.
BOOT_S = 600
COMMAND_S = 120
GROWTH = 1 << 30

# By Debian's architecture: QEMU, the package of the firmware and its two files.
FIRMWARE = {
    "amd64": (
        ["qemu-system-x86_64", "-M", "q35", "-cpu", "max"],
        "ovmf",
        ("usr/share/OVMF/OVMF_CODE_4M.fd", "usr/share/OVMF/OVMF_VARS_4M.fd"),
    ),
    "arm64": (
        ["qemu-system-aarch64", "-M", "virt", "-cpu", "cortex-a72"],
        "qemu-efi-aarch64",
        ("usr/share/AAVMF/AAVMF_CODE.fd", "usr/share/AAVMF/AAVMF_VARS.fd"),
    ),
}
# U-Boot 2023.01's environment for the OMAP4: where it loads what, and how much memory it uses (bootm_size).
KERNEL_AT, DEVICE_TREE_AT, RAM_DISK_AT, MEMORY_END = 0x82000000, 0x88000000, 0x88080000, 0x80000000 + 0x10000000

Said = Callable[[str], str]


@pytest.fixture
def key(tmp_path: Path) -> Path:
    path = tmp_path / "login"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", path], check=True)
    return path


def built(machine: str, key: Path, place: Path, kernel: str = "debian", suite: str | None = None) -> Path:
    """The machine's card, as the copy on a card that is larger than the image."""
    folder = build(machine, place, kernel, login=key.with_suffix(".pub"), suite=suite)
    assert [path.name for path in folder.iterdir()] == ["card.img"], "no key that others could have"
    copy = place / "card.img"
    subprocess.run(["cp", "--sparse=always", folder / "card.img", copy], check=True)
    os.truncate(copy, copy.stat().st_size + GROWTH)
    return copy


@contextmanager
def running(qemu: list[str], key: Path, place: Path) -> Iterator[Said]:
    """Yield a function that runs a command on the board. The board has to power off when it is told to."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    console = place / "console.log"
    command = ["setpriv", "--pdeathsig", "KILL", *qemu, "-smp", "2", "-m", "1024", "-nodefaults", "-display", "none"]
    command += ["-serial", f"file:{console}", "-netdev", f"user,id=net,restrict=on,hostfwd=tcp:127.0.0.1:{port}-:22"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    options = [
        "-F",
        "none",
        "-i",
        str(key),
        "-o",
        f"UserKnownHostsFile={place}/known",
        "-o",
        "StrictHostKeyChecking=no",
    ]
    options += ["-o", "BatchMode=yes", "-o", "IdentitiesOnly=yes", "-o", "ConnectTimeout=20", "-o", "LogLevel=ERROR"]

    def ssh(command: str) -> subprocess.CompletedProcess[str]:
        words = ["ssh", *options, "-p", str(port), "root@127.0.0.1", command]
        return subprocess.run(words, capture_output=True, text=True, timeout=COMMAND_S)

    def said(command: str) -> str:
        done = ssh(command)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout.strip()

    try:
        deadline = time.monotonic() + BOOT_S
        while ssh("true").returncode != 0:
            shown = console.read_text(errors="replace") if console.exists() else ""
            assert process.poll() is None, shown
            assert time.monotonic() < deadline, shown
            time.sleep(1)
        yield said
        ssh("poweroff")
        assert process.wait(timeout=BOOT_S) == 0
    finally:
        process.kill()
        process.wait()


def check_board(said: Said, root: str) -> None:
    """What every card does: an RT kernel runs from its root file system, which grew, with a host key of its own."""
    assert "PREEMPT_RT" in said("uname -v")
    assert said("findmnt -n -o SOURCE /") == root
    assert int(said("df -k / | tail -1").split()[1]) * 1024 > GROWTH
    assert "No errors detected" in said(f"sfdisk --verify {root[:-1]}")
    assert said("ls /etc/ssh/ssh_host_*") == "/etc/ssh/ssh_host_ed25519_key\n/etc/ssh/ssh_host_ed25519_key.pub"
    assert "P:80" in said("cyclictest --quiet --mlockall --priority=80 --policy=fifo --loops=100 --threads=1")


UEFI = [(name, None) for name, each in machines().items() if each.medium == "uefi"]


@pytest.mark.parametrize(("machine", "suite"), [*UEFI, ("pc-x86_64", "trixie")])
def test_firmware_starts_the_stick(machine: str, suite: str | None, key: Path, tmp_path: Path) -> None:
    stick = built(machine, key, tmp_path, suite=suite)
    architecture = find(machine).architecture
    qemu, package, files = FIRMWARE[architecture]
    firmware = tmp_path / "firmware"
    firmware.mkdir()
    debian.extract([package], firmware, architecture, debian.source())
    command = [*qemu, "-device", "qemu-xhci", "-drive", f"file={stick},format=raw,if=none,id=stick"]
    command += ["-device", "usb-storage,drive=stick,removable=on", "-device", "virtio-net-pci,netdev=net,romfile="]
    for number, file in enumerate(files):
        command += ["-drive", f"if=pflash,unit={number},format=raw,file={firmware / file}"]
    with running(command, key, tmp_path) as said:
        check_board(said, "/dev/sda2")
        assert said("ls -d /sys/firmware/efi") == "/sys/firmware/efi", "started by UEFI, not by QEMU itself"


@pytest.mark.parametrize(
    ("kind", "suite"),
    [("debian", None), ("debian", "trixie"), pytest.param("built", None, marks=pytest.mark.kernel)],
)
def test_the_card_of_the_pandaboard(kind: str, suite: str | None, key: Path, tmp_path: Path) -> None:
    image = built("pandaboard-es", key, tmp_path, kind, suite)
    machine, source = find("pandaboard-es"), debian.source(suite)
    one = built_kernel("pandaboard-es") if kind == "built" else debian_kernel(machine.kernel, machine, source)
    boot = tmp_path / "boot"
    boot.mkdir()
    fat = f"{image}@@{card.START_MIB}M"
    subprocess.run(["mcopy", "-s", "-i", fat, "::/", boot], check=True)
    check_first_stages(boot)
    lines = [line.strip().split(maxsplit=1) for line in (boot / "extlinux/extlinux.conf").read_text().splitlines()]
    entry = dict(lines)
    kernel, ram_disk, device_tree = (boot / entry[word].lstrip("/") for word in ("kernel", "initrd", "fdt"))
    compatible = subprocess.run(["fdtget", device_tree, "/", "compatible"], capture_output=True, text=True, check=True)
    assert compatible.stdout.split()[0] == "ti,omap4-panda-es"
    # Kernel and device tree are of one build; ours has the device tree with the fine clock.
    assert kernel.read_bytes() == one.image.read_bytes()
    name = "omap4-panda-es-rt.dtb" if kind == "built" else "omap4-panda-es.dtb"
    assert device_tree.read_bytes() == (one.dtbs / name).read_bytes()
    assert KERNEL_AT + kernel.stat().st_size < DEVICE_TREE_AT
    assert DEVICE_TREE_AT + device_tree.stat().st_size < RAM_DISK_AT
    assert RAM_DISK_AT + ram_disk.stat().st_size < MEMORY_END
    assert re.search(r"\broot=UUID=[0-9a-f-]{36}\b", entry["append"])
    command = ["qemu-system-arm", "-M", "virt", "-cpu", "cortex-a15", "-kernel", str(kernel), "-initrd", str(ram_disk)]
    command += ["-append", f"{entry['append']} console=ttyAMA0", "-device", "virtio-net-device,netdev=net"]
    command += ["-drive", f"file={image},format=raw,if=none,id=card", "-device", "virtio-blk-device,drive=card"]
    with running(command, key, tmp_path) as said:
        check_board(said, "/dev/vda2")
        # The modules are those of the kernel that runs.
        assert said("uname -r") == said("ls /lib/modules") == one.release
        said("modprobe --dry-run ext4")
    # Its owner compares them at the first login.
    shown = (tmp_path / "console.log").read_text(errors="replace")
    assert re.search(r"start: SSH host key 256 SHA256:\S+ ", shown)
    assert re.search(r"start: addresses 10\.0\.2\.\d+ ", shown)


def check_first_stages(boot: Path) -> None:
    """MLO begins with a table of contents, then size and address of itself; it fits into the OMAP4's internal RAM.

    U-Boot's tools/omapimage.c writes it so, and its arch/arm/include/asm/arch-omap4/omap.h has the bounds of that RAM.
    u-boot.img has the header of U-Boot's legacy images (include/image.h).
    """
    loader = (boot / "MLO").read_bytes()
    assert loader[20:30] == b"CHSETTINGS"
    size, address = (int.from_bytes(loader[at : at + 4], "little") for at in (512, 516))
    assert address == 0x40300000
    assert 0 < size <= len(loader) - 512
    assert address + size <= 0x4030E000, "internal RAM is 56 KiB"
    assert b"u-boot.img\0" in loader
    assert (boot / "u-boot.img").read_bytes()[:4] == bytes.fromhex("27051956")
