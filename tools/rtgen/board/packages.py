"""The Debian packages that the board and the sysroot are made of, read from packages.yml."""

from pathlib import Path
from typing import Annotated

from pydantic import StringConstraints

from rtfiles import cache
from rtfiles.config import Config, load
from rtgen import debian

Reason = Annotated[str, StringConstraints(min_length=1)]


class Packages(Config):
    """packages.yml: the name of each package, or a pattern of files that are left out, and the reason."""

    root: dict[str, Reason]
    card: dict[str, Reason]
    sysroot: dict[str, Reason]
    dropped: dict[str, Reason]


def packages() -> Packages:
    """Read packages.yml."""
    return load(Path(__file__).with_name("packages.yml"), Packages)


def unpacked(package: str, architecture: str) -> Path:
    """The folder of an unpacked package and its dependencies, from the cache or downloaded. Raises as `extract`."""
    key = cache.digest([package, architecture, *map(str, debian.source()), Path(debian.__file__)])
    return cache.entry("package", key, lambda folder: debian.extract([package], folder, architecture))
