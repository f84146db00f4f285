"""Whether this host can build an image with BitBake: the facts about it, compared with doctor.yml."""

import os
import re
import resource
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from rtfiles.config import Config, load_own
from rtgen.profile import Profile

NEEDS_FILE = Path(__file__).with_name("doctor.yml")
BUILDS_FILE = Path(__file__).parent / "layer" / "builds.yml"
GIB = 1024**3
_PROXIES = ("http_proxy", "https_proxy", "GIT_PROXY_COMMAND")
_PROGRAM_TIMEOUT_S = 20


class NeededProgram(Config):
    """The Debian package of a program, and the oldest version that works."""

    package: str
    version: str | None = None


class Needs(Config):
    """doctor.yml."""

    schema_: Literal[1] = Field(alias="schema")
    programs: dict[str, NeededProgram]
    locale: str
    memory_gib: int
    open_files: int


class Build(Config):
    """What a first build of an image takes; builds.yml explains each key."""

    recipes: int | None
    tasks: int | None
    counted: str
    gib: int
    rm_work_gib: int
    hours: int
    measured: bool = False


class Builds(Config):
    """builds.yml: by release and ROS."""

    schema_: Literal[1] = Field(alias="schema")
    builds: dict[str, dict[str, Build]]


@dataclass(frozen=True, kw_only=True, slots=True)
class Host:
    """The facts about a host. `versions` has None for a program that prints no version."""

    folder: Path
    versions: Mapping[str, str | None]
    locales: frozenset[str]
    free_bytes: int
    memory_bytes: int
    free_memory_bytes: int
    open_files: int
    user_namespaces: bool
    root: bool
    proxies: Mapping[str, str]


@dataclass(frozen=True, kw_only=True, slots=True)
class Obstacle:
    """Something that prevents a build (`fatal`) or may spoil it, and the remedy."""

    fatal: bool
    what: str
    remedy: str


def load_needs() -> Needs:
    """What a build needs."""
    return load_own(NEEDS_FILE, Needs)


def load_build(profile: Profile) -> Build:
    """What a first build of a profile's image takes."""
    return load_own(BUILDS_FILE, Builds).builds[profile.release][profile.ros_distro]


def inspect(folder: Path, needs: Needs) -> Host:
    """Find out what a build in `folder` (which must exist) has available."""
    existing = [name for name in needs.programs if shutil.which(name)]
    return Host(
        folder=folder.resolve(),
        versions={name: _version(name) if needs.programs[name].version else None for name in existing},
        locales=frozenset(_run(["locale", "-a"]).stdout.split()),
        free_bytes=shutil.disk_usage(folder).free,
        memory_bytes=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        free_memory_bytes=_free_memory(),
        open_files=resource.getrlimit(resource.RLIMIT_NOFILE)[0],
        user_namespaces=_run(["unshare", "--user", "--net", "--map-current-user", "true"]).returncode == 0,
        root=os.geteuid() == 0,
        proxies={name: os.environ[name] for name in _PROXIES if os.environ.get(name)},
    )


def judge(host: Host, needs: Needs, build: Build) -> list[Obstacle]:
    """What prevents or may spoil a build on a host, fatal findings first."""
    return sorted(_findings(host, needs, build), key=lambda finding: not finding.fatal)


def _findings(host: Host, needs: Needs, build: Build) -> Iterator[Obstacle]:
    missing = [name for name in needs.programs if name not in host.versions]
    if missing:
        packages = " ".join(sorted({needs.programs[name].package for name in missing}))
        yield Obstacle(
            fatal=True, what=f"not installed: {', '.join(missing)}", remedy=f"sudo apt-get install {packages}"
        )
    for name, version in host.versions.items():
        oldest = needs.programs[name].version
        if oldest and version and _numbers(version) < _numbers(oldest):
            yield Obstacle(
                fatal=True,
                what=f"{name} is version {version}, BitBake needs {oldest}",
                remedy="take a newer distribution, or the Yocto Project's buildtools-extended tarball",
            )
    if needs.locale not in host.locales:
        yield Obstacle(
            fatal=True,
            what="the locale en_US.UTF-8, in which BitBake runs, does not exist",
            remedy="sudo apt-get install locales && sudo localedef -i en_US -f UTF-8 en_US.UTF-8",
        )
    if host.root:
        yield Obstacle(fatal=True, what="you are root, as whom BitBake refuses to run", remedy="build as another user")
    if not host.user_namespaces:
        yield Obstacle(
            fatal=True,
            what="user namespaces cannot be made, with which BitBake cuts tasks off the network",
            remedy="Ubuntu 24.04 and later: sudo sysctl kernel.apparmor_restrict_unprivileged_userns=0; "
            "Debian: sudo sysctl kernel.unprivileged_userns_clone=1; "
            "in a container: allow unshare (podman and docker: --security-opt seccomp=unconfined)",
        )
    if found := re.search(r"[\s+@]", str(host.folder)):
        yield Obstacle(
            fatal=True,
            what=f"{host.folder} has {found[0]!r} in its path, which breaks recipes",
            remedy="build in a folder whose path has no blank, + or @",
        )
    yield from _resources(host, needs, build)
    if "http_proxy" in host.proxies and "https_proxy" not in host.proxies:
        yield Obstacle(
            fatal=False,
            what="http_proxy is set and https_proxy is not, but most sources come by https",
            remedy="export https_proxy with your proxy, too",
        )
    if {"http_proxy", "https_proxy"} & host.proxies.keys() and "GIT_PROXY_COMMAND" not in host.proxies:
        yield Obstacle(
            fatal=False,
            what="a proxy is set, which git:// addresses do not use",
            remedy="export GIT_PROXY_COMMAND (see core.gitProxy in git-config), if a fetch by git:// fails",
        )


def _resources(host: Host, needs: Needs, build: Build) -> Iterator[Obstacle]:
    free_gib, memory_gib = host.free_bytes / GIB, host.memory_bytes / GIB
    if free_gib < build.gib:
        enough = free_gib >= build.rm_work_gib
        yield Obstacle(
            fatal=not enough,
            what=f"{free_gib:.0f} GiB are free in {host.folder}, a first build needs {build.gib} GiB",
            remedy="add :meta-rt-tests/kas/rm-work.yml to the command of kas, with which "
            f"{build.rm_work_gib} GiB are enough"
            if enough
            else "free some space, or build in a folder on a larger disk; "
            f"with kas/rm-work.yml {build.rm_work_gib} GiB are enough",
        )
    # A machine with 8 GiB shows a little less, since the firmware and the kernel keep some.
    if memory_gib < 0.9 * needs.memory_gib:
        yield Obstacle(
            fatal=False,
            what=f"{memory_gib:.1f} GiB of memory, {needs.memory_gib} GiB are the least that Yocto's manual names",
            remedy='in local.conf: BB_NUMBER_THREADS = "2" and PARALLEL_MAKE = "-j 2"; add swap',
        )
    if host.open_files < needs.open_files:
        yield Obstacle(
            fatal=False,
            what=f"a process may open {host.open_files} files only, the usual limit is {needs.open_files}",
            remedy=f"ulimit -n {needs.open_files}",
        )


def _free_memory() -> int:
    """The bytes that programs can get without swapping."""
    found = re.search(r"^MemAvailable: +(\d+) kB$", Path("/proc/meminfo").read_text(encoding="ascii"), re.MULTILINE)
    return int(found[1]) * 1024 if found else 0


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("."))


def _version(program: str) -> str | None:
    match = re.search(r"\d+(\.\d+)+", _run([program, "--version"]).stdout)
    return match[0] if match else None


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    """Run a program; one that is missing or takes too long prints nothing and fails."""
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=_PROGRAM_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired):
        return subprocess.CompletedProcess(command, returncode=1, stdout="")
