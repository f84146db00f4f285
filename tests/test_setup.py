"""tools/setup: what apt prints stays in a log unless it fails."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

TOP = Path(__file__).parents[1]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout that lacks a Debian package and has its Python environment."""
    (tmp_path / "tools").mkdir()
    shutil.copy(TOP / "tools/setup", tmp_path / "tools")
    (tmp_path / "tools/apt-packages.txt").write_text("no-such-package-of-the-tests\n")
    (tmp_path / "tools/apt-packages-all.txt").write_text("no-such-package-of-other-boards\n")
    (tmp_path / "tools/apt-packages-dev.txt").write_text("no-such-package-for-tests-alone\n")
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / ".venv").mkdir()
    inputs = subprocess.run(
        ["sh", "-c", "sha256sum pyproject.toml; pwd"], cwd=tmp_path, check=True, capture_output=True
    )
    (tmp_path / ".venv/.installed").write_bytes(inputs.stdout)
    return tmp_path


def setup(checkout: Path, status_of_install: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run it where apt-get prints and ends as told, and the user is root or may become it."""
    programs = checkout / "programs"
    programs.mkdir(exist_ok=True)
    for name, text in (
        ("apt-get", f'echo "noise of $*"; [ $1 = update ] || exit {status_of_install}'),
        ("sudo", 'exec "$@"'),
    ):
        (programs / name).write_text(f"#!/bin/sh\n{text}\n")
        (programs / name).chmod(0o755)
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
        r"reading Debian's package lists \.\.\. \d+ s\ninstalling 1 Debian packages \.\.\. \d+ s\n", done.stdout
    )
    assert "noise of install" in (checkout / "build/setup.log").read_text()


def test_a_step_that_fails_shows_the_end_of_the_log(checkout: Path) -> None:
    done = setup(checkout, 100)
    assert done.returncode == 100
    assert re.search(r"installing 1 Debian packages \.\.\. failed after \d+ s\n$", done.stdout)
    assert re.search("^noise of install", done.stderr, re.M)
    assert done.stderr.endswith("exit status 100; all of its output is in build/setup.log\n")


def test_only_dev_installs_what_the_tests_alone_need(checkout: Path) -> None:
    log = checkout / "build/setup.log"
    pip = checkout / ".venv/bin/pip"
    pip.parent.mkdir()
    pip.write_text('#!/bin/sh\necho "pip $*"\n')
    pip.chmod(0o755)
    assert setup(checkout, 0).returncode == 0
    assert "alone" not in log.read_text() and "pip" not in log.read_text()
    log.unlink()
    assert "installing 2 Debian packages" in setup(checkout, 0, "all").stdout
    assert "of-other-boards" in log.read_text() and "alone" not in log.read_text()
    log.unlink()
    done = setup(checkout, 0, "dev")
    assert "installing 3 Debian packages" in done.stdout
    assert "alone" in log.read_text() and ".[dev]" in log.read_text()
    # The environment that has all is not made anew for a use that needs less.
    log.unlink()
    setup(checkout, 0)
    setup(checkout, 0, "dev")
    assert "pip" not in log.read_text()


def test_an_unknown_argument_is_refused(checkout: Path) -> None:
    done = setup(checkout, 0, "test")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "usage: tools/setup [all|dev]\n")
