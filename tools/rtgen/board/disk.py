"""The root file system of a board: Debian packages, files that their scripts would make, keys."""

import os
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path

from rtfiles.errors import InfrastructureError
from rtgen import debian
from rtgen.board.kernel import KernelFiles
from rtgen.board.machine import Machine
from rtgen.board.packages import packages, unpacked
from rtgen.process import run

# Our own files, with their paths on the board.
OVERLAY = Path(__file__).with_name("root")
# Tools that busybox provides if no package does.
APPLETS = Path(__file__).with_name("applets.txt")
# Free space for suites and results.
FREE_BYTES = 384 * 2**20
# Files without which the board cannot work, checked while building.
REQUIRED = ("bin/busybox", "bin/sh", "sbin/init", "usr/sbin/sshd", "usr/lib/openssh/sftp-server", "usr/bin/rosmaster")
IMAGE, KEY, HOST_KEY, LIST, BUSYBOX = "root.img", "id_ed25519", "host_key.pub", "packages.list", "busybox"


def package_names(machine: Machine, release: str) -> list[str]:
    """The packages of a machine's root file system in a Debian release, without their dependencies."""
    known = packages()
    card = known.card if machine.medium is not None else {}
    return sorted([*known.root, *known.releases[release].root, *card])


def build(machine: Machine, kernels: Iterable[KernelFiles], source: debian.PackageSource, folder: Path) -> None:
    """Make root.img, its login key id_ed25519, and the public part of its host key in an empty folder."""
    tree = folder / "tree"
    tree.mkdir()
    names = package_names(machine, source.release)
    downloaded = unpacked(names, machine.architecture, source, packages().dropped)
    run(["cp", "--archive", "--reflink=auto", f"{downloaded}/.", tree])
    add_places(tree)
    add_tools(tree)
    for kernel in kernels:
        add_modules(tree, kernel, list(machine.modules))
    add_keys(tree, folder)
    add_bytecode(tree, source)
    missing = [name for name in REQUIRED if not os.path.lexists(tree / name)]
    if missing:
        raise InfrastructureError(f"the packages lack files that the board needs: {', '.join(missing)}")
    shutil.move(tree / debian.LIST, folder / LIST)
    shutil.copy(tree / "bin/busybox", folder / BUSYBOX)
    make_image(tree, folder / IMAGE)
    shutil.rmtree(tree)


def add_places(tree: Path) -> None:
    """Add our own files, and folders that the kernel, the start script or the runner expect."""
    for name in ("dev", "proc", "sys", "run", "tmp", "root/.ssh", "var/lib/rt-tests", "var/log", "var/tmp", "opt"):
        (tree / name).mkdir(parents=True, exist_ok=True)
    for name in ("tmp", "var/tmp"):
        (tree / name).chmod(0o1777)
    for name in ("root", "root/.ssh"):
        (tree / name).chmod(0o700)
    (tree / "var/run").symlink_to("../run")
    shutil.copytree(OVERLAY, tree, dirs_exist_ok=True)


def add_tools(tree: Path) -> None:
    """Link busybox under the names of its tools, except where a package has the tool."""
    search = ("bin", "sbin", "usr/bin", "usr/sbin")
    for name in APPLETS.read_text(encoding="utf-8").split():
        if not any(os.path.lexists(tree / folder / name) for folder in search):
            (tree / "bin" / name).symlink_to("busybox")
    (tree / "sbin/init").symlink_to("../bin/busybox")


def add_modules(tree: Path, kernel: KernelFiles, modules: list[str]) -> None:
    """Add the kernel's configuration, the named modules and their dependencies."""
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
    """Make the login key and the host key."""
    host_key = tree / "etc/ssh/ssh_host_ed25519_key"
    for file, comment in ((folder / KEY, "rehearsal-board"), (host_key, "rehearsal-board-host")):
        run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", comment, "-f", str(file)])
    shutil.copy(folder / f"{KEY}.pub", tree / "root/.ssh/authorized_keys")
    shutil.copy(host_key.with_suffix(".pub"), folder / HOST_KEY)


def add_bytecode(tree: Path, source: debian.PackageSource) -> None:
    """Compile the board's Python modules with its Python version; the emulated CPU would take a minute.

    If this Python has another version, that of the release for this machine's architecture is unpacked and run in
    place.
    """
    (library,) = (tree / "usr/lib").glob("python3.*")
    # Unchecked: nothing on the board changes the modules, but the time stamps of their files may change.
    command = ["-m", "compileall", "-qq", "--invalidation-mode", "unchecked-hash", "-s", str(tree), "-p", "/"]
    command += [str(library), str(tree / "usr/lib/python3/dist-packages")]
    if library.name == f"python{sys.version_info.major}.{sys.version_info.minor}":
        run([sys.executable, *command, "-j", "2"])
        return
    python = unpacked([f"{library.name}-minimal"], run(["dpkg", "--print-architecture"]).strip(), source)
    loader = next(python.glob("usr/lib*/ld-linux*.so.*"))
    libraries = ":".join(str(path) for path in python.glob("usr/lib/*-linux-*"))
    program: list[str | Path] = [loader, "--library-path", libraries, python / f"usr/bin/{library.name}"]
    run([*program, *command], environment={**os.environ, "PYTHONHOME": str(python / "usr")})


def make_image(tree: Path, image: Path) -> None:
    """Make an ext4 file system of a folder; every file in it belongs to root."""
    used = sum(path.lstat().st_size + 4096 for path in tree.rglob("*"))
    with image.open("wb") as stream:
        stream.truncate((used + FREE_BYTES) // 2**20 * 2**20)
    command = ["mke2fs", "-q", "-F", "-t", "ext4", "-L", "rehearsal", "-m", "0", "-d", str(tree), str(image)]
    # In a user namespace the user's files belong to root, and so they do in the image.
    run(command if os.geteuid() == 0 else ["unshare", "--user", "--map-root-user", *command])
