"""A rendered profile, stub layers and the real BitBake."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from bitbake.debian_tools import build_suites
from bitbake.yocto import Yocto, open_checkouts
from ros2 import wheels
from rtgen.layer import output
from rtgen.layer.render import render
from rtgen.profile import Release, load_profile

HERE = Path(__file__).parent
STUBS = HERE / "stubs"


@pytest.fixture(scope="session")
def yocto() -> Iterator[Yocto]:
    """The checkouts that `make test-yocto` was given."""
    given = os.environ.get("RT_TESTS_LAYERS")
    assert given, "give the checkouts: make test-yocto LAYERS=DIR"
    yocto = open_checkouts(Path(given).resolve(), os.environ.get("RT_TESTS_PROFILE"))
    print(f"\nprofile {yocto.name}, machine {yocto.machine}: {yocto.top}")
    yield yocto
    print(f"\n{yocto.summary()}")


@pytest.fixture(scope="session")
def built_suites(yocto: Yocto) -> Path:
    """The build folder in which the recipes of the suites were run."""
    if yocto.profile.suites:
        pytest.skip("the originals of 2014 are in a git repository, and BB_NO_NETWORK is set")
    if os.geteuid() != 0:
        pytest.skip("files are installed as root, because pseudo would have to be built first")
    if yocto.ros.version == 2 and yocto.profile.ros_distro not in wheels.DISTROS:
        pytest.skip(f"there are no wheels of {yocto.profile.ros_distro}")
    return build_suites(yocto)


@dataclass(frozen=True)
class Build:
    """A build folder: the rendering, and local.conf and bblayers.conf on it."""

    folder: Path
    layer: Path

    def bitbake(self, **request: Any) -> dict[str, Any]:
        """Run driver.py; a failure is an AssertionError with what BitBake said."""
        done = self.try_bitbake(**request)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "WARNING" not in done.stderr, done.stderr
        answer: dict[str, Any] = json.loads((self.folder / "answer.json").read_text())
        return answer

    def try_bitbake(self, **request: Any) -> subprocess.CompletedProcess[str]:
        """Run driver.py, whatever comes."""
        argv = [sys.executable, str(HERE / "driver.py"), str(self.folder), json.dumps(request), "answer.json"]
        return subprocess.run(
            argv, capture_output=True, text=True, env={**os.environ, "LC_ALL": "C.UTF-8"}, check=False
        )


@pytest.fixture(scope="session")
def make_build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Build]:
    """Render a profile and set up a build of it for a machine, in a new folder; `local` is more for local.conf."""

    def make(name: str, machine: str, local: str = "", separator: str | None = None) -> Build:
        place = tmp_path_factory.mktemp("bitbake")
        profile, release = load_profile(name)
        if separator:
            release = release.model_copy(update={"separator": separator})
        project = place / name
        output.write(render(name, profile, release), project)
        folder = place / f"build-{name}-{machine}"
        (folder / "conf").mkdir(parents=True)
        layers = f"{STUBS} {project / 'meta-rt-tests'}"
        (folder / "conf" / "bblayers.conf").write_text(
            f'BBPATH = "${{TOPDIR}}"\nBBFILES = ""\nRELEASE = "{profile.release}"\nBBLAYERS = "{layers}"\n'
        )
        (folder / "conf" / "local.conf").write_text(_local(release, machine) + local)
        return Build(folder, project / "meta-rt-tests")

    return make


def _local(release: Release, machine: str) -> str:
    lines = [f'MACHINE = "{machine}"']
    if release.unpack_folder == "${UNPACKDIR}":
        lines.append('UNPACKDIR = "${WORKDIR}/sources"')
    return "\n".join(lines) + "\n"
