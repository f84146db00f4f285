"""The very image of each card, started in QEMU: `make test-boards`.

UEFI machines start by real firmware from a USB stick. QEMU has no OMAP4, so of the PandaBoard's card the kernel, the
RAM disk and the root file system start on another ARM machine; what its ROM and U-Boot read is compared with what they
need.
"""

import json
import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

import rtrun.cli
from ports import free_port
from rtgen import debian
from rtgen.board import card
from rtgen.board.build import build
from rtgen.board.kernel import built_kernel, debian_kernel
from rtgen.board.machine import find

pytestmark = [pytest.mark.boards, pytest.mark.qemu, pytest.mark.timeout(1800)]

# Generous: firmware and kernel are emulated beside whatever else runs here.
BOOT_S = 600
COMMAND_S = 120
GROWTH = 1 << 30

# By Debian's architecture: QEMU, the package of the firmware and its two files.
FIRMWARE = {
    "amd64": (
        # A processor that is emulated beside other work may miss the interrupts by which Linux tries its timer, and
        # panics; systemd's stub takes this since version 254.
        [
            *("qemu-system-x86_64", "-M", "q35", "-cpu", "max"),
            *("-smbios", "type=11,value=io.systemd.stub.kernel-cmdline-extra=no_timer_check"),
        ],
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

OutputOf = Callable[[str], str]


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
def running(qemu: list[str], key: Path, place: Path, port: int | None = None) -> Iterator[OutputOf]:
    """Yield a function that runs a command on the board. The board has to power off when it is told to."""
    port = port or free_port()
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

    def output_of(command: str) -> str:
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
        yield output_of
        ssh("poweroff")
        assert process.wait(timeout=BOOT_S) == 0
    finally:
        process.kill()
        process.wait()


def check_board(output_of: OutputOf, root: str) -> None:
    """What every card does: an RT kernel runs from its root file system, which grew, with a host key of its own."""
    assert "PREEMPT_RT" in output_of("uname -v")
    assert output_of("findmnt -n -o SOURCE /") == root
    assert int(output_of("df -k / | tail -1").split()[1]) * 1024 > GROWTH
    assert "No errors detected" in output_of(f"sfdisk --verify {root[:-1]}")
    assert output_of("ls /etc/ssh/ssh_host_*") == "/etc/ssh/ssh_host_ed25519_key\n/etc/ssh/ssh_host_ed25519_key.pub"
    assert "P:80" in output_of("cyclictest --quiet --mlockall --priority=80 --policy=fifo --loops=100 --threads=1")


# The stick of a PC is started below, with both kernels of Debian 12.
@pytest.mark.parametrize(("machine", "suite"), [("generic-arm64", None), ("pc-x86_64", "trixie")])
def test_firmware_starts_the_stick(machine: str, suite: str | None, key: Path, tmp_path: Path) -> None:
    stick = built(machine, key, tmp_path, suite=suite)
    with running(from_stick(machine, stick, tmp_path), key, tmp_path) as output_of:
        check_stick(output_of)


def check_stick(output_of: OutputOf) -> None:
    check_board(output_of, "/dev/sda2")
    assert output_of("ls -d /sys/firmware/efi") == "/sys/firmware/efi", "started by UEFI, not by QEMU itself"


def from_stick(machine: str, stick: Path, place: Path) -> list[str]:
    """The QEMU command that starts this stick by real firmware."""
    architecture = find(machine).architecture
    qemu, package, files = FIRMWARE[architecture]
    firmware = place / "firmware"
    firmware.mkdir()
    debian.extract([package], firmware, architecture, debian.source())
    command = [*qemu, "-device", "qemu-xhci", "-drive", f"file={stick},format=raw,if=none,id=stick"]
    command += ["-device", "usb-storage,drive=stick,removable=on", "-device", "virtio-net-pci,netdev=net,romfile="]
    for number, file in enumerate(files):
        command += ["-drive", f"if=pflash,unit={number},format=raw,file={firmware / file}"]
    return command


CAMPAIGN = """
schema: 1
name: both
kernels: [standard, rt]
runs: [{suite: cyclictest, repetitions: 2000, policy: RR}]
"""


def test_a_stick_with_both_kernels_is_measured_on_each(key: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    stick, port = built("pc-x86_64", key, tmp_path, kernel="both"), free_port()
    with running(from_stick("pc-x86_64", stick, tmp_path), key, tmp_path, port) as output_of:
        check_stick(output_of)
        with pytest.raises(AssertionError, match="no kernel 'other' on this card, there are: rt standard"):
            output_of("boot-kernel other")
        fingerprint = output_of("ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub").split()[1]
        words = ["--host", "127.0.0.1", "--port", str(port), "--key", str(key), "--host-key", fingerprint]
        # Without this user's ~/.ssh; not before, as the cache is in that folder.
        monkeypatch.setenv("HOME", str(tmp_path))
        # It has no suites.
        assert rtrun.cli.main(["new-target", *words, "--name", "stick"]) == 0
        target = yaml.safe_load(Path("stick.yml").read_text())
        assert target["boot_kernel"] == {"standard": ["boot-kernel", "standard"], "rt": ["boot-kernel", "rt"]}
        Path("stick.yml").write_text(yaml.safe_dump(target | {"reconnect_s": BOOT_S}))
        Path("campaign.yml").write_text(CAMPAIGN)
        assert rtrun.cli.main(["run", "campaign.yml", "--target", "stick.yml"]) == 0, capsys.readouterr()
        # It started with rt, so it was restarted into each.
        assert "PREEMPT_RT" in output_of("uname -v")
    for kernel in ("standard", "rt"):
        (path,) = Path("results/both").glob(f"*-{kernel}/run.json")
        record = json.loads(path.read_text())
        assert (record["status"], record["target"]["preempt_rt"]) == ("ok", kernel == "rt")


@pytest.mark.parametrize(
    ("kind", "suite"),
    [("debian", None), ("debian", "trixie"), pytest.param("built", None, marks=pytest.mark.kernel)],
)
def test_the_card_of_the_pandaboard(kind: str, suite: str | None, key: Path, tmp_path: Path) -> None:
    image = built("pandaboard-es", key, tmp_path, kind, suite)
    machine, source = find("pandaboard-es"), debian.source(suite)
    expected = built_kernel("pandaboard-es") if kind == "built" else debian_kernel(machine.kernel, machine, source)
    entry = read_entry(image, tmp_path / "boot")
    check_first_stages(tmp_path / "boot")
    kernel, ram_disk, device_tree = entry.kernel, entry.ram_disk, entry.device_tree
    compatible = subprocess.run(["fdtget", device_tree, "/", "compatible"], capture_output=True, text=True, check=True)
    assert compatible.stdout.split()[0] == "ti,omap4-panda-es"
    # Kernel and device tree are of one build; ours has the device tree with the fine clock.
    assert kernel.read_bytes() == expected.image.read_bytes()
    name = "omap4-panda-es-rt.dtb" if kind == "built" else "omap4-panda-es.dtb"
    assert device_tree.read_bytes() == (expected.dtbs / name).read_bytes()
    assert KERNEL_AT + kernel.stat().st_size < DEVICE_TREE_AT
    assert DEVICE_TREE_AT + device_tree.stat().st_size < RAM_DISK_AT
    assert RAM_DISK_AT + ram_disk.stat().st_size < MEMORY_END
    assert re.search(r"\broot=UUID=[0-9a-f-]{36}\b", entry.command_line)
    with running(from_card(image, entry), key, tmp_path) as output_of:
        check_board(output_of, "/dev/vda2")
        # The modules are those of the kernel that runs.
        assert output_of("uname -r") == output_of("ls /lib/modules") == expected.release
        output_of("/sbin/modprobe --dry-run ext4")
    # Its owner compares them at the first login.
    shown = (tmp_path / "console.log").read_text(errors="replace")
    assert re.search(r"start: SSH host key 256 SHA256:\S+ ", shown)
    assert re.search(r"start: addresses 10\.0\.2\.\d+ ", shown)


def test_the_card_of_the_pandaboard_starts_the_kernel_that_was_chosen(key: Path, tmp_path: Path) -> None:
    image = built("pandaboard-es", key, tmp_path, "both")
    for number, kernel in enumerate(("rt", "standard")):
        entry = read_entry(image, tmp_path / f"boot{number}")
        with running(from_card(image, entry), key, tmp_path) as output_of:
            assert ("PREEMPT_RT" in output_of("uname -v")) == (kernel == "rt")
            assert f"/lib/modules/{output_of('uname -r')}" in output_of("ls -d /lib/modules/*").split()
            output_of("boot-kernel standard")


@dataclass(frozen=True)
class Entry:
    """What U-Boot starts by the extlinux.conf of a card."""

    kernel: Path
    ram_disk: Path
    device_tree: Path
    command_line: str


def read_entry(image: Path, boot: Path) -> Entry:
    """What a card starts; `boot` becomes a copy of its boot partition."""
    boot.mkdir()
    subprocess.run(["mcopy", "-s", "-i", f"{image}@@{card.START_MIB}M", "::/", boot], check=True)
    lines = (boot / "extlinux/extlinux.conf").read_text().splitlines()
    words = dict(line.strip().split(maxsplit=1) for line in lines)
    kernel, ram_disk, device_tree = (boot / words[word].lstrip("/") for word in ("kernel", "initrd", "fdt"))
    return Entry(kernel=kernel, ram_disk=ram_disk, device_tree=device_tree, command_line=words["append"])


def from_card(image: Path, entry: Entry) -> list[str]:
    """The QEMU command that starts what U-Boot would, on another ARM machine."""
    command = ["qemu-system-arm", "-M", "virt", "-cpu", "cortex-a15", "-kernel", str(entry.kernel)]
    command += ["-initrd", str(entry.ram_disk), "-append", f"{entry.command_line} console=ttyAMA0"]
    command += ["-drive", f"file={image},format=raw,if=none,id=card", "-device", "virtio-blk-device,drive=card"]
    return [*command, "-device", "virtio-net-device,netdev=net"]


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
