"""tools/setup: what apt prints is in a log unless it fails; this checkout is installed, with pinned packages."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

TOP = Path(__file__).parents[1]


def write_programs(folder: Path, scripts: dict[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, script in scripts.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)


def packages_of(checkout: Path) -> Path:
    (folder,) = (checkout / ".venv").glob("lib/python3*/site-packages")
    return folder


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout that lacks a Debian package and has its Python environment."""
    (tmp_path / "tools").mkdir()
    for name in ("setup", "step.sh"):
        shutil.copy(TOP / "tools" / name, tmp_path / "tools")
    (tmp_path / "tools/apt-packages-quick.txt").write_text("no-such-package-to-measure-here\n")
    (tmp_path / "tools/apt-packages.txt").write_text("no-such-package-of-the-tests\n")
    (tmp_path / "tools/apt-packages-all.txt").write_text("no-such-package-of-other-boards\n")
    (tmp_path / "tools/apt-packages-dev.txt").write_text("no-such-package-for-tests-alone\n")
    (tmp_path / "tools/python-packages.txt").write_text("a-package==1 --hash=sha256:0\n")
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "runner").mkdir()
    venv.create(tmp_path / ".venv", symlinks=True)
    write_programs(tmp_path / ".venv/bin", {"pip": 'echo "pip $*"'})
    installed = packages_of(tmp_path) / "meta_rt_tests-0.dist-info"
    installed.mkdir()
    (installed / "direct_url.json").write_text(distribution("meta-rt-tests").read_text("direct_url.json") or "")
    inputs = subprocess.run(
        ["sh", "-c", "sha256sum pyproject.toml; pwd"], cwd=tmp_path, check=True, capture_output=True
    )
    (tmp_path / ".venv/.installed").write_bytes(inputs.stdout)
    return tmp_path


def setup(checkout: Path, status_of_install: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run it where apt-get prints and ends as told, and the user is root or may become it."""
    programs = checkout / "programs"
    apt_get = f'echo "noise of $*"; cat changes 2>/dev/null; [ $1 = update ] || exit {status_of_install}'
    write_programs(programs, {"apt-get": apt_get, "sudo": 'exec "$@"'})
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"}
    return subprocess.run(
        [checkout / "tools/setup", *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )


def test_each_step_is_one_line_with_its_time(checkout: Path) -> None:
    done = setup(checkout, 0)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(
        r"reading Debian's package lists \.\.\. \d+ s\ninstalling 1 Debian packages \.\.\. \d+ s\n"
        r"writing them to the disk \.\.\. \d+ s\n",
        done.stdout,
    )
    assert "noise of install" in (checkout / "build/setup.log").read_text()


@pytest.mark.parametrize(("change", "waits"), [("Inst new (2 Debian:12)", False), ("Inst old [1] (2 Debian:12)", True)])
def test_only_an_upgrade_waits_for_the_disk_after_each_file(checkout: Path, change: str, waits: bool) -> None:
    (checkout / "changes").write_text(f"{change}\n")
    assert setup(checkout, 0).returncode == 0
    (installed,) = re.findall("^noise of install .*", (checkout / "build/setup.log").read_text(), re.M)
    assert ("--force-unsafe-io" not in installed) == waits


def test_a_step_that_fails_shows_the_end_of_the_log(checkout: Path) -> None:
    done = setup(checkout, 100)
    assert done.returncode == 100
    assert re.search(r"installing 1 Debian packages \.\.\. failed after \d+ s\n$", done.stdout)
    assert re.search("^noise of install", done.stderr, re.M)
    assert done.stderr.endswith("exit status 100; all of its output is in build/setup.log\n")


def test_only_dev_installs_what_the_tests_alone_need(checkout: Path) -> None:
    log = checkout / "build/setup.log"
    assert setup(checkout, 0).returncode == 0
    assert "alone" not in log.read_text() and "pip" not in log.read_text()
    log.unlink()
    assert "installing 3 Debian packages" in setup(checkout, 0, "all").stdout
    assert "of-other-boards" in log.read_text() and "alone" not in log.read_text()
    log.unlink()
    done = setup(checkout, 0, "dev")
    assert "installing 4 Debian packages" in done.stdout
    assert "alone" in log.read_text() and "--require-hashes --requirement tools/python-packages.txt" in log.read_text()
    # The environment that has all is not made anew for a use that needs less.
    log.unlink()
    setup(checkout, 0)
    setup(checkout, 0, "dev")
    assert "pip" not in log.read_text()


def test_packages_that_are_pinned_anew_are_installed_anew(checkout: Path) -> None:
    """In an environment without those of before."""
    setup(checkout, 0, "dev")
    (checkout / "tools/python-packages.txt").write_text("a-package==2 --hash=sha256:0\n")
    done = setup(checkout, 0, "dev")
    assert "making the Python environment" in done.stdout
    assert done.returncode == 1 and "--require-hashes" in (checkout / "build/setup.log").read_text()  # the real pip


def test_a_copy_of_the_project_gives_way_to_the_checkout(checkout: Path) -> None:
    """`pip install .` puts the copy there. What is installed is compiled, too."""
    (installed,) = packages_of(checkout).glob("*.dist-info")
    shutil.rmtree(installed)
    project = checkout / "copied"
    project.mkdir()
    (project / "pyproject.toml").write_text('[project]\nname = "meta-rt-tests"\nversion = "1"\n')
    (project / "module.py").touch()
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-compile"]
    subprocess.run([*pip, "--target", packages_of(checkout), project], check=True, capture_output=True)
    assert "into .venv" in setup(checkout, 0).stdout
    assert "--editable ." in (checkout / "build/setup.log").read_text()
    assert list(packages_of(checkout).glob("__pycache__/module.*.pyc"))


def test_the_pinned_packages_are_within_the_ranges() -> None:
    """Of every package that pyproject.toml names there is one that this Python takes."""
    project = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]
    pinned = {}
    for line in re.findall(r"^[a-z].*?(?= \\$)", (TOP / "tools/python-packages.txt").read_text(), re.M):
        pin = Requirement(line)
        if pin.marker is None or pin.marker.evaluate():
            pinned[canonicalize_name(pin.name)] = str(pin.specifier).removeprefix("==")
    for line in [*project["dependencies"], *project["optional-dependencies"]["dev"]]:
        asked = Requirement(line)
        assert asked.specifier.contains(pinned[canonicalize_name(asked.name)]), f"{line}: run make lock"


def test_an_unknown_argument_is_refused(checkout: Path) -> None:
    done = setup(checkout, 0, "test")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "usage: tools/setup [quick|all|dev]\n")
