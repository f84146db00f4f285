"""Debian packages of another architecture, unpacked into a folder: nothing is installed, run or emulated."""

import os
import platform
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated
from urllib.parse import unquote

from pydantic import StringConstraints

from rtfiles.config import Config, load
from rtfiles.errors import InfrastructureError, UsageError
from rtgen.board.process import run

ARCHITECTURE = "armhf"

# What neither a board nor a compiler reads; a third of all bytes.
DROPPED = ("usr/share/doc", "usr/share/man", "usr/share/locale", "usr/share/info", "usr/share/lintian", "dev")

# Where mmdebstrap is made to write down what it unpacked.
LIST = "packages.list"

Reason = Annotated[str, StringConstraints(min_length=1)]


class Packages(Config):
    """packages.yml: name of each Debian package, or pattern of files left out, and the reason."""

    root: dict[str, Reason]
    kernel: dict[str, Reason]
    sysroot: dict[str, Reason]
    dropped: dict[str, Reason]


def packages() -> Packages:
    """Read packages.yml."""
    return load(Path(__file__).with_name("packages.yml"), Packages)


def source() -> tuple[str, str | None]:
    """Suite and mirror line (as in sources.list) to take packages from.

    On Debian the machine's own mirror of its release. Only the main suite: it is enough, and the security suite's
    armhf index may be out of step with it. Elsewhere Debian 12 and no mirror line: mmdebstrap knows the default.
    """
    system = platform.freedesktop_os_release()
    if system.get("ID") != "debian" or "VERSION_CODENAME" not in system:
        return "bookworm", None
    suite = system["VERSION_CODENAME"]
    listing = run(
        ["apt-get", "indextargets", "--format", "$(ORIGIN)|$(REPO_URI)|$(RELEASE)|$(COMPONENT)", "Created-By: Packages"]
    )
    return suite, mirror_line(listing, suite)


def mirror_line(listing: str, suite: str) -> str | None:
    """Find Debian's own mirror in lines ``origin|URI|release|component``; None if there is none.

    An origin reads ``$(ORIGIN)`` as long as the index has not been fetched: the URI decides then.
    """
    for line in listing.splitlines():
        origin, uri, release, component = line.split("|")
        debian = origin == "Debian" or (origin.startswith("$(") and uri.rstrip("/").endswith("/debian"))
        if debian and release == suite and component == "main":
            return f"deb {uri} {suite} main"
    return None


def extraction_mode() -> str:
    """How mmdebstrap may unpack here: ``root`` or, as a user, ``unshare``. UsageError says what is missing."""
    for tool in ("mmdebstrap", "tar"):
        if shutil.which(tool) is None:
            raise UsageError(f"{tool} is not installed: apt-get install {tool}")
    if os.geteuid() == 0:
        return "root"
    if shutil.which("newuidmap") is None:
        raise UsageError("unpacking packages without root needs newuidmap: apt-get install uidmap, or run as root")
    try:
        run(["unshare", "--user", "--map-root-user", "true"])
    except InfrastructureError as error:
        raise UsageError(
            "unpacking packages needs root or user namespaces, and this machine forbids them: "
            "run as root, or sysctl kernel.unprivileged_userns_clone=1 user.max_user_namespaces=10000"
        ) from error
    return "unshare"


def extract(names: list[str], folder: Path, dropped: Iterable[str] = ()) -> None:
    """Unpack packages and what they depend on into an existing folder, every file owned by the caller.

    Left out are documentation, translations and what `dropped` names (patterns of tar). Absolute symbolic links
    become relative, so that they stay inside. Raises UsageError when this user may not unpack, InfrastructureError
    when mmdebstrap fails (network, disk).
    """
    mode = extraction_mode()
    suite, mirror = source()
    archive = folder / "packages.tar"
    command = ["mmdebstrap", "--quiet", "--variant=extract", f"--mode={mode}", f"--architectures={ARCHITECTURE}"]
    command += [f'--extract-hook=ls "$1"/var/cache/apt/archives > "$1"/{LIST}']
    command += ["--format=tar", f"--include={','.join(names)}", suite, str(archive)]
    try:
        run(command + ([mirror] if mirror else []))
        # mknod and foreign owners need rights that nothing here needs.
        excluded = [f"--exclude=./{name}" for name in (*DROPPED, *dropped)]
        run(["tar", "-x", "-f", str(archive), "-C", str(folder), "--no-same-owner", *excluded])
    finally:
        archive.unlink(missing_ok=True)
    relink(folder)


def relink(folder: Path) -> None:
    """Make every absolute symbolic link below a folder relative to its place, the folder being the root."""
    for parent, folders, files in os.walk(folder):
        for name in folders + files:
            link = Path(parent, name)
            if link.is_symlink() and link.readlink().is_absolute():
                target = folder / link.readlink().relative_to("/")
                link.unlink()
                link.symlink_to(os.path.relpath(target, parent))


def installed(folder: Path) -> dict[str, str]:
    """Versions of the packages that `extract` unpacked into a folder, by name."""
    return versions((folder / LIST).read_text(encoding="utf-8").splitlines())


def versions(archives: list[str]) -> dict[str, str]:
    """Package names and versions in names of .deb files, ``name_version_architecture.deb``; others are no package."""
    parts = [unquote(name).split("_") for name in archives if name.endswith(".deb")]
    return {name: version for name, version, _ in parts}
