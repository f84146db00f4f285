"""Build the packages of recipes-tests one after another, for this machine and its ROS, or for a board."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from rtfiles import atomic, cache
from rtfiles.config import read_yaml
from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.wording import unknown
from rtgen.board import packages as board_packages
from rtgen.board import sysroot
from rtgen.board.machine import DebianArchitecture, architectures, machines
from rtgen.checkout import shipped
from rtgen.process import run

SCHEMA = 1
TOOLCHAIN_FILE = Path(__file__).with_name("debian.cmake")
# The script in sources() that builds packages with a ROS of this machine.
ROS_SCRIPT = "build.sh"
_ROS_VERSION = 'unset ROS_VERSION; . "$1" >&2; echo "${ROS_VERSION:-}"'
FLAGS = "-O2"
SUPPORT = "rt_tests_support"
# The C program that observes a target while it measures.
SAMPLER = "rt_tests_sampler"
# The package that hosts the nodes of a graph.
GRAPH = "topology_tests"
# communication_tests and graph nodes over transports without ROS, a folder each; all other packages are suites.
TRANSPORTS = "transport_tests"
WITHOUT_ROS = (SUPPORT, SAMPLER, TRANSPORTS)
# The programs of this middleware have the plain names of suites.yml.
FIRST_MIDDLEWARE = "roscpp"
# The name of this machine in the list of machines to build for.
HOST = "host"

# Debian packages whose versions change the result of a native build.
HOST_PACKAGES = ("catkin", "libroscpp-dev", "python3-gencpp", "ros-message-generation")
# The Python of Debian's catkin and genmsg; rtgen may run in another one.
SYSTEM_PYTHON = "/usr/bin/python3"
# Only C++ messages are needed; for other languages the target would need more packages.
ROS_LANG_DISABLE = "genlisp:genpy"


@dataclass(frozen=True)
class Toolchain:
    """The compiler and its flags, and a board's architecture, sysroot and Debian release (None: this machine).

    `identity` distinguishes toolchains in the cache. `has_roscpp`: there is a ROS 1 to build for.
    """

    compiler: str
    flags: str
    architecture: DebianArchitecture | None
    sysroot: Path | None
    release: str | None
    identity: tuple[str, ...]
    has_roscpp: bool = True


def sources() -> Path:
    """The folder recipes-tests."""
    return shipped("recipes-tests")


def packages() -> list[str]:
    """The packages, ordered by dependencies."""
    return [SUPPORT, SAMPLER, *read_yaml(sources() / "suites.yml")["suites"], GRAPH, TRANSPORTS]


def transports() -> dict[str, list[str]]:
    """The Debian packages that each transport needs, by its name; a transport with missing packages is not built."""
    fragments = sorted((sources() / TRANSPORTS).glob("*/transport.cmake"))
    lines = {path.parent.name: re.search(r"^set\(packages(.*)\)$", path.read_text(), re.M) for path in fragments}
    return {name: line[1].split() if line else [] for name, line in lines.items()}


def installed_for_transports() -> list[str]:
    """Names and versions of the transports' packages on this machine; empty if it is not Debian."""
    wanted = {package for packages in transports().values() for package in packages}
    try:
        installed = run(["dpkg-query", "--show"]).splitlines()
    except InfrastructureError:
        return []
    return [line for line in installed if line.split()[0].partition(":")[0] in wanted]


def names() -> list[str]:
    """The known machines: this one, and those of `rtgen board`."""
    return [HOST, *machines()]


def toolchain(machine: str, suite: str | None, ros2: Path | None = None) -> Toolchain:
    """Find or make the tools for a machine's build.

    A board's programs are linked against the packages of Debian's `suite` (None: the suite of this machine). This
    machine needs no ROS 1 if it has a ROS 2, in the folder `ros2`. Raises UsageError for an unknown machine, suite or
    ROS 2, InfrastructureError when a tool or package is missing.
    """
    if machine not in names():
        raise UsageError(unknown("machine", machine, known=names()))
    if machine == HOST:
        if suite is not None:
            raise UsageError(f"--suite {suite} is for boards: {HOST} has the libraries that are installed on it")
        for needed in ("setup.sh", "lib/librcl.so"):
            if ros2 and not (ros2 / needed).exists():
                raise UsageError(f"--ros2 {ros2}: has no {needed}: give the folder of a ROS 2, as /opt/ros/jazzy")
        # Without it, the suites' CMake finds no ROS 2, and builds nothing.
        if ros2 and run(["sh", "-c", _ROS_VERSION, "sh", ros2 / "setup.sh"]).strip() != "2":
            raise UsageError(f"--ros2 {ros2}: its setup.sh sets no ROS_VERSION: install its package ros_environment")
        listing, compiler = "", version("g++")
        try:
            listing = run(["dpkg-query", "--show", *HOST_PACKAGES])
        except InfrastructureError as error:
            if ros2 is None:
                raise InfrastructureError(f"{error}\n`tools/setup all` installs what this machine lacks") from error
        identity = (compiler, listing, *installed_for_transports())
        return Toolchain("g++", FLAGS, None, None, None, identity, has_roscpp=bool(listing))
    if ros2 is not None:
        raise UsageError(f"--ros2 {ros2} is of this machine: build for {HOST}, or on the board itself (docs/ros2.md)")
    source = board_packages.source(suite)
    name = machines()[machine].architecture
    architecture = architectures()[name]
    compiler = f"{architecture.triplet}-g++"
    flags = " ".join([FLAGS, *board_packages.packages().releases[source.release].flags])
    root = sysroot.build(name, source)
    # A transport's code generator runs on this machine; if it is missing now, it may be there at the next build.
    identity = (version(compiler), repr(architecture), str(root), *installed_for_transports())
    return Toolchain(compiler, flags, architecture, root, source.release, identity)


def build(machine: str, place: Path, suite: str | None = None, ros2: Path | None = None) -> Path:
    """Build for `host` or a board with Debian's suite; return `place`/<machine>, a link to a copy next to the link.

    With `ros2`, the folder of a ROS 2 on this machine, the programs on rcl are built too, and those on rclcpp if it has
    that; the programs on roscpp are built where there is a ROS 1. The link does not point into the cache: the cache
    belongs to the user who builds, and others may run the suites. A build takes about half a minute, and as long again
    for a ROS 2; an unchanged build is taken from the cache. Raises UsageError as `toolchain` does, and
    InfrastructureError with the compiler's output.
    """
    tools = toolchain(machine, suite, ros2)
    folder = sources()
    inputs = [folder / name for name in (*packages(), "suites.yml")]
    source_hash = cache.digest(inputs)
    key = cache.digest([source_hash, tools.flags, *tools.identity, Path(__file__), TOOLCHAIN_FILE])

    def build_in(result: Path) -> None:
        with tempfile.TemporaryDirectory(prefix="rtgen-suites-") as temporary:
            stage = Path(temporary) / "stage"
            for package in packages():
                if tools.has_roscpp or package in WITHOUT_ROS:
                    build_package(folder / package, Path(temporary), stage, tools)
            collect(stage, result)
        shutil.copyfile(folder / "suites.yml", result / "suites.yml")
        built = middlewares(result)
        record = {
            "schema": SCHEMA,
            "machine": machine,
            "debian": tools.release,
            "compiler": version(tools.compiler),
            "flags": tools.flags,
            "source_hash": source_hash,
            "middlewares": built,
            "not_built": {name: needed for name, needed in transports().items() if name not in built},
            "files": describe(result),
        }
        atomic.write_text(result / "build.json", json.dumps(record, indent=2) + "\n")

    # The record names the machine, so each machine needs its own entry.
    entry = cache.entry("suites", f"{machine}-{key}", build_in)
    if ros2 is not None:
        entry = with_ros2(entry, ros2)
    copy = place / f".{entry.name}"
    # Two concurrent builds wait for the same entry, and arrive here at the same moment.
    with cache.locked("suites", f"{machine}.place"):
        atomic.copy_folder(entry, copy)
        atomic.replace_link(place / machine, copy.name)
        for earlier in place.iterdir():
            if earlier.name.rpartition("-")[0] == f".{machine}" and earlier != copy:
                shutil.rmtree(earlier)
    return place / machine


def build_on(target: Path) -> int:
    """Let the runner build the suites on the target of this file, which it can reach; return its exit status."""
    return subprocess.run(
        [sys.executable, "-m", "rtrun.cli", "build-suites", str(sources()), "--target", str(target)], check=False
    ).returncode


def build_package(source: Path, temporary: Path, stage: Path, tools: Toolchain) -> None:
    """Configure, compile and install one package into the stage, where later packages find it."""
    work = temporary / source.name
    options = {
        "CMAKE_INSTALL_PREFIX": str(stage),
        "CMAKE_PREFIX_PATH": str(stage),
        "CMAKE_BUILD_TYPE": "None",
        "CMAKE_C_FLAGS": tools.flags,
        "CMAKE_CXX_FLAGS": tools.flags,
        "CATKIN_ENABLE_TESTING": "OFF",
        # catkin of Debian 12 reads one of these, that of Debian 13 the other.
        "PYTHON_EXECUTABLE": SYSTEM_PYTHON,
        "Python_EXECUTABLE": SYSTEM_PYTHON,
    }
    if tools.architecture is not None:
        options |= {
            "CMAKE_TOOLCHAIN_FILE": str(TOOLCHAIN_FILE),
            "META_TRIPLET": tools.architecture.triplet,
            "META_PROCESSOR": tools.architecture.processor,
            "META_SYSROOT": str(tools.sysroot),
            "META_WORK": str(temporary),
        }
    definitions = [f"-D{name}={value}" for name, value in options.items()]
    environment = _environment(temporary) | {"ROS_LANG_DISABLE": ROS_LANG_DISABLE, "ROS_VERSION": "1"}
    run(["cmake", "-S", str(source), "-B", str(work), *definitions], environment=environment)
    run(["ninja", "-C", str(work), "install"], environment=environment)


def with_ros2(entry: Path, ros2: Path) -> Path:
    """Another cache entry: the content of `entry`, built for this machine, and the suites on its ROS 2.

    Its record states under `ros2` what they were built with.
    """
    installed = cache.digest(sorted(ros2.glob("share/*/package.xml")))
    script = sources() / ROS_SCRIPT
    key = cache.digest([entry.name, str(ros2), installed, script])

    def build_in(result: Path) -> None:
        shutil.copytree(entry, result, dirs_exist_ok=True)
        suites = [package for package in packages() if package not in WITHOUT_ROS]
        with tempfile.TemporaryDirectory(prefix="rtgen-suites-") as temporary:
            work, stage = Path(temporary) / "work", Path(temporary) / "stage"
            # The transports again: over the DDS of this ROS 2, if it has one.
            words: list[str | Path] = [ros2 / "setup.sh", work, stage, SUPPORT, *suites, TRANSPORTS]
            environment = _environment(Path(temporary)) | {"CFLAGS": FLAGS, "CXXFLAGS": FLAGS}
            output = run(["sh", script, *words], environment=environment)
            for package in (*suites, TRANSPORTS):
                shutil.copytree(stage / "lib" / package, result / "lib" / package, dirs_exist_ok=True)
        record = json.loads((result / "build.json").read_text(encoding="utf-8"))
        del record["files"]  # added again at the end
        record["middlewares"] = built = middlewares(result)
        record["not_built"] = {name: needed for name, needed in transports().items() if name not in built}
        record["ros2"] = {"prefix": str(ros2)} | dict(line.split(" ", 1) for line in output.splitlines())
        record["files"] = {name: described for name, described in describe(result).items() if name != "build.json"}
        atomic.write_text(result / "build.json", json.dumps(record, indent=2) + "\n")

    return cache.entry("suites", f"{HOST}-{key}", build_in)


def _environment(temporary: Path) -> dict[str, str]:
    """Flags of CMake and the compilers for a build below a temporary folder."""
    # Its name changes with every build; ccache has to ignore it.
    environment = {**os.environ, "CMAKE_GENERATOR": "Ninja", "CCACHE_BASEDIR": str(temporary), "CCACHE_NOHASHDIR": "1"}
    if shutil.which("ccache"):
        environment |= {"CMAKE_C_COMPILER_LAUNCHER": "ccache", "CMAKE_CXX_COMPILER_LAUNCHER": "ccache"}
    return environment


def collect(stage: Path, result: Path) -> None:
    """Copy the programs, the launch files, and the files for rosrun and roslaunch from the stage."""
    (result / ".catkin").touch()
    for package in packages():
        if not (stage / "lib" / package).is_dir():
            continue  # the library has no programs
        shutil.copytree(stage / "lib" / package, result / "lib" / package)
        data = result / "share" / package
        data.mkdir(parents=True)
        if (stage / "share" / package / "launch").is_dir():
            shutil.copytree(stage / "share" / package / "launch", data / "launch")
        shutil.copyfile(stage / "share" / package / "package.xml", data / "package.xml")


def middlewares(folder: Path) -> dict[str, list[str]]:
    """The programs of suites.yml in a folder, by middleware; all except roscpp's carry its name."""
    names = sorted(path.name for path in folder.glob("lib/*/*"))
    found: dict[str, list[str]] = {}
    for suite in read_yaml(folder / "suites.yml")["suites"].values():
        for program in suite["programs"]:
            for name in [name for name in names if name == program or name.startswith(f"{program}_")]:
                found.setdefault(name[len(program) + 1 :] or FIRST_MIDDLEWARE, []).append(program)
    return dict(sorted(found.items()))


def describe(folder: Path) -> dict[str, dict[str, int | str]]:
    """Size and SHA-256 of every file of a folder, by path relative to it."""
    return {
        str(path.relative_to(folder)): {
            "size_bytes": path.stat().st_size,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        }
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def version(compiler: str) -> str:
    """The first line of a compiler's --version."""
    return run([compiler, "--version"]).splitlines()[0]
