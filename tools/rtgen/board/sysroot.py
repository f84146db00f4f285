"""The folder against which programs for the emulated board are compiled and linked."""

from pathlib import Path

from rtfiles import cache
from rtgen import debian
from rtgen.board.packages import packages


def build() -> Path:
    """Return a sysroot for ``arm-linux-gnueabihf-g++ --sysroot=``, with roscpp and the C library of the board.

    Built once (about 30 s, network) and kept in the cache. Raises UsageError or InfrastructureError as
    `debian.extract` does.
    """
    names = sorted(packages().sysroot)
    key = cache.digest(["sysroot", *names, *map(str, debian.source()), Path(debian.__file__), Path(__file__)])

    def build_in(folder: Path) -> None:
        debian.extract(names, folder)

    return cache.entry("sysroot", key, build_in)
