"""The contents of the recipes for recipes-tests/, from suites.yml and each package's package.xml."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from rtfiles.config import read_yaml
from rtfiles.errors import UsageError
from rtgen.profile import Profile, Release, RosDistro
from rtgen.suites import GRAPH, SAMPLER, SUPPORT, TRANSPORTS, packages, sources, transports

# The client libraries that the suites measure, by ROS version.
CLIENTS: dict[int, tuple[str, ...]] = {0: (), 1: ("roscpp",), 2: ("rcl", "rclcpp")}
# What the sources of 2014 need besides our needs: their library uses ROS, and their messages use other messages.
OF_2014 = {"rt_tests_support": ("roscpp",), "communication_tests": ("std-msgs",)}


@dataclass(frozen=True, kw_only=True, slots=True)
class Recipe:
    """A package's recipe. `build`, `run`: the recipes it needs; `variables`: the CMake variables it sets.

    `builder`: catkin, ament_cmake, or cmake for a package without ROS. `library`: it has no program.
    """

    name: str
    summary: str
    description: str
    builder: str
    build: tuple[str, ...]
    run: tuple[str, ...]
    library: bool = False
    unit_tests: bool = False
    variables: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class Dependencies:
    """The packages that a package.xml names: as build tools, for building, for running."""

    tools: tuple[str, ...]
    build: tuple[str, ...]
    run: tuple[str, ...]


def recipes_of(profile: Profile, release: Release) -> Iterator[Recipe]:
    """The recipe of each package, ordered by dependencies."""
    suites = read_yaml(sources() / "suites.yml")["suites"]
    ros = release.ros_distros[profile.ros_distro]
    for package in packages():
        if profile.suites and package in (SAMPLER, GRAPH, TRANSPORTS):
            continue  # 2014 had none of them
        needs = read_dependencies(sources() / package / "package.xml", ros.version)
        if needs.tools and not ros.version:
            continue  # only packages of ROS name a build tool
        build, run, variables = {*needs.build, *needs.run}, {*needs.run}, {}
        if profile.suites:
            build.update(OF_2014.get(package, ()))
            run.update(OF_2014.get(package, ()) if package != SUPPORT else ())
        else:
            build.update(f"{tool}-native" for tool in needs.tools)
        if package == SUPPORT:
            summary = "Library of the suites that measure ROS"
            description = "Code that the suites share: options, real-time setup, statistics, logs"
        elif package == SAMPLER:
            summary = "Observes a target while a suite measures"
            description = "A program that records which threads, loads and interrupts there are beside a suite"
        elif package == GRAPH:
            summary = "Hosts the nodes of a graph and records what each of them does"
            description = "A program that runs as each process of a graph of nodes, which a text describes"
        elif package == TRANSPORTS:
            names = transports_of(ros)
            build.update(ros.transports.values())
            variables["TRANSPORTS"] = ";".join(names)
            summary = "Measures the end-to-end latency of publish-subscribe without ROS"
            description = f"The programs of communication-tests, through {', '.join(names)}"
        else:
            suite = suites[package]
            summary = f"Measures the {suite['summary']}"
            if ros.version == 2:
                # ament builds what it finds: a suite without its rclcpp programs would not be an error.
                variables["CMAKE_REQUIRE_FIND_PACKAGE_rclcpp"] = "ON"
            description = f"Programs that measure the {suite['summary']}: {', '.join(_programs(suite, ros.version))}"
        yield Recipe(
            name=_dashed(package),
            summary=summary,
            description=description,
            builder=needs.tools[0] if needs.tools else "cmake",
            build=tuple(sorted(map(_dashed, build))),
            run=tuple(sorted(map(_dashed, run))),
            library=package == SUPPORT,
            # GoogleTest is in meta-openembedded, a layer that an image without ROS does not need.
            unit_tests=package == SUPPORT and not profile.suites and ros.version > 0,
            variables=variables,
        )


def transports_of(ros: RosDistro) -> list[str]:
    """The transports that are measured through without ROS."""
    return sorted({name for name, debian in transports().items() if not debian} | ros.transports.keys())


def read_dependencies(path: Path, ros_version: int) -> Dependencies:
    """The dependencies in a package.xml (format 3, REP 149) for a ROS version.

    Raises UsageError for a condition on anything but ROS_VERSION.
    """
    tree = ElementTree.parse(path)

    def named(*tags: str) -> tuple[str, ...]:
        return tuple(
            str(element.text).strip()
            for tag in tags
            for element in tree.findall(tag)
            if _holds(element.get("condition"), ros_version, path)
        )

    return Dependencies(
        tools=named("buildtool_depend"), build=named("build_depend", "depend"), run=named("depend", "exec_depend")
    )


def _holds(condition: str | None, ros_version: int, path: Path) -> bool:
    match condition.split() if condition else None:
        case None:
            return True
        case ["$ROS_VERSION", "==" | "!=" as operator, "1" | "2" as version]:
            return (version == str(ros_version)) == (operator == "==")
    raise UsageError(f"{path}: condition {condition!r}: only $ROS_VERSION == 2 and the like are read")


def _programs(suite: Mapping[str, Mapping[str, object]], ros_version: int) -> list[str]:
    """The names of a suite's programs: those of 2014, or the same with the measured client library appended."""
    if ros_version == 1:
        return list(suite["programs"])
    return [f"{program}_{client}" for program in suite["programs"] for client in CLIENTS[ros_version]]


def _dashed(package: str) -> str:
    """The recipe name of a ROS package; BitBake allows no underscore in it."""
    return package.replace("_", "-")
