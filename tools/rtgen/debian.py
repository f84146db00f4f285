"""Debian packages of any architecture, unpacked into a folder: nothing is installed, run or emulated."""

import os
import platform
import shutil
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote

from rtfiles.errors import InfrastructureError, UsageError
from rtgen.process import run

# Folders that neither a board nor a compiler reads: a third of all bytes.
DROPPED = ("usr/share/doc", "usr/share/man", "usr/share/locale", "usr/share/info", "usr/share/lintian", "dev")

# The file in which a hook of mmdebstrap lists the packages that were unpacked.
LIST = "packages.list"


def source() -> tuple[str, str | None]:
    """The suite to take packages from, and the mirror as a line of sources.list.

    On Debian these are the machine's own release and mirror. Only the main suite is used: it has everything, and the
    security suite's index may not match it. On other systems the suite is Debian 12's, and the mirror is None:
    mmdebstrap then uses its default.
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
    """The line of sources.list for Debian's mirror in lines ``origin|URI|release|component``; None if there is none.

    Before apt has fetched an index, its origin reads ``$(ORIGIN)``; then the URI decides.
    """
    for line in listing.splitlines():
        origin, uri, release, component = line.split("|")
        debian = origin == "Debian" or (origin.startswith("$(") and uri.rstrip("/").endswith("/debian"))
        if debian and release == suite and component == "main":
            return f"deb {uri} {suite} main"
    return None


def extraction_mode() -> str:
    """The mode in which mmdebstrap may unpack here: ``root`` or, as a user, ``unshare``. UsageError if neither."""
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


def extract(names: list[str], folder: Path, architecture: str, dropped: Iterable[str] = ()) -> None:
    """Unpack packages of an architecture and their dependencies into an existing folder; the caller owns every file.

    Documentation, translations and files that match `dropped` (patterns of tar) are left out. Absolute symbolic links
    become relative, so that they stay in the folder. Raises UsageError when this user may not unpack,
    InfrastructureError when mmdebstrap fails (network, disk).
    """
    mode = extraction_mode()
    suite, mirror = source()
    archive = folder / "packages.tar"
    command = ["mmdebstrap", "--quiet", "--variant=extract", f"--mode={mode}", f"--architectures={architecture}"]
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
    """Make every absolute symbolic link below a folder relative; the folder stands for the root of the file system."""
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
    """Package names and versions from file names ``name_version_architecture.deb``; other names are ignored."""
    parts = [unquote(name).split("_") for name in archives if name.endswith(".deb")]
    return {name: version for name, version, _ in parts}
