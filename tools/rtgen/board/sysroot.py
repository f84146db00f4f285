"""The folder against which programs for a board are compiled and linked."""

from pathlib import Path

from rtfiles import cache
from rtgen import debian
from rtgen.board.packages import packages


def build(architecture: str, source: debian.PackageSource) -> Path:
    """Return a folder for ``g++ --sysroot=``, with roscpp and the C library of Debian's architecture and release.

    Built once (about 30 s, network) and kept in the cache. Raises UsageError or InfrastructureError as
    `debian.extract` does.
    """
    names = sorted(packages().sysroot)
    key = cache.digest(["sysroot", architecture, *names, repr(source), Path(debian.__file__), Path(__file__)])

    def build_in(folder: Path) -> None:
        debian.extract(names, folder, architecture, source)
        search_inside(folder)

    return cache.entry("sysroot", key, build_in)


def search_inside(folder: Path) -> None:
    """Let the CMake files of catkin packages find libraries in the sysroot alone.

    They name /usr/lib and forbid CMake to look for it below the sysroot, so on a host of the board's architecture they
    would find the host's libraries, which may be of another release.
    """
    for file in folder.rglob("*Config.cmake"):
        text = file.read_text(encoding="utf-8", errors="surrogateescape")
        if "NO_DEFAULT_PATH NO_CMAKE_FIND_ROOT_PATH" in text:
            inside = text.replace("NO_DEFAULT_PATH NO_CMAKE_FIND_ROOT_PATH", "NO_DEFAULT_PATH")
            file.write_text(inside, encoding="utf-8", errors="surrogateescape")
