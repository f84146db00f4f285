"""The Debian packages that the board and the sysroot are made of, and what differs by release: packages.yml."""

from pathlib import Path
from typing import Annotated

from pydantic import StringConstraints

from rtfiles import cache
from rtfiles.config import Config, load
from rtfiles.errors import InfrastructureError, UsageError
from rtgen import debian
from rtgen.process import run

DATA = Path(__file__).with_name("packages.yml")
Reason = Annotated[str, StringConstraints(min_length=1)]


class Release(Config):
    """What differs in a release of Debian: packages of the root file system, flags for compiling its programs."""

    root: dict[str, Reason]
    flags: list[str]


class Packages(Config):
    """packages.yml: the name of each package, or a pattern of files that are left out, and the reason."""

    root: dict[str, Reason]
    card: dict[str, Reason]
    sysroot: dict[str, Reason]
    dropped: dict[str, Reason]
    releases: dict[str, Release]


def packages() -> Packages:
    """Read packages.yml."""
    return load(DATA, Packages)


def source(suite: str | None) -> debian.Source:
    """Where a board's packages come from, for Debian's suite of this name (None: this machine's own).

    Raises UsageError for a suite that packages.yml does not know.
    """
    chosen = debian.source(suite)
    known = packages().releases
    if chosen.release not in known:
        raise UsageError(f"Debian's suite {chosen.release!r} is unknown, known: {', '.join(known)} (--suite)")
    return chosen


def file_of(package: str, file: str, architecture: str, source: debian.Source) -> Path:
    """A file of a package by its path in it. Raises InfrastructureError when there is none, and as `unpacked` does."""
    path = unpacked(package, architecture, source) / file
    if not path.is_file():
        raise InfrastructureError(f"{package} of Debian {source.release} ({architecture}) has no file {file}")
    return path


def unpacked(package: str, architecture: str, source: debian.Source) -> Path:
    """The folder of an unpacked package and its dependencies, from the cache or downloaded. Raises as `extract`.

    A kernel in it has its modules.dep, which the package's script would have made.
    """

    def build(folder: Path) -> None:
        debian.extract([package], folder, architecture, source)
        for modules in folder.glob("lib/modules/*"):
            run(["depmod", "--basedir", str(folder), modules.name])

    key = cache.digest([package, architecture, repr(source), Path(debian.__file__), Path(__file__)])
    return cache.entry("package", key, build)
