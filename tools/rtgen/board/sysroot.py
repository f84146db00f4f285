"""The folder against which programs for a board are compiled and linked."""

from pathlib import Path

from rtfiles import cache
from rtgen import debian
from rtgen.board.packages import packages


def build(architecture: str, source: debian.Source) -> Path:
    """Return a folder for ``g++ --sysroot=``, with roscpp and the C library of Debian's architecture and release.

    Built once (about 30 s, network) and kept in the cache. Raises UsageError or InfrastructureError as
    `debian.extract` does.
    """
    names = sorted(packages().sysroot)
    key = cache.digest(["sysroot", architecture, *names, repr(source), Path(debian.__file__), Path(__file__)])

    def build_in(folder: Path) -> None:
        debian.extract(names, folder, architecture, source)

    return cache.entry("sysroot", key, build_in)
