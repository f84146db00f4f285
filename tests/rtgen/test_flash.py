"""Writing an image to a card: loop devices are the cards, /sys and /proc are real but for injected faults."""

import contextlib
import hashlib
import json
import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rtfiles.errors import InfrastructureError, UsageError
from rtgen import flash
from rtgen.cli import main

pytestmark = pytest.mark.root  # makes block devices of files
MIB = 1024 * 1024


def run(*argv):
    return subprocess.run([str(part) for part in argv], capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture
def image(tmp_path):
    """A card's image as wic makes it: partition table, then data that no two blocks share."""
    path = tmp_path / "rt-tests-image.wic"
    data = bytearray(b"".join(hashlib.sha256(str(i).encode()).digest() for i in range(9 * MIB // 32)) + b"tail")
    data[446:512] = bytes(64) + b"\x55\xaa"
    path.write_bytes(data)
    return path


@pytest.fixture
def attach(tmp_path):
    """Make a card of a size; detached again at the end."""
    attached = []

    def make(size, *options, table=None):
        backing = tmp_path / f"card{len(attached)}"
        with backing.open("wb") as stream:
            stream.truncate(size)
        if table:
            subprocess.run(["sfdisk", "-q", backing], input=table, text=True, check=True)
        device = run("losetup", "--find", "--show", *options, backing)
        attached.append(device)
        return Path(device), backing

    yield make
    for device in attached:
        run("losetup", "--detach", device)


def flash_it(image, device, *more):
    return main(["flash", "--image", str(image), "--device", str(device), *more])


def test_written_and_verified(image, attach, capsys):
    device, backing = attach(16 * MIB)
    assert flash_it(image, device, "--yes") == 0
    out = capsys.readouterr().out
    assert f"{image.stat().st_size} bytes written and verified" in out
    assert hashlib.sha256(image.read_bytes()).hexdigest() in out
    with backing.open("rb") as stream:
        assert stream.read(image.stat().st_size) == image.read_bytes()


def test_what_was_written_for_programs(image, attach, capsys):
    device, _ = attach(16 * MIB)
    assert flash_it(image, device, "--yes", "--json") == 0
    digest, size = hashlib.sha256(image.read_bytes()).hexdigest(), image.stat().st_size
    expected = {"schema": 1, "device": str(device), "bytes": size, "sha256": digest}
    assert json.loads(capsys.readouterr().out) == expected


@contextlib.contextmanager
def mounted(device, place):
    mount = place / "mnt"
    mount.mkdir()
    run("mount", device, mount)
    try:
        yield mount
    finally:
        run("umount", mount)


def test_refuses_a_mounted_card(image, attach, tmp_path, capsys):
    device, backing = attach(16 * MIB)
    run("mkfs.ext4", "-q", device)
    size = image.stat().st_size
    card = flash.check_device(device, size)
    with mounted(device, tmp_path) as mount:
        assert flash_it(image, device, "--yes") == 2
        assert f"{device}: in use: {device} is mounted on {mount}" in capsys.readouterr().err
        # Mounted between the check and the writing: the kernel refuses.
        with pytest.raises(InfrastructureError, match="busy"):
            flash.write(image, size, card, lambda *_: None)
    assert backing.read_bytes()[1080:1082] == b"\x53\xef"  # ext4 is still there


def test_refuses_a_card_whose_partition_is_mounted(image, attach, tmp_path, capsys):
    device, _ = attach(16 * MIB, "--partscan", table="label: dos\n2048,,L\n")
    partition = Path(f"{device}p1")
    if not partition.exists():  # a kernel that does not know this kind of partition table
        run("addpart", device, 1, 2048, 30720)
    assert flash_it(image, partition, "--yes") == 2
    assert f"{partition}: a partition, give the whole card: {device}" in capsys.readouterr().err
    run("mkfs.ext4", "-q", partition)
    with mounted(partition, tmp_path) as mount:
        assert flash_it(image, device, "--yes") == 2
        assert f"in use: {partition} is mounted on {mount}" in capsys.readouterr().err


def test_refuses_swap(image, attach, capsys):
    device, _ = attach(16 * MIB)
    run("mkswap", device)
    run("swapon", device)
    try:
        assert flash_it(image, device, "--yes") == 2
        assert "is swap" in capsys.readouterr().err
    finally:
        run("swapoff", device)


def test_refuses_a_small_card(image, attach, capsys):
    device, backing = attach(4 * MIB)
    assert flash_it(image, device, "--yes") == 2
    needed = image.stat().st_size
    assert f"{device}: too small: {4 * MIB} bytes, the image needs {needed} bytes" in capsys.readouterr().err
    assert backing.read_bytes() == bytes(4 * MIB)


def test_refuses_a_write_protected_card(image, attach, capsys):
    device, _ = attach(16 * MIB, "--read-only")
    assert flash_it(image, device, "--yes") == 2
    assert "write-protected" in capsys.readouterr().err


def test_refuses_a_disk_that_is_not_removable(attach, tmp_path):
    """A loop device whose /sys looks like a disk's."""
    device, _ = attach(16 * MIB)
    number = Path(f"/sys/block/{device.name}/dev").read_text().strip()
    node = tmp_path / "sys/dev/block" / number
    node.mkdir(parents=True)
    for name, value in (("dev", number), ("ro", "0"), ("removable", "0"), ("size", "32768")):
        (node / name).write_text(f"{value}\n")
    with pytest.raises(UsageError, match="not removable, so not an SD card"):
        flash.check_device(device, 1, sys=tmp_path / "sys")
    (node / "device").mkdir()
    (node / "device/type").write_text("SD\n")
    assert flash.check_device(device, 1, sys=tmp_path / "sys").size_bytes == 16 * MIB
    (node / "holders").mkdir()
    (node / "holders/dm-0").mkdir()
    with pytest.raises(UsageError, match=r"is part of dm-0"):
        flash.check_device(device, 1, sys=tmp_path / "sys")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("image.wic.gz", b"\x1f\x8b", "packed, unpack it first"),
        ("image.ext4", bytes(1024), "no partition table"),
        ("image.wic", b"short", "no partition table"),
        ("missing.wic", None, "No such file"),
    ],
)
def test_what_is_no_image(attach, tmp_path, capsys, name, content, message):
    device, _ = attach(16 * MIB)
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert flash_it(tmp_path / name, device, "--yes") == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "end_mib"),
    [
        ("label: dos\n2048,4096,c\n6144,12288,83\n", 9),  # sectors; the second partition ends with the image
        ("label: gpt\n2048,4096,U\n6144,8192,L\n", 10),  # the copy of the table ends with the disk
    ],
)
def test_an_image_that_is_cut_short(attach, tmp_path, capsys, table, end_mib):
    """A card of its size is smaller than its partitions: it would boot, and lose data when it gets full."""
    image = tmp_path / "card.wic"
    with image.open("wb") as stream:
        stream.truncate(end_mib * MIB)
    subprocess.run(["sfdisk", "-q", image], input=table, text=True, check=True)
    assert flash.check_image(image) == end_mib * MIB
    device, backing = attach(16 * MIB)
    with image.open("r+b") as stream:
        stream.truncate(8 * MIB)
    assert flash_it(image, device, "--yes") == 2
    expected = f"its partitions need {end_mib * MIB} bytes, the file has {8 * MIB}: unpack or copy it again"
    assert f"rtgen: {image}: cut short: {expected}" in capsys.readouterr().err
    assert not any(backing.read_bytes())


def test_what_is_no_device(image, capsys):
    assert flash_it(image, image, "--yes") == 2
    assert "not a block device" in capsys.readouterr().err
    assert flash_it(image, "/dev/no-such-card", "--yes") == 2
    assert "No such file" in capsys.readouterr().err


@pytest.mark.parametrize("stdin", [None, "/dev/null"])
def test_needs_somebody_to_ask(image, attach, capsys, monkeypatch, stdin):
    """Standard input is None where it was closed."""
    device, backing = attach(16 * MIB)
    monkeypatch.setattr("sys.stdin", stdin and Path(stdin).open())  # noqa: SIM115
    assert flash_it(image, device) == 2
    assert "give --yes" in capsys.readouterr().err
    assert backing.read_bytes() == bytes(16 * MIB)


@pytest.mark.parametrize(("answer", "status"), [("yes\n", 1), ("loop\n", 1), ("\4", 1), (None, 0)])  # \4: Ctrl-D
def test_confirmation(image, attach, answer, status):
    device, backing = attach(16 * MIB)
    master, terminal = pty.openpty()
    rtgen = Path(sys.executable).with_name("rtgen")
    process = subprocess.Popen(
        [rtgen, "flash", "--image", image, "--device", device], stdin=terminal, stdout=subprocess.PIPE, text=True
    )
    os.write(master, (answer or f"{device.name}\n").encode())
    out, _ = process.communicate(timeout=60)
    os.close(master)
    os.close(terminal)
    assert process.returncode == status, out
    assert ("Nothing was written" in out) == bool(status)
    assert (backing.read_bytes() == bytes(16 * MIB)) == bool(status)


def test_another_card_behind_the_name_is_not_written(image, attach, tmp_path):
    """Somebody changes cards while asked."""
    device, _ = attach(16 * MIB)
    size = image.stat().st_size
    card = flash.check_device(device, size)
    other = tmp_path / "other"
    other.write_bytes(bytes(16 * MIB))
    run("losetup", "--detach", device)
    run("losetup", device, other)
    assert flash.check_device(device, size).size_bytes == card.size_bytes
    with pytest.raises(InfrastructureError, match=f"^{device}: another device than the one that was checked"):
        flash.write(image, size, card, lambda *_: None)
    assert other.read_bytes() == bytes(16 * MIB)


@pytest.mark.parametrize("change_bytes", [-MIB, 0, MIB])
def test_an_image_that_changes_meanwhile_is_not_the_cards_fault(image, attach, change_bytes):
    """As by a build that writes it anew: behind the name is another file when the card is read back."""
    device, backing = attach(16 * MIB)
    content = image.read_bytes()
    card = flash.check_device(device, len(content))

    def rebuild(what, done):
        if what == "written" and done == len(content):
            image.unlink()
            image.write_bytes(bytes(len(content)))

    if change_bytes:
        with pytest.raises(InfrastructureError, match=f"^{image}: changed while it was written"):
            flash.write(image, len(content) + change_bytes, card, rebuild)
    else:
        assert flash.write(image, len(content), card, rebuild) == hashlib.sha256(content).hexdigest()
        assert backing.read_bytes()[: len(content)] == content


@pytest.mark.parametrize(
    ("source", "reason"), [("/proc/self/mem", "Input/output error"), ("/no.wic", "No such file or directory")]
)
def test_an_image_that_fails_is_not_the_cards_fault(attach, source, reason):
    """It may go between the check and the writing: somebody is asked there."""
    device, backing = attach(16 * MIB)
    card = flash.check_device(device, 1)
    with pytest.raises(InfrastructureError, match=f"^{source}: {reason}$"):
        flash.write(Path(source), 1, card, lambda *_: None)
    assert backing.read_bytes() == bytes(16 * MIB)


def test_a_card_that_keeps_something_else(image, attach, monkeypatch):
    """Cards that claim a size they do not have wrap around: what was written first is overwritten."""
    device, backing = attach(16 * MIB)
    card = flash.check_device(device, image.stat().st_size)
    spoilt = []

    def spoil(what, _done):
        if what == "written" and not spoilt:
            spoilt.append(what)
            monkeypatch.setattr(flash.fcntl, "ioctl", forget)

    real = flash.fcntl.ioctl

    def forget(handle, request, *more):
        if request == flash.BLKFLSBUF:
            with backing.open("r+b") as stream:
                stream.seek(5000)
                stream.write(b"\0\0\0\0")
            real(handle, request, *more)
        return 0

    expected = f"bytes 0 to {flash.CHUNK - 1} read back otherwise than written, the card is broken"
    with pytest.raises(InfrastructureError, match=expected):
        flash.write(image, image.stat().st_size, card, spoil)


def test_tools_of_these_tests_are_there():
    for tool in ("losetup", "mkfs.ext4", "sfdisk", "mkswap"):
        assert shutil.which(tool), f"{tool}: install util-linux, fdisk and e2fsprogs"
