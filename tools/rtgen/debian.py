"""Debian packages of any architecture, unpacked into a folder: nothing is installed, run or emulated."""

import os
import platform
import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.output import print_note
from rtgen.process import run

# Folders that neither a board nor a compiler reads, a third of all bytes; and apt's settings for this download.
DROPPED = (
    *("usr/share/doc", "usr/share/man", "usr/share/locale", "usr/share/info", "usr/share/lintian", "dev"),
    "etc/apt/apt.conf.d/99mmdebstrap",
)

# The reason of a failure is taken from apt's output.
ENGLISH = {"LC_ALL": "C.UTF-8"}
# apt's report of a failed download: the address, the reason.
FAILED = re.compile(r"^ *E: Failed to fetch (\S+) +(.+)$", re.M)
# The reasons when index and files do not match: the mirror, or a cache on the way, is being updated.
OUT_OF_STEP = ("File has unexpected size", "Hash Sum mismatch", "404 ")

# Other names of Debian's releases: under another name, a cache on the way may hold matching files.
OTHER_NAMES = {"bookworm": "oldstable", "trixie": "stable"}

# The file in which a hook of mmdebstrap lists the unpacked packages.
LIST = "packages.list"


@dataclass(frozen=True, kw_only=True, slots=True)
class PackageSource:
    """Where packages come from: the code name of Debian's release, and the mirror (None: mmdebstrap's default)."""

    release: str
    mirror: str | None


def source(release: str | None = None) -> PackageSource:
    """The source of a release's packages; without a release, that of this machine, or of Debian 12 on other systems.

    On Debian the mirror is the machine's own. Only the main suite is used: it has everything, and the security suite's
    index may not match it.
    """
    system = platform.freedesktop_os_release()
    if system.get("ID") != "debian" or "VERSION_CODENAME" not in system:
        return PackageSource(release=release or "bookworm", mirror=None)
    own = system["VERSION_CODENAME"]
    listing = run(
        ["apt-get", "indextargets", "--format", "$(ORIGIN)|$(REPO_URI)|$(RELEASE)|$(COMPONENT)", "Created-By: Packages"]
    )
    return PackageSource(release=release or own, mirror=mirror(listing, own))


def mirror(listing: str, release: str) -> str | None:
    """The URI of Debian's mirror in lines ``origin|URI|release|component``; None if none has this release.

    Before apt has fetched an index, its origin reads ``$(ORIGIN)``; then the URI decides.
    """
    for line in listing.splitlines():
        origin, uri, served, component = line.split("|")
        debian = origin == "Debian" or (origin.startswith("$(") and uri.rstrip("/").endswith("/debian"))
        if debian and served == release and component == "main":
            return uri
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


def download(attempt: Callable[[Mapping[str, str]], None]) -> None:
    """Call `attempt`, which downloads packages with settings for apt and raises InfrastructureError if apt fails.

    If index and files do not match, call it a second time, with settings that make caches on the way ask the mirror.
    """
    try:
        attempt({})
    except InfrastructureError as error:
        if not is_out_of_step(error):
            raise
        print_note("Debian's mirror or a cache before it is in the middle of an update: downloading again, past caches")
        # apt also uses it for https.
        attempt({"Acquire::http::No-Cache": "true"})


def is_out_of_step(error: InfrastructureError) -> bool:
    """Whether a download failed because index and files do not match."""
    return any(reason.startswith(OUT_OF_STEP) for _, reason in FAILED.findall(str(error)))


def failed_download(output: str) -> str | None:
    """What could not be downloaded and why, in one line, from apt's output; None if no download failed."""
    failed = FAILED.search(output)
    if failed is None:
        return None
    later = " (past caches, too: try again later)" if failed[2].startswith(OUT_OF_STEP) else ""
    return f"cannot download {failed[1]}: {failed[2]}{later}"


def extract(
    names: list[str], folder: Path, architecture: str, source: PackageSource, dropped: Iterable[str] = ()
) -> None:
    """Unpack packages of an architecture and their dependencies into an existing folder; the caller owns every file.

    Documentation, translations and files that match `dropped` (patterns of tar) are left out. Absolute symbolic links
    become relative, so that they stay in the folder. mmdebstrap uses its own apt settings and lists, and leaves the
    machine's as they are. Raises UsageError when this user may not unpack, InfrastructureError when mmdebstrap fails
    (network, disk, a release or package that the mirror does not serve).
    """
    mode = extraction_mode()
    archive = folder / "packages.tar"
    command = ["mmdebstrap", "--variant=extract", f"--mode={mode}", f"--architectures={architecture}"]
    command += [f'--extract-hook=ls "$1"/var/cache/apt/archives > "$1"/{LIST}']
    # What a suite name stands for changes with Debian's next release.
    command += [f'--extract-hook=grep -qx "Codename: {source.release}" "$1"/var/lib/apt/lists/*Release']
    command += ["--format=tar", f"--include={','.join(names)}"]

    def attempt(settings: Mapping[str, str], name: str = source.release) -> None:
        options = [f'--aptopt={name} "{value}"' for name, value in settings.items()]
        lines = [f"deb {source.mirror} {name} main"] if source.mirror else []
        run([*command, *options, name, str(archive), *lines], environment={**os.environ, **ENGLISH})

    try:
        try:
            download(attempt)
        except InfrastructureError as error:
            other = OTHER_NAMES.get(source.release)
            if other is None or not is_out_of_step(error):
                raise
            print_note(f"downloading again, by the other name of Debian {source.release}: {other}")
            try:
                attempt({}, other)
            except InfrastructureError:
                raise error from None
        # mknod and other owners need rights that nothing here needs.
        excluded = [f"--exclude=./{name}" for name in (*DROPPED, *dropped)]
        run(["tar", "-x", "-f", str(archive), "-C", str(folder), "--no-same-owner", *excluded])
    except InfrastructureError as error:
        where = source.mirror or "mmdebstrap's default mirror"
        if "does not have a Release file" in str(error):
            raise InfrastructureError(f"Debian's suite {source.release} is not served by {where}") from error
        if unknown := re.findall(r"Unable to locate package (\S+)", str(error)):
            missing = (
                f"Debian's suite {source.release} at {where} has no package {', '.join(unknown)} for {architecture}"
            )
            raise InfrastructureError(missing) from error
        if failed := failed_download(str(error)):
            raise InfrastructureError(failed) from error
        raise
    finally:
        archive.unlink(missing_ok=True)
    merge_usr(folder)
    relink(folder)


def merge_usr(folder: Path) -> None:
    """Link the old names of the folders that Debian 13 has only below /usr, as its base-files package does."""
    for name in ("bin", "sbin", "lib", "lib64"):
        if (folder / "usr" / name).is_dir() and not os.path.lexists(folder / name):
            (folder / name).symlink_to(f"usr/{name}")


def relink(folder: Path) -> None:
    """Make every absolute symbolic link below a folder relative; the folder is the root of the file system."""
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
