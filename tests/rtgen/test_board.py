"""The emulated board without booting it: what is generated, and the message when it cannot be."""

import lzma
import os
import socket
import stat
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from rtfiles.errors import InfrastructureError, UsageError
from rtgen import cli, debian
from rtgen.board import build, disk, initrd, kernel, machine, packages, sysroot, u_boot
from rtgen.board.boot import KernelBoot


@pytest.fixture
def some_kernel(tmp_path: Path) -> kernel.KernelFiles:
    return kernel.KernelFiles(
        "6.1.0-rt", tmp_path / "vmlinuz", tmp_path / "config", tmp_path, tmp_path, {"linux": "6.1.1-1"}
    )


def test_unknown_machine_is_a_usage_error_that_lists_the_known(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["board", "build", "--machine", "pandaboard"]) == 2
    known = ", ".join(machine.machines())
    expected = f"rtgen: unknown machine 'pandaboard', did you mean 'pandaboard-es'? known: {known}\n"
    assert capsys.readouterr().err == expected


def test_a_board_with_another_device_tree_is_another_board(
    some_kernel: kernel.KernelFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel is the same, byte for byte: a device tree is not in it."""
    monkeypatch.setenv("META_RT_TESTS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(build, "root_file_system", lambda *_: tmp_path)
    monkeypatch.setattr(build, "link_board", lambda *args: None)
    board, folders = machine.find("vexpress-a9"), set()
    for content in ("one", "another"):
        (tmp_path / board.dtb).write_text(content)
        folders.add(build.assemble("vexpress-a9", board, {"rt": some_kernel}, None))
    assert len(folders) == 2


def test_board_record_is_what_formats_md_promises(some_kernel: kernel.KernelFiles) -> None:
    board = machine.find("vexpress-a9")
    entries = build.boot_entries(board, {"rt": some_kernel})
    record = build.board_record("vexpress-a9", board, board.qemu, entries, {}, "ssh-ed25519 AAAA comment\n")
    assert record["qemu"]["arguments"][:4] == ["-M", "vexpress-a9", "-smp", "2"]
    assert record["dtb"] == "vexpress-v2p-ca9.dtb"
    assert record["cmdline"] == "console=ttyAMA0 nr_cpus=2 root=/dev/vda quiet"
    assert record["ssh"]["host_key"] == "ssh-ed25519 AAAA"
    assert record["kernel_release"] == "6.1.0-rt"
    assert "kernels" not in record


def test_a_board_with_two_kernels_has_files_of_each_and_starts_the_first(some_kernel: kernel.KernelFiles) -> None:
    board = machine.find("vexpress-a9")
    entries = build.boot_entries(board, {"rt": some_kernel, "standard": replace(some_kernel, release="6.1.0")})
    record = build.board_record("vexpress-a9", board, board.qemu, entries, {}, "ssh-ed25519 AAAA comment\n")
    assert (record["kernel"], record["kernel_release"]) == ("vmlinuz", "6.1.0-rt")
    assert record["kernels"]["rt"] == {key: record[key] for key in ("kernel", "initrd", "dtb", "kernel_release")}
    assert record["kernels"]["standard"] == {
        "kernel": "vmlinuz-standard",
        "initrd": "initrd-standard",
        "dtb": "vexpress-v2p-ca9-standard.dtb",
        "kernel_release": "6.1.0",
    }


def test_two_kernels_of_a_machine_that_has_one_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pandaboard = machine.find("pandaboard-es").model_copy(update={"standard_kernel": None})
    monkeypatch.setattr(build, "find", lambda name: pandaboard)
    assert cli.main(["board", "build", "--machine", "pandaboard-es", "--kernel", "both"]) == 2
    assert capsys.readouterr().err == (
        "rtgen: pandaboard-es: no standard_kernel in the file of this machine: --kernel both is for others\n"
    )


@pytest.mark.parametrize(
    ("listing", "mirror"),
    [
        ("Debian|http://mirror/debian/|bookworm|main", "http://mirror/debian/"),
        ("$(ORIGIN)|http://mirror/debian|bookworm|main", "http://mirror/debian"),
        ("Debian|http://mirror/debian/|bookworm-updates|main", None),
        ("Docker|http://docker/linux/debian|bookworm|main", None),
        ("$(ORIGIN)|http://vendor/apt|bookworm|main", None),
        ("", None),
    ],
)
def test_only_the_main_suite_of_debian_itself_is_a_source(listing: str, mirror: str | None) -> None:
    assert debian.mirror(listing, "bookworm") == mirror


def test_another_release_comes_from_the_same_mirror() -> None:
    own, other = debian.source(), debian.source("trixie")
    assert (other.release, other.mirror) == ("trixie", own.mirror)


def test_unknown_suite_of_debian(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("board", "suites"):
        assert cli.main([command, "build", "--machine", "qemu-armv7", "--suite", "hamm"]) == 2
        assert capsys.readouterr().err == "rtgen: --suite: unknown suite of Debian 'hamm', known: bookworm, trixie\n"


def test_suite_that_the_mirror_does_not_serve_is_one_clear_line(tmp_path: Path) -> None:
    """The real apt finds an empty mirror."""
    (tmp_path / "mirror").mkdir()
    folder = tmp_path / "tree"
    folder.mkdir()
    source = debian.PackageSource(release="trixie", mirror=f"file://{tmp_path}/mirror")
    with pytest.raises(InfrastructureError) as raised:
        debian.extract(["base-files"], folder, "armhf", source)
    assert str(raised.value) == f"Debian's suite trixie is not served by {source.mirror}"
    assert list(folder.iterdir()) == []


def test_mirror_that_does_not_answer_is_one_clear_line(tmp_path: Path) -> None:
    """The real apt asks a port of this machine at which nobody listens."""
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        mirror = f"http://127.0.0.1:{closed.getsockname()[1]}/debian"
        with pytest.raises(InfrastructureError) as raised:
            debian.extract(["base-files"], tmp_path, "armhf", debian.PackageSource(release="bookworm", mirror=mirror))
    assert str(raised.value).startswith(f"cannot download {mirror}/dists/bookworm/InRelease: Could not connect to ")
    assert "\n" not in str(raised.value)


def test_root_file_systems_differ_by_release() -> None:
    board = machine.find("qemu-armv7")
    old, new = (set(disk.package_names(board, release)) for release in ("bookworm", "trixie"))
    assert old - new == {"libddsc0debian", "libfastrtps2.9", "libroscpp4d"}
    assert new - old == {"libddsc0t64", "libfastdds3.1", "libroscpp4t64"}


def test_packages_below_usr_alone_are_found_by_their_old_paths(tmp_path: Path) -> None:
    (tmp_path / "usr/lib/modules").mkdir(parents=True)
    (tmp_path / "usr/sbin").mkdir()
    (tmp_path / "sbin").mkdir()
    debian.merge_usr(tmp_path)
    assert (tmp_path / "lib/modules").is_dir()
    assert not (tmp_path / "sbin").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lib", "sbin", "usr"]


def test_versions_come_from_archive_names() -> None:
    names = ["openssh-server_1%3a9.2p1-2_armhf.deb", "libroscpp4d_1.15.15+ds-2_armhf.deb", "partial"]
    assert debian.versions(names) == {"openssh-server": "1:9.2p1-2", "libroscpp4d": "1.15.15+ds-2"}


def test_absolute_links_stay_inside(tmp_path: Path) -> None:
    (tmp_path / "usr/lib").mkdir(parents=True)
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/libm.so.6").write_text("here")
    (tmp_path / "usr/lib/libm.so").symlink_to("/lib/libm.so.6")
    (tmp_path / "usr/dangling").symlink_to("/nowhere/at/all")
    debian.relink(tmp_path)
    assert (tmp_path / "usr/lib/libm.so").readlink() == Path("../../lib/libm.so.6")
    assert (tmp_path / "usr/lib/libm.so").read_text() == "here"
    assert (tmp_path / "usr/dangling").readlink() == Path("../nowhere/at/all")


def test_modules_come_after_what_they_need_and_once() -> None:
    dep = (
        "kernel/fs/ext4/ext4.ko: kernel/lib/crc16.ko kernel/fs/mbcache.ko kernel/fs/jbd2/jbd2.ko\n"
        "kernel/drivers/virtio-rng.ko:\nkernel/fs/jbd2/jbd2.ko:\nkernel/fs/mbcache.ko:\nkernel/lib/crc16.ko:\n"
    )
    assert kernel.module_files(dep, ["virtio_rng", "mbcache", "ext4", "built_in"]) == [
        "kernel/drivers/virtio-rng.ko",
        "kernel/fs/mbcache.ko",
        "kernel/fs/jbd2/jbd2.ko",
        "kernel/lib/crc16.ko",
        "kernel/fs/ext4/ext4.ko",
    ]


def test_device_tree_that_the_kernel_lacks(some_kernel: kernel.KernelFiles) -> None:
    with pytest.raises(InfrastructureError, match=r"^the kernel 6\.1\.0-rt has no device tree other\.dtb$"):
        some_kernel.device_tree("other.dtb")
    (some_kernel.dtbs / "other.dtb").touch()
    assert some_kernel.device_tree("other.dtb").name == "other.dtb"
    (some_kernel.dtbs / "other-rt.dtb").touch()
    assert some_kernel.device_tree("other.dtb").name == "other-rt.dtb"


def test_firmware_that_its_package_lacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "unpacked", lambda *_: tmp_path)
    source = debian.PackageSource(release="trixie", mirror=None)
    with pytest.raises(InfrastructureError, match=r"^u-boot-omap of Debian trixie \(armhf\) has no file usr/MLO$"):
        packages.file_of("u-boot-omap", "usr/MLO", "armhf", source)
    (tmp_path / "usr").mkdir()
    (tmp_path / "usr/MLO").touch()
    assert packages.file_of("u-boot-omap", "usr/MLO", "armhf", source) == tmp_path / "usr/MLO"


def test_u_boot_comes_from_the_suite_that_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def unpacked(names: list[str], architecture: str, source: debian.PackageSource) -> Path:
        asked.append((*names, architecture, source))
        return tmp_path

    monkeypatch.setattr(packages, "unpacked", unpacked)
    panda = machine.find("pandaboard-es")
    assert panda.u_boot is not None
    for name in panda.u_boot.files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    boot = KernelBoot(kernel=tmp_path, ram_disk=tmp_path, command_line="quiet", device_tree=tmp_path)
    source = debian.PackageSource(release="trixie", mirror="http://mirror/debian")
    files = u_boot.boot_files(panda.architecture, panda.u_boot, source, {"rt": boot}, tmp_path)
    assert files.others["MLO"] == tmp_path / "usr/lib/u-boot/omap4_panda/MLO"
    assert set(asked) == {("u-boot-omap", "armhf", debian.PackageSource(release="bookworm", mirror=source.mirror))}


def test_ram_disk_gets_modules_unpacked(some_kernel: kernel.KernelFiles) -> None:
    (some_kernel.modules / "modules.dep").write_text("plain.ko:\npacked.ko.xz: plain.ko\n")
    (some_kernel.modules / "plain.ko").write_bytes(b"as it is")
    (some_kernel.modules / "packed.ko.xz").write_bytes(lzma.compress(b"was packed"))
    assert some_kernel.loadable(["packed"]) == {"plain.ko": b"as it is", "packed.ko": b"was packed"}


@pytest.mark.root
def test_ram_disk_is_read_by_cpio(tmp_path: Path) -> None:
    packed = initrd.archive(b"busybox!", {"b.ko": b"second", "a.ko": b"first?"})
    subprocess.run(["cpio", "-id", "--quiet", "--no-absolute-filenames"], input=packed, cwd=tmp_path, check=True)
    assert (tmp_path / "bin/busybox").read_bytes() == b"busybox!"
    assert os.access(tmp_path / "init", os.X_OK)
    assert (tmp_path / "lib/modules.list").read_text() == "b.ko\na.ko\n"
    assert (tmp_path / "lib/a.ko").read_bytes() == b"first?"
    listing = subprocess.run(["cpio", "-tv", "--quiet"], input=packed, capture_output=True, check=True).stdout.decode()
    assert [line[0] for line in listing.splitlines() if line.endswith(" dev/console")] == ["c"]


def test_ram_disk_sorts_types_by_mode() -> None:
    kinds = {entry.name: stat.S_IFMT(entry.mode) for entry in initrd.entries(b"", {})}
    assert kinds["dev"] == stat.S_IFDIR
    assert kinds["dev/console"] == stat.S_IFCHR
    assert kinds["init"] == stat.S_IFREG


def test_init_script_is_a_valid_script() -> None:
    for script in [initrd.INIT, *Path(build.HERE, "root/etc/init.d").iterdir(), build.HERE / "root/etc/udhcpc.script"]:
        assert os.access(script, os.X_OK), script
        subprocess.run(["sh", "-n", str(script)], check=True)


def test_user_without_namespaces_is_told_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = tmp_path / "unshare"
    refusing.write_text("#!/bin/sh\necho 'unshare failed: Operation not permitted' >&2\nexit 1\n")
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(UsageError, match="run as root, or sysctl"):
        debian.extraction_mode()


@pytest.mark.root
def test_package_that_does_not_exist_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real mmdebstrap fails; the error is one line, its files are gone."""
    temporary = tmp_path / "tmp"
    temporary.mkdir(mode=0o1777)
    monkeypatch.setenv("TMPDIR", str(temporary))
    folder = tmp_path / "tree"
    folder.mkdir()
    source = debian.source()
    with pytest.raises(InfrastructureError) as raised:
        debian.extract(["no-such-package"], folder, "armhf", source)
    expected = f"Debian's suite {source.release} at {source.mirror} has no package no-such-package for armhf"
    assert str(raised.value) == expected
    assert list(folder.iterdir()) == []
    assert list(temporary.iterdir()) == []


def test_libraries_are_looked_for_in_the_sysroot(tmp_path: Path) -> None:
    """The real CMake, with the words of catkin's package files, where this machine and the sysroot have the library."""
    folder = tmp_path / "sysroot/usr/lib/cmake/some"
    folder.mkdir(parents=True)
    (tmp_path / "host").mkdir()
    (tmp_path / "host/libsome.so").touch()
    (tmp_path / f"sysroot{tmp_path}/host").mkdir(parents=True)
    (tmp_path / f"sysroot{tmp_path}/host/libsome.so").touch()
    words = f"find_library(lib some\n        PATHS {tmp_path}/host\n        NO_DEFAULT_PATH NO_CMAKE_FIND_ROOT_PATH)\n"
    config = folder / "someConfig.cmake"
    settings = (
        f"set(CMAKE_FIND_ROOT_PATH {tmp_path}/sysroot)\nset(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)\n"
        "set(CMAKE_FIND_LIBRARY_PREFIXES lib)\nset(CMAKE_FIND_LIBRARY_SUFFIXES .so)\n"
    )

    def library() -> str:
        script = tmp_path / "look.cmake"
        script.write_text(f'{settings}include({config})\nmessage("library: ${{lib}}")\n')
        done = subprocess.run(["cmake", "-P", script], capture_output=True, text=True, check=True, cwd=tmp_path)
        return done.stderr.split("library: ")[1].strip()

    config.write_text(words)
    assert library() == f"{tmp_path}/host/libsome.so"
    sysroot.search_inside(tmp_path / "sysroot")
    assert library() == f"{tmp_path}/sysroot{tmp_path}/host/libsome.so"


def test_what_a_package_has_is_that_of_the_sysroot(tmp_path: Path) -> None:
    """The real CMake, with the words of a package that was configured with absolute paths, and of another."""
    targets = tmp_path / "usr/lib/some-targets.cmake"
    targets.parent.mkdir(parents=True)
    targets.write_text(
        'set(_IMPORT_PREFIX "/usr")\n'
        'set(files "${_IMPORT_PREFIX}/include;/usr/lib/libsome.so" "${_IMPORT_PREFIX}/usr")\n'
        'message("files: ${files}")\n'
    )
    sysroot.search_inside(tmp_path)
    command = ["cmake", f"-DCMAKE_SYSROOT={tmp_path}", "-P", targets]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    usr = f"{tmp_path}/usr"
    assert done.stderr.strip() == f"files: {usr}/include;{usr}/lib/libsome.so;{usr}/usr"
