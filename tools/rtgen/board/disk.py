"""The root file system of the emulated board: Debian's packages, the files their scripts would have made, keys."""

import compileall
import os
import py_compile
import shutil
import sys
from pathlib import Path

from rtfiles.errors import InfrastructureError
from rtgen import debian
from rtgen.board.kernel import Kernel
from rtgen.board.packages import packages
from rtgen.process import run

# Our own files: /etc, in the form they have on the board.
OVERLAY = Path(__file__).with_name("root")
# Tools that busybox stands in for, where no package brings one.
APPLETS = Path(__file__).with_name("applets.txt")
# Room for suites and results on top of what is installed.
FREE_BYTES = 384 * 2**20
# What a test image must have, so that a missing one is found while building, not at three in the morning.
REQUIRED = ("bin/busybox", "bin/sh", "sbin/init", "usr/sbin/sshd", "usr/lib/openssh/sftp-server", "usr/bin/rosmaster")
IMAGE, KEY, HOST_KEY, LIST, BUSYBOX = "root.img", "id_ed25519", "host_key.pub", "packages.list", "busybox"


def build(kernel: Kernel, modules: list[str], folder: Path) -> None:
    """Make root.img, the key id_ed25519 that opens it, and its host key's public half in an empty folder."""
    tree = folder / "tree"
    tree.mkdir()
    extracted = packages()
    debian.extract(sorted(extracted.root), tree, extracted.dropped)
    add_places(tree)
    add_tools(tree)
    add_modules(tree, kernel, modules)
    add_keys(tree, folder)
    add_bytecode(tree)
    missing = [name for name in REQUIRED if not os.path.lexists(tree / name)]
    if missing:
        raise InfrastructureError(f"the packages lack what the board needs: {', '.join(missing)}")
    shutil.move(tree / debian.LIST, folder / LIST)
    shutil.copy(tree / "bin/busybox", folder / BUSYBOX)
    make_image(tree, folder / IMAGE)
    shutil.rmtree(tree)


def add_places(tree: Path) -> None:
    """Add folders that the kernel, our start script or the runner expect, and our own files."""
    for name in ("dev", "proc", "sys", "run", "tmp", "root/.ssh", "var/lib/rt-tests", "var/log", "var/tmp", "opt"):
        (tree / name).mkdir(parents=True, exist_ok=True)
    for name in ("tmp", "var/tmp"):
        (tree / name).chmod(0o1777)
    for name in ("root", "root/.ssh"):
        (tree / name).chmod(0o700)
    (tree / "var/run").symlink_to("../run")
    shutil.copytree(OVERLAY, tree, dirs_exist_ok=True)


def add_tools(tree: Path) -> None:
    """Link busybox's tools, but for those that a package has brought."""
    search = ("bin", "sbin", "usr/bin", "usr/sbin")
    for name in APPLETS.read_text(encoding="utf-8").split():
        if not any(os.path.lexists(tree / folder / name) for folder in search):
            (tree / "bin" / name).symlink_to("busybox")
    (tree / "sbin/init").symlink_to("../bin/busybox")


def add_modules(tree: Path, kernel: Kernel, modules: list[str]) -> None:
    """Add the kernel's configuration, the named modules and what these need."""
    (tree / "boot").mkdir(exist_ok=True)
    shutil.copy(kernel.config, tree / f"boot/config-{kernel.release}")
    target = tree / "lib/modules" / kernel.release
    for file in kernel.files_of(modules):
        (target / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(kernel.modules / file, target / file)
    target.mkdir(parents=True, exist_ok=True)
    for name in ("modules.builtin", "modules.builtin.modinfo", "modules.order"):
        shutil.copy(kernel.modules / name, target / name)
    run(["depmod", "--basedir", str(tree), kernel.release])


def add_keys(tree: Path, folder: Path) -> None:
    """Make the key that opens the board, and the one by which the board is known."""
    host_key = tree / "etc/ssh/ssh_host_ed25519_key"
    for file, comment in ((folder / KEY, "rehearsal-board"), (host_key, "rehearsal-board-host")):
        run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", str(file)])
    shutil.copy(folder / f"{KEY}.pub", tree / "root/.ssh/authorized_keys")
    shutil.copy(host_key.with_suffix(".pub"), folder / HOST_KEY)


def add_bytecode(tree: Path) -> None:
    """Compile the Python modules, or the emulated CPU does it at every first start. Only the same Python can."""
    library = tree / f"usr/lib/python{sys.version_info.major}.{sys.version_info.minor}"
    if library.is_dir():
        for place in (library, tree / "usr/lib/python3/dist-packages"):
            # By content, not by time: nothing on the board can make it stale, and the times of files may change.
            mode = py_compile.PycInvalidationMode.UNCHECKED_HASH
            compileall.compile_dir(place, quiet=2, workers=2, stripdir=tree, prependdir="/", invalidation_mode=mode)


def make_image(tree: Path, image: Path) -> None:
    """Make an ext4 file system of a folder; every file in it belongs to root."""
    used = sum(path.lstat().st_size + 4096 for path in tree.rglob("*"))
    with image.open("wb") as stream:
        stream.truncate((used + FREE_BYTES) // 2**20 * 2**20)
    command = ["mke2fs", "-q", "-F", "-t", "ext4", "-L", "rehearsal", "-m", "0", "-d", str(tree), str(image)]
    # A user's files are root's inside a user namespace, and so in the image.
    run(command if os.geteuid() == 0 else ["unshare", "--user", "--map-root-user", *command])
