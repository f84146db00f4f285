"""The folder against which programs for a board are compiled and linked."""

import re
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
    """Make the packages' CMake files find libraries and headers only in the sysroot.

    The CMake files of catkin packages name /usr/lib and forbid CMake to look for it below the sysroot. On a host with
    the board's architecture they would find the host's libraries, possibly of another release. CMake files of packages
    that were configured with absolute paths contain /usr.
    """
    for file in folder.rglob("*.cmake"):
        text = inside = file.read_text(encoding="utf-8", errors="surrogateescape")
        if file.name.endswith("Config.cmake"):
            inside = text.replace("NO_DEFAULT_PATH NO_CMAKE_FIND_ROOT_PATH", "NO_DEFAULT_PATH")
        elif "targets" in file.name:
            inside = re.sub(r'(?<=[";])/usr\b', "${CMAKE_SYSROOT}/usr", text)
        if inside != text:
            file.write_text(inside, encoding="utf-8", errors="surrogateescape")
