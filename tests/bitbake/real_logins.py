"""Who can log in to a booted image: BitBake runs the image's rootfs functions on a root file system, QEMU boots it.

`make test-yocto` runs this. The functions are all of ROOTFS_POSTPROCESS_COMMAND and IMAGE_PREPROCESS_COMMAND, those of
openembedded-core and of our layer. The programs are Debian's; the configuration, init scripts and units of the SSH
servers are openembedded-core's.
"""

import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from bitbake.yocto import Yocto
from rtgen import debian
from rtgen.board import build as board
from rtgen.board import disk, initrd
from rtgen.board.kernel import debian_kernel
from rtgen.board.machine import find
from rtgen.board.packages import packages, unpacked
from rtrun.targets.qemu import emulator as qemu

pytestmark = [pytest.mark.bitbake, pytest.mark.qemu, pytest.mark.timeout(900)]

# sshd_check_keys needs OpenSSH 9.3.
SUITE = "trixie"
PACKAGES = ["base-files", "busybox-static", "dropbear-bin", "openssh-server", "systemd"]
PASSWORD = "known to the test"
# What openembedded-core's recipes put in the place of names in their files.
FOLDERS = {"@SBINDIR@": "/usr/sbin", "@BASE_BINDIR@": "/bin", "@LIBEXECDIR@": "/usr/libexec"}
# In openembedded-core: where a server's files come from, and its own name for the service.
SOURCES = {"openssh": "recipes-connectivity/openssh/openssh", "dropbear": "recipes-core/dropbear/dropbear"}
SERVICES = {"openssh": "sshd", "dropbear": "dropbear"}
ROOT_HOME = re.compile(r'^ROOT_HOME \?+= "(.+)"$', re.MULTILINE)
# By the other server: the files that an image with the one does not have.
OTHERS = {
    "openssh": ["usr/sbin/sshd", "usr/lib/openssh", "etc/ssh"],
    "dropbear": ["usr/sbin/dropbear", "usr/bin/dropbearkey"],
}
# Runs what do_rootfs and do_image run when all packages are installed. There were none: kirkstone asks opkg for them.
# systemctl enables units by their presets, for wrynose in the first list and for older releases in the second.
# A build would make both programs.
ROOTFS_FUNCTIONS = """
HOSTTOOLS += "systemctl"
PATH:prepend = "${TOPDIR}/programs:"
python do_rootfs_functions() {
    import oe.utils
    for name in ("ROOTFS_POSTPROCESS_COMMAND", "IMAGE_PREPROCESS_COMMAND"):
        oe.utils.execute_pre_post_process(d, d.getVar(name))
}
do_rootfs_functions[nostamp] = "1"
do_rootfs_functions[cleandirs] = "${IMGDEPLOYDIR}"
addtask rootfs_functions
"""
# A read-only root whose /etc is kept on a second partition.
OVERLAY_ETC = """
EXTRA_IMAGE_FEATURES += "overlayfs-etc"
OVERLAYFS_ETC_MOUNT_POINT = "/data"
OVERLAYFS_ETC_DEVICE = "/dev/vda2"
OVERLAYFS_ETC_FSTYPE = "ext4"
"""
READ_ONLY = 'EXTRA_IMAGE_FEATURES += "read-only-rootfs"'
MIB = 2**20
# Like sysfs.sh of openembedded-core: since wrynose overlayfs-etc leaves neither of the first two mounted.
START = """#!/bin/sh
[ -d /proc/1 ] || mount -t proc proc /proc
[ -d /sys/class ] || mount -t sysfs sysfs /sys
mkdir -p /dev/pts
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /run
/etc/init.d/network
/etc/init.d/{service} start
"""
NETWORK = """[Service]
Type=oneshot
ExecStart=/etc/init.d/network
[Install]
WantedBy=multi-user.target
"""


def programs() -> Path:
    """A folder with Debian's packages of both servers and systemd, from the cache or downloaded."""
    return unpacked(PACKAGES, "armhf", debian.source(SUITE), packages().dropped)


def install(source: Path, target: Path, mode: int = 0o644) -> None:
    """Copy a file of openembedded-core as its recipe does."""
    text = source.read_text()
    for name, folder in FOLDERS.items():
        text = text.replace(name, folder)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text)
    target.chmod(mode)


def root_home(core: Path, init: str) -> str:
    """ROOT_HOME for an INIT_MANAGER, which base-passwd writes into /etc/passwd; it differs from release to release."""
    files = (core / f"meta/conf/distro/include/init-manager-{init}.inc", core / "meta/conf/bitbake.conf")
    return next(match[1] for file in files if (match := ROOT_HOME.search(file.read_text())))


def make_root(tree: Path, core: Path, server: str, init: str) -> None:
    """Fill a folder with a root file system as an image has it before its rootfs functions run."""
    shutil.copytree(programs(), tree, symlinks=True, dirs_exist_ok=True)
    shutil.rmtree(tree / "etc/ssh", ignore_errors=True)
    # Debian's settings of the server, and its users, which openembedded-core would compare with its own.
    (tree / "etc/default/ssh").unlink(missing_ok=True)
    shutil.rmtree(tree / "usr/lib/sysusers.d")
    disk.add_places(tree)
    disk.add_tools(tree)
    home = root_home(core, init)
    (tree / home[1:]).mkdir(parents=True, mode=0o700, exist_ok=True)
    hashed = subprocess.run(["openssl", "passwd", "-6", PASSWORD], check=True, capture_output=True, text=True).stdout
    passwd = (
        (tree / "etc/passwd").read_text().replace("root:*:0:0:root:/root:", f"root:{hashed.strip()}:0:0:root:{home}:")
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
        # busybox goes by its name, which overlayfs-etc changes to init.orig.
        (tree / "sbin/init").unlink()
        (tree / "sbin/init").write_text("#!/bin/sh\nexec /bin/busybox init\n")
        (tree / "sbin/init").chmod(0o755)
        return
    (tree / "sbin/init").unlink()
    (tree / "sbin/init").symlink_to("../lib/systemd/systemd")
    units = tree / "etc/systemd/system"
    for unit in [*files.glob(f"{service}*.service"), files / f"{service}.socket"]:
        install(unit, units / unit.name)
    (units / f"{service}.service").unlink(missing_ok=True)
    (units / "network.service").write_text(NETWORK)
    # As the packages of the server and of systemd bring them, in the place of those of Debian.
    presets = tree / "usr/lib/systemd/system-preset"
    shutil.rmtree(presets)
    presets.mkdir()
    (presets / "98-test.preset").write_text(f"enable {service}.socket\nenable network.service\n")
    install(core / "meta/recipes-core/systemd/systemd/99-default.preset", presets / "99-default.preset")
    (tree / "etc/machine-id").write_text("0123456789abcdef0123456789abcdef\n")


def run_rootfs_functions(yocto: Yocto, tree: Path, *settings: str) -> None:
    """Let BitBake run the image's rootfs functions on the root file system in `tree`, with more lines of local.conf."""
    build = yocto.work / "build-logins"
    (build / "classes").mkdir(parents=True, exist_ok=True)
    (build / "classes/rootfs-functions.bbclass").write_text(ROOTFS_FUNCTIONS)
    (build / "programs").mkdir(exist_ok=True)
    (build / "programs/opkg").write_text("#!/bin/sh\n")
    (build / "programs/opkg").chmod(0o755)
    ours = ('INHERIT += "rootfs-functions"', f'IMAGE_ROOTFS:forcevariable = "{tree}"')
    yocto.configure(build, "qemuarm", *ours, *settings)
    (recipe,) = yocto.layer.glob(f"recipes-core/*/{yocto.profile.image.name}.bb")
    yocto.run("bitbake", "-b", str(recipe), "-c", "rootfs_functions", build=build)


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


def make_read_only(copy: Path, tree: Path) -> None:
    """Give a board's root file system a partition, which no mount can make writable, and add one for the data."""
    root, data, whole = copy / "root.ext4", copy / "data.ext4", copy / disk.IMAGE
    whole.rename(root)
    subprocess.run(["tune2fs", "-O", "read-only", root], check=True, capture_output=True)
    subprocess.run(["mke2fs", "-q", "-t", "ext4", data, "16M"], check=True, capture_output=True)
    table, at = "", MIB
    with whole.open("wb") as stream:
        for part in (root, data):
            table += f"start={at // MIB}MiB, size={part.stat().st_size // MIB}MiB\n"
            stream.seek(at)
            with part.open("rb") as source:
                shutil.copyfileobj(source, stream, MIB)
            at = stream.tell()
    subprocess.run(["sfdisk", "--label=dos", whole], input=table, text=True, check=True, capture_output=True)
    machine = find("qemu-armv7")
    modules = debian_kernel(machine.kernel, machine, debian.source(SUITE)).loadable([*machine.modules, "overlay"])
    (copy / "initrd").write_bytes(initrd.archive((tree / "bin/busybox").read_bytes(), modules))
    record = (copy / "board.json").read_text()
    (copy / "board.json").write_text(record.replace("root=/dev/vda ", "root=/dev/vda1 "))


@pytest.mark.parametrize(
    ("server", "init", "read_only"),
    [
        ("openssh", "systemd", False),
        ("openssh", "sysvinit", False),
        ("dropbear", "systemd", False),
        ("dropbear", "sysvinit", False),
        ("openssh", "systemd", True),
        ("dropbear", "sysvinit", True),
    ],
)
def test_key_logs_in_and_password_does_not(yocto, server, init, read_only, tmp_path):
    if not yocto.release.modern:
        pytest.skip("dora's servers have other files")
    key = tmp_path / "login"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    given = key.with_suffix(".pub").read_text().strip()
    tree = tmp_path / "tree"
    make_root(tree, yocto.top / "openembedded-core", server, init)
    settings = [f'RT_TESTS_AUTHORIZED_KEYS = "{given}"', f'RT_TESTS_SSH_SERVER = "{server}"']
    if read_only:
        (tree / "data").mkdir()
        settings += [READ_ONLY, OVERLAY_ETC]
    run_rootfs_functions(yocto, tree, f'INIT_MANAGER = "{init}"', *settings)
    host_keys = "etc/ssh/ssh_host_*_key" if server == "openssh" else "etc/dropbear/dropbear_*_host_key"
    assert not list(tree.glob(host_keys))

    copy = board_with(tree, tmp_path)
    if read_only:
        make_read_only(copy, tree)
    console = tmp_path / "console"
    with qemu.boot(copy, console) as machine:
        ssh = client(machine.port, tmp_path)
        by_key = ["-i", str(key), "-o", "IdentitiesOnly=yes", "-o", "BatchMode=yes"]
        wait_for(lambda: ssh(*by_key, "true"), machine, console)
        assert ssh(*by_key, "id -un").stdout == "root\n"
        assert ("Read-only file system" in ssh(*by_key, "touch /usr/any").stderr) == read_only
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


def test_an_image_that_would_change_its_host_keys_is_not_built(yocto, tmp_path):
    if not yocto.release.modern:
        pytest.skip("the servers of dora have other files")
    make_root(tmp_path / "tree", yocto.top / "openembedded-core", "openssh", "systemd")
    with pytest.raises(AssertionError, match=re.escape("new SSH host keys at every boot: take it out, or add overlay")):
        run_rootfs_functions(yocto, tmp_path / "tree", 'INIT_MANAGER = "systemd"', READ_ONLY)


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


def wait_for(login: Callable[[], subprocess.CompletedProcess[str]], machine: qemu.BootedBoard, console: Path) -> None:
    """Log in as soon as the board answers; the test's own time limit ends the waiting."""
    while (done := login()).returncode != 0:
        shown = console.read_text(errors="replace")[-3000:] if console.exists() else ""
        assert machine.failure() is None and "Kernel panic" not in shown, shown
        assert "verification failed" not in done.stderr and "Permission denied" not in done.stderr, done.stderr + shown
        time.sleep(1)
