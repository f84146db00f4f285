"""Cards for real hardware: the layout that firmware looks for, and who can log in; with small file systems."""

import json
import os
import re
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from rtgen import cli, debian, flash
from rtgen.board import card, disk, u_boot, uefi
from rtgen.board.boot import BootFiles, KernelBoot
from rtgen.board.machine import UBoot, architectures

MIB = 2**20


def output(*command: str | Path) -> str:
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=True).stdout


@pytest.fixture
def key(tmp_path: Path) -> Path:
    """A key pair; the private half."""
    path = tmp_path / "login"
    output("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", path)
    return path


@pytest.fixture
def system(tmp_path: Path) -> Path:
    """A file system with the keys of the board that it was made for."""
    tree = tmp_path / "tree"
    (tree / "etc/ssh").mkdir(parents=True)
    (tree / "root/.ssh").mkdir(parents=True)
    disk.add_keys(tree, tmp_path)
    image = tmp_path / "system.img"
    with image.open("wb") as stream:
        stream.truncate(8 * MIB)
    output("mke2fs", "-q", "-t", "ext4", "-d", tree, image)
    return image


def test_a_card_has_what_uefi_looks_for(tmp_path: Path, system: Path) -> None:
    program = tmp_path / "boot.efi"
    program.write_bytes(b"EFI file")
    image = tmp_path / "card.img"
    card.write_card(image, "gpt", {"EFI/BOOT/BOOTX64.EFI": program}, system)
    table = json.loads(output("sfdisk", "--json", image))["partitiontable"]
    assert table["label"] == "gpt"
    boot, root = table["partitions"]
    # UEFI specification 2.10, table 5.7: the type of the EFI system partition.
    assert boot["type"] == "C12A7328-F81F-11D2-BA4B-00A0C93EC93B"
    assert (boot["start"], boot["size"]) == (card.START_MIB * 2048, card.BOOT_MIB * 2048)
    assert root["start"] == boot["start"] + boot["size"]
    assert root["size"] * 512 == system.stat().st_size
    assert subprocess.run(["sfdisk", "--verify", image], capture_output=True, check=True).stderr == b""
    assert output("mtype", "-i", f"{image}@@{card.START_MIB}M", "::/EFI/BOOT/BOOTX64.EFI") == "EFI file"
    with image.open("rb") as stream:
        stream.seek(root["start"] * 512)
        assert stream.read()[: system.stat().st_size] == system.read_bytes()
    assert flash.check_image(image) == image.stat().st_size
    # Only what has content is on the disk.
    assert image.stat().st_blocks * 512 < 16 * MIB


def test_a_card_with_two_kernels_starts_the_first_and_has_a_file_of_each_to_choose(tmp_path: Path) -> None:
    files = {name: tmp_path / name for name in ("rt", "standard", "MLO")}
    both = {name: files[name] for name in ("rt", "standard")}
    loaded = BootFiles(path="extlinux/extlinux.conf", by_kernel=both, others={"MLO": files["MLO"]})
    by_path = card.files_by_path(loaded, tmp_path)
    assert by_path == {
        "MLO": files["MLO"],
        "extlinux/extlinux.conf": files["rt"],
        "kernels/rt": files["rt"],
        "kernels/standard": files["standard"],
        "kernel-path.txt": tmp_path / "kernel-path.txt",
    }
    assert (tmp_path / "kernel-path.txt").read_text() == "extlinux/extlinux.conf\n"
    alone = BootFiles(path="extlinux/extlinux.conf", by_kernel={"rt": files["rt"]}, others={})
    assert card.files_by_path(alone, tmp_path) == {"extlinux/extlinux.conf": files["rt"]}


BOOT_KERNEL = Path(disk.__file__).parent / "root/usr/sbin/boot-kernel"


@pytest.fixture
def boot_kernel(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """The command boot-kernel on a card in /dev/mmcblk0 whose first partition is the folder `boot`."""
    programs, script = tmp_path / "bin", 'mount -t tmpfs run /run && PATH="$1:$PATH" && shift && exec "$@"'
    wanted = "-t vfat /dev/mmcblk0p1 /run/boot-partition"
    programs.mkdir()
    for name, words in {
        "findmnt": "echo /dev/mmcblk0p2",
        "mount": f'[ "$*" = "{wanted}" ] && exec /bin/mount --bind {tmp_path}/boot "$4"',
    }.items():
        (programs / name).write_text(f"#!/bin/sh\n{words}\n")
        (programs / name).chmod(0o755)
    wrapper = ["unshare", "--mount", "sh", "-c", script, "sh", str(programs)]
    if subprocess.run([*wrapper, "true"], capture_output=True).returncode != 0:
        pytest.skip("this user may not mount in a namespace of its own")
    return lambda *words: subprocess.run([*wrapper, BOOT_KERNEL, *words], capture_output=True, text=True)


def test_boot_kernel_copies_the_file_of_a_kernel_to_where_firmware_looks(
    tmp_path: Path, boot_kernel: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    """test_card_boot.py does so on real cards."""
    boot = tmp_path / "boot"
    (boot / "EFI/BOOT").mkdir(parents=True)
    started = boot / "EFI/BOOT/BOOTX64.EFI"
    started.write_text("rt")
    assert boot_kernel().stderr == "boot-kernel: this card has one kernel\n"
    (boot / "kernels").mkdir()
    (boot / "kernel-path.txt").write_text("EFI/BOOT/BOOTX64.EFI\n")
    for name in ("rt", "standard"):
        (boot / "kernels" / name).write_text(name)
    assert boot_kernel().stdout == "rt\nstandard\n"
    done = boot_kernel("other")
    assert (done.returncode, done.stderr) == (
        1,
        "boot-kernel: no kernel 'other' on this card, there are: rt standard\n",
    )
    assert started.read_text() == "rt"
    for name in ("standard", "rt"):
        assert boot_kernel(name).returncode == 0
        assert started.read_text() == (boot / "kernels" / name).read_text() == name
    assert sorted(path.name for path in started.parent.iterdir()) == ["BOOTX64.EFI"]


def test_u_boot_loads_each_kernel_with_its_own_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(u_boot, "file_of", lambda package, name, *_: tmp_path / name)
    boots = {
        name: KernelBoot(
            kernel=tmp_path / f"{name}.kernel",
            ram_disk=tmp_path / f"{name}.initrd",
            command_line=f"root={name}",
            device_tree=tmp_path / f"{name}.dtb",
        )
        for name in ("rt", "standard")
    }
    loader = UBoot(package="u-boot", files=["usr/lib/MLO"], device_tree="board.dtb")
    loaded = u_boot.boot_files("armhf", loader, debian.PackageSource(release="bookworm", mirror=None), boots, tmp_path)
    for name, configuration in loaded.by_kernel.items():
        words = dict(line.split(maxsplit=1) for line in configuration.read_text().splitlines())
        assert words["append"] == f"root={name}"
        files = [loaded.others[words[key].lstrip("/")].name for key in ("kernel", "initrd", "fdt")]
        assert files == [f"{name}.kernel", f"{name}.initrd", f"{name}.dtb"]
    assert loaded.others["MLO"] == tmp_path / "usr/lib/MLO"


@pytest.mark.parametrize(
    "name", [name for name, architecture in architectures().items() if architecture.uefi is not None]
)
def test_the_efi_file_holds_its_parts_where_the_stub_has_none(tmp_path: Path, name: str) -> None:
    architecture = architectures()[name]
    # A program in PE format without a stub's code: what objcopy needs to add sections.
    stub = tmp_path / "stub.efi"
    write_pe(stub, {"amd64": 0x8664, "arm64": 0xAA64}[name])
    kernel, command_line = tmp_path / "kernel", tmp_path / "cmdline"
    kernel.write_bytes(bytes(range(256)) * 40)
    command_line.write_bytes(b"root=/dev/sda2")
    result = tmp_path / "result.efi"
    uefi.write_efi_file(result, stub, architecture.triplet, {".cmdline": command_line, ".linux": kernel})
    end = uefi.image_end(stub.read_bytes())
    at = sections(result)
    assert at[".cmdline"] == (end, b"root=/dev/sda2")
    address, content = at[".linux"]
    assert address == end + 4096
    assert content == kernel.read_bytes()


def write_pe(path: Path, machine: int) -> None:
    """The smallest PE32+ program with one section, for objcopy to read."""
    optional = struct.pack("<HBBIIIII", 0x20B, 0, 0, 512, 0, 0, 0x1000, 0x1000)
    optional += struct.pack("<QIIHHHHHHIIIIHHQQQQII", 0x10000, 0x1000, 512, 0, 0, 0, 0, 0, 0, 0, 0x2000, 512, 0, 10, 0,
                            0, 0, 0, 0, 0, 16)  # fmt: skip
    optional += bytes(16 * 8)
    header = struct.pack("<HHIIIHH", machine, 1, 0, 0, 0, len(optional), 0x202)
    section = struct.pack("<8sIIIIIIHHI", b".text", 512, 0x1000, 512, 512, 0, 0, 0, 0, 0x60000020)
    dos = b"MZ" + bytes(0x3A) + struct.pack("<I", 0x40)
    path.write_bytes((dos + b"PE\0\0" + header + optional + section).ljust(512, b"\0") + bytes(512))


def sections(path: Path) -> dict[str, tuple[int, bytes]]:
    """Address and content of each section of a PE program."""
    data = path.read_bytes()
    (header,) = struct.unpack_from("<I", data, 0x3C)
    (count,) = struct.unpack_from("<H", data, header + 6)
    (length,) = struct.unpack_from("<H", data, header + 20)
    (base,) = struct.unpack_from("<Q", data, header + 24 + 24)
    table = {}
    for number in range(count):
        name, size, address, stored, at = struct.unpack_from("<8sIIII", data, header + 24 + length + 40 * number)
        table[name.rstrip(b"\0").decode()] = (base + address, data[at : at + min(size, stored)])
    return table


def test_a_card_has_no_host_key_and_takes_the_keys_given(tmp_path: Path, system: Path, key: Path) -> None:
    card.set_keys(system, key.with_suffix(".pub"))
    assert output("debugfs", "-R", "cat /root/.ssh/authorized_keys", system) == key.with_suffix(".pub").read_text()
    status = output("debugfs", "-R", "stat /root/.ssh/authorized_keys", system)
    assert "Mode:  0600" in status
    assert "User:     0   Group:     0" in status
    assert output("debugfs", "-R", "ls -p /etc/ssh", system).count("ssh_host") == 0
    # What is left is a sound file system.
    assert subprocess.run(["e2fsck", "-f", "-n", system], capture_output=True).returncode == 0


def test_keys_with_the_line_ends_of_windows_are_taken(tmp_path: Path, system: Path, key: Path) -> None:
    login = tmp_path / "login.pub"
    login.write_bytes(key.with_suffix(".pub").read_bytes().replace(b"\n", b"\r\n"))
    card.set_keys(system, login)
    assert "ssh-" in output("debugfs", "-R", "cat /root/.ssh/authorized_keys", system)


def test_two_kernels_of_arm64_and_a_copy_of_one_have_room(tmp_path: Path, system: Path) -> None:
    """Each EFI file has an Image that is not compressed: what is started, one of each kernel, and a new one."""
    program = tmp_path / "boot.efi"
    program.touch()
    os.truncate(program, 45 * MIB)
    card.write_card(tmp_path / "card.img", "gpt", {f"kernels/{n}": program for n in range(4)}, system)


INIT = Path(disk.__file__).parent / "root/etc/init.d"


@pytest.mark.parametrize(("behind", "steps"), [(100_000, ["sfdisk", "partx", "resize2fs"]), (2048, ["resize2fs"])])
def test_a_card_grows_to_its_end_though_the_power_was_cut_between(
    tmp_path: Path, behind: int, steps: list[str]
) -> None:
    """The partition was enlarged already, its file system was not."""
    part = tmp_path / "class/mmcblk0/mmcblk0p2"
    part.mkdir(parents=True)
    (tmp_path / "class/mmcblk0p2").symlink_to(part)
    for file, text in {"partition": "2", "start": "1000", "size": "5000", "../size": str(6000 + behind)}.items():
        (part / file).write_text(text)
    (tmp_path / "bin").mkdir()
    for name in ("findmnt", "sfdisk", "partx", "resize2fs"):
        (tmp_path / "bin" / name).write_text(
            "#!/bin/sh\necho /dev/mmcblk0p2\n" if name == "findmnt" else f"#!/bin/sh\necho {name} >>{tmp_path}/calls\n"
        )
        (tmp_path / "bin" / name).chmod(0o755)
    script = (INIT / "grow").read_text().replace("/sys/class/block", f"{tmp_path}/class")
    subprocess.run(["sh", "-c", script], env={"PATH": f"{tmp_path}/bin:/usr/bin:/bin"}, check=True)
    assert (tmp_path / "calls").read_text().split() == steps


def test_a_host_key_that_a_power_cut_left_empty_is_made_anew(tmp_path: Path) -> None:
    lines = re.search(r"^key=.*?^\[ -s .*?\n", (INIT / "start").read_text(), re.M | re.S)
    assert lines is not None
    key = tmp_path / "ssh_host_ed25519_key"
    key.touch()
    for _ in range(2):
        subprocess.run(["sh", "-c", lines[0].replace("/etc/ssh", str(tmp_path))], check=True)
        assert "PRIVATE KEY" in key.read_text()
        content = key.read_bytes()
    assert key.read_bytes() == content


def test_without_keys_the_one_of_the_image_stays(tmp_path: Path, system: Path) -> None:
    card.set_keys(system, None)
    public = (tmp_path / f"{disk.KEY}.pub").read_text()
    assert output("debugfs", "-R", "cat /root/.ssh/authorized_keys", system) == public
    assert output("debugfs", "-R", "ls -p /etc/ssh", system).count("ssh_host") == 0


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "No such file or directory"),
        ("pipe", "not a regular file"),
        # The name of a test is in the environment of what it starts: a long one leaves no room for arguments.
        pytest.param("# long\n" * 2**18, "larger than 1048576 bytes", id="long"),
        ("", "no public key in it"),
        ("ssh-ed25519 AAAA me@here\n", "no public key in it"),
        ("-----BEGIN OPENSSH PRIVATE KEY-----\n", "a private key, give the public one"),
    ],
)
def test_a_file_without_public_keys_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None, expected: str
) -> None:
    path = tmp_path / "keys"
    if content == "pipe":  # it would block whoever reads it
        os.mkfifo(path)
    elif content is not None:
        path.write_text(content)
    assert cli.main(["board", "build", "--machine", "pc-x86_64", "--authorized-key", str(path)]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1
    assert errors[0].startswith(f"rtgen: {path}: {expected}")


def test_a_board_in_qemu_takes_no_key(capsys: pytest.CaptureFixture[str], key: Path) -> None:
    assert cli.main(["board", "build", "--machine", "qemu-x86_64", "--authorized-key", f"{key}.pub"]) == 2
    assert capsys.readouterr().err.endswith("--authorized-key is for cards\n")


def test_a_card_has_what_the_rom_of_an_omap4_looks_for(tmp_path: Path, system: Path) -> None:
    """MLO in the root folder of a FAT partition, the active one of an MBR: `rtgen.board.u_boot` says from where."""
    loader = tmp_path / "MLO"
    loader.write_bytes(b"first stage")
    configuration = tmp_path / "configuration"
    configuration.write_text("label linux\n")
    image = tmp_path / "card.img"
    files = {"MLO": loader, "extlinux/extlinux.conf": configuration}
    files |= {f"kernels/{name}": configuration for name in ("rt", "standard")}
    card.write_card(image, "dos", files, system)
    table = json.loads(output("sfdisk", "--json", image))["partitiontable"]
    assert table["label"] == "dos"
    boot, root = table["partitions"]
    assert (boot["type"], boot["bootable"]) == ("c", True)
    assert root["type"] == "83"
    assert "bootable" not in root
    assert output("mtype", "-i", f"{image}@@{card.START_MIB}M", "::/MLO") == "first stage"
    # Before every folder: not each ROM looks further.
    assert output("mdir", "-b", "-i", f"{image}@@{card.START_MIB}M", "::/").splitlines()[0] == "::/MLO"
    for path in ("extlinux/extlinux.conf", "kernels/rt", "kernels/standard"):
        assert output("mtype", "-i", f"{image}@@{card.START_MIB}M", f"::/{path}") == "label linux\n"
    assert flash.check_image(image) == image.stat().st_size
