"""Who can log in to a booted image: BitBake runs the layer's rootfs function on a root file system, QEMU boots it.

`make test-yocto` runs this. The programs are Debian's. The SSH servers' configuration, init scripts and units, on which
the function relies, are those of openembedded-core.
"""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rtfiles import cache
from rtgen import debian
from rtgen.board import build as board
from rtgen.board import disk
from rtgen.board.packages import packages
from rtrun.target import qemu

pytestmark = [pytest.mark.bitbake, pytest.mark.qemu, pytest.mark.timeout(1800)]

# sshd_check_keys needs OpenSSH 9.3.
SUITE = "trixie"
PACKAGES = ["base-files", "busybox-static", "dropbear-bin", "openssh-server", "systemd"]
PASSWORD = "known to the test"
# What openembedded-core's recipes put in the place of names in their files.
FOLDERS = {"@SBINDIR@": "/usr/sbin", "@BASE_BINDIR@": "/bin", "@LIBEXECDIR@": "/usr/libexec"}
# In openembedded-core: where a server's files come from, and its own name for the service.
SOURCES = {"openssh": "recipes-connectivity/openssh/openssh", "dropbear": "recipes-core/dropbear/dropbear"}
SERVICES = {"openssh": "sshd", "dropbear": "dropbear"}
# By the other server: the files that an image with the one does not have.
OTHERS = {
    "openssh": ["usr/sbin/sshd", "usr/lib/openssh", "etc/ssh"],
    "dropbear": ["usr/sbin/dropbear", "usr/bin/dropbearkey"],
}
START = """#!/bin/sh
mkdir -p /dev/pts
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /run
/etc/init.d/network
/etc/init.d/{service} start
"""
NETWORK = """[Service]
Type=oneshot
ExecStart=/etc/init.d/network
"""


def programs() -> Path:
    """A folder with Debian's packages of both servers and systemd, from the cache or downloaded."""
    source = debian.source(SUITE)
    key = cache.digest([*PACKAGES, repr(source), Path(debian.__file__), *packages().dropped])
    return cache.entry(
        "login-root", key, lambda folder: debian.extract(PACKAGES, folder, "armhf", source, packages().dropped)
    )


def install(source: Path, target: Path, mode: int = 0o644) -> None:
    """Copy a file of openembedded-core as its recipe does."""
    text = source.read_text()
    for name, folder in FOLDERS.items():
        text = text.replace(name, folder)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text)
    target.chmod(mode)


def make_root(tree: Path, core: Path, server: str, init: str) -> None:
    """Fill a folder with a root file system as an image has it before its rootfs functions run."""
    shutil.copytree(programs(), tree, symlinks=True, dirs_exist_ok=True)
    shutil.rmtree(tree / "etc/ssh", ignore_errors=True)
    disk.add_places(tree)
    disk.add_tools(tree)
    (tree / "home/root").mkdir(parents=True, mode=0o700)
    hashed = subprocess.run(["openssl", "passwd", "-6", PASSWORD], check=True, capture_output=True, text=True).stdout
    passwd = (
        (tree / "etc/passwd")
        .read_text()
        .replace("root:*:0:0:root:/root:", f"root:{hashed.strip()}:0:0:root:/home/root:")
    )
    (tree / "etc/passwd").write_text(passwd)

    for other, paths in OTHERS.items():
        for path in (tree / name for name in paths if other != server):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    files, service = core / "meta" / SOURCES[server], SERVICES[server]
    if server == "openssh":
        install(files / "sshd_config", tree / "etc/ssh/sshd_config")
        install(files / "sshd_check_keys", tree / "usr/libexec/sshd_check_keys", 0o755)
    else:
        install(files / "dropbear.default", tree / "etc/default/dropbear")
        (tree / "usr/sbin/dropbearkey").symlink_to("../bin/dropbearkey")
        (tree / "etc/dropbear").mkdir()

    if init == "sysvinit":
        install(files / "init", tree / f"etc/init.d/{service}", 0o755)
        install(core / "meta/recipes-core/initscripts/initscripts-1.0/functions", tree / "etc/init.d/functions")
        (tree / "etc/init.d/start").write_text(START.format(service=service))
        (tree / "etc/inittab").write_text("::sysinit:/etc/init.d/start\n")
        return
    (tree / "sbin/init").unlink()
    (tree / "sbin/init").symlink_to("../lib/systemd/systemd")
    units = tree / "etc/systemd/system"
    for unit in [*files.glob(f"{service}*.service"), files / f"{service}.socket"]:
        install(unit, units / unit.name)
    (units / f"{service}.service").unlink(missing_ok=True)
    (units / "network.service").write_text(NETWORK)
    for target, unit in (("sockets", f"{service}.socket"), ("multi-user", "network.service")):
        (units / f"{target}.target.wants").mkdir(exist_ok=True)
        (units / f"{target}.target.wants" / unit).symlink_to(f"../{unit}")
    (tree / "etc/machine-id").write_text("0123456789abcdef0123456789abcdef\n")


def board_with(tree: Path, folder: Path) -> Path:
    """The emulated board with another root file system."""
    original = board.build("qemu-armv7", folder, suite=SUITE)
    copy = folder / "board"
    shutil.copytree(original, copy, ignore=shutil.ignore_patterns(disk.IMAGE))
    disk.make_image(tree, copy / disk.IMAGE)
    record = json.loads((copy / "board.json").read_text())
    # Without udev no terminal appears, which systemd would wait for.
    record["cmdline"] += " systemd.getty_auto=no"
    (copy / "board.json").write_text(json.dumps(record))
    return copy


@pytest.mark.parametrize("init", ["systemd", "sysvinit"])
@pytest.mark.parametrize("server", SOURCES)
def test_key_logs_in_and_password_does_not(yocto, make_build, server, init, tmp_path):
    if not yocto.release.modern:
        pytest.skip("dora's servers have other files")
    key = tmp_path / "login"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    given = key.with_suffix(".pub").read_text().strip()
    build = make_build(yocto.name, "qemuarm", local=f'RT_TESTS_AUTHORIZED_KEYS = "{given}"\n')
    tree = build.folder / "tmp/work/rt-tests-image/1.0/rootfs"
    make_root(tree, yocto.top / "openembedded-core", server, init)
    done = build.try_bitbake(functions=[["rt-tests-image", "rt_tests_ssh_policy"]])
    assert done.returncode == 0, done.stdout + done.stderr
    host_keys = "etc/ssh/ssh_host_*_key" if server == "openssh" else "etc/dropbear/dropbear_*_host_key"
    assert not list(tree.glob(host_keys))

    console = tmp_path / "console"
    with qemu.boot(board_with(tree, tmp_path), console) as machine:
        ssh = client(machine.port, tmp_path)
        by_key = ["-i", str(key), "-o", "IdentitiesOnly=yes", "-o", "BatchMode=yes"]
        wait_for(lambda: ssh(*by_key, "true"), machine, console)
        assert ssh(*by_key, "id -un").stdout == "root\n"
        refused = ssh("-o", "PubkeyAuthentication=no", "-o", "NumberOfPasswordPrompts=1", "true")
        assert refused.returncode == 255
        assert "Permission denied (publickey)." in refused.stderr

        state = f"cat /proc/sys/kernel/random/boot_id; sha256sum /{host_keys}"
        before = ssh(*by_key, f"{state}; sync").stdout.splitlines()
        assert len(before) > 1
        machine.reset()
        wait_for(lambda: ssh(*by_key, "true"), machine, console)
        after = ssh(*by_key, state).stdout.splitlines()
        assert after[0] != before[0]
        assert after[1:] == before[1:]


def client(port: int, folder: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """A function that runs ssh with options and a command; it gives the password, and refuses another host key."""
    answer = folder / "answer"
    answer.write_text(f"#!/bin/sh\necho '{PASSWORD}'\n")
    answer.chmod(0o755)
    environment = {**os.environ, "SSH_ASKPASS": str(answer), "SSH_ASKPASS_REQUIRE": "force"}
    environment.pop("SSH_AUTH_SOCK", None)
    options = ["-F", "none", "-p", str(port), "-o", "ConnectTimeout=60", "-o", f"UserKnownHostsFile={folder}/known"]
    options += ["-o", "StrictHostKeyChecking=accept-new"]

    def ssh(*words: str) -> subprocess.CompletedProcess[str]:
        *more, command = words
        return subprocess.run(
            ["ssh", *options, *more, "root@127.0.0.1", command],
            env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip

    return ssh


def wait_for(login: Callable[[], subprocess.CompletedProcess[str]], machine: qemu.Machine, console: Path) -> None:
    """Log in as soon as the board answers; the test's own time limit ends the waiting."""
    while (done := login()).returncode != 0:
        shown = console.read_text(errors="replace")[-3000:] if console.exists() else ""
        assert machine.failure() is None, shown
        assert "verification failed" not in done.stderr and "Permission denied" not in done.stderr, done.stderr + shown
        time.sleep(1)
