"""The Debian packages for the board and the sysroot, and the differences between releases: packages.yml."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import StringConstraints

from rtfiles import cache
from rtfiles.config import Config, load_own
from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.wording import unknown
from rtgen import debian
from rtgen.process import run

DATA = Path(__file__).with_name("packages.yml")
Reason = Annotated[str, StringConstraints(min_length=1)]


class DebianRelease(Config):
    """The specifics of a Debian release: packages of the root file system, flags for compiling its programs."""

    root: dict[str, Reason]
    flags: list[str]


class DebianPackages(Config):
    """packages.yml: each package name, or pattern of files to leave out, with the reason."""

    root: dict[str, Reason]
    card: dict[str, Reason]
    sysroot: dict[str, Reason]
    dropped: dict[str, Reason]
    releases: dict[str, DebianRelease]


def packages() -> DebianPackages:
    """Read packages.yml."""
    return load_own(DATA, DebianPackages)


def source(suite: str | None) -> debian.PackageSource:
    """Where a board's packages come from, for Debian's suite of this name (None: the suite of this machine).

    Raises UsageError for a suite that packages.yml does not know.
    """
    chosen = debian.source(suite)
    known = packages().releases
    if chosen.release not in known:
        raise UsageError(f"--suite: {unknown('suite of Debian', chosen.release, known=known)}")
    return chosen


def file_of(package: str, file: str, architecture: str, source: debian.PackageSource) -> Path:
    """A file of a package, by its path in the package. Raises InfrastructureError if missing, or as `unpacked`."""
    path = unpacked([package], architecture, source) / file
    if not path.is_file():
        raise InfrastructureError(f"{package} of Debian {source.release} ({architecture}) has no file {file}")
    return path


def unpacked(names: list[str], architecture: str, source: debian.PackageSource, dropped: Iterable[str] = ()) -> Path:
    """The folder of unpacked packages and their dependencies, from the cache or downloaded. Raises as `extract`.

    It must not be changed: copy it to modify the files. A kernel in it has its modules.dep, which the package's script
    would have made.
    """
    dropped = sorted(dropped)

    def build(folder: Path) -> None:
        debian.extract(names, folder, architecture, source, dropped)
        for modules in folder.glob("lib/modules/*"):
            run(["depmod", "--basedir", str(folder), modules.name])

    key = cache.digest([*names, architecture, repr(source), *dropped, Path(debian.__file__), Path(__file__)])
    return cache.entry("package", key, build)
