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
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / ".venv").mkdir()
    inputs = subprocess.run(
        ["sh", "-c", "sha256sum pyproject.toml; pwd"], cwd=tmp_path, check=True, capture_output=True
    )
    (tmp_path / ".venv/.installed").write_bytes(inputs.stdout)
    return tmp_path


def setup(checkout: Path, status_of_install: int) -> subprocess.CompletedProcess[str]:
    """Run it where apt-get prints and ends as told, and the user is root or may become it."""
    programs = checkout / "programs"
    programs.mkdir(exist_ok=True)
    for name, text in (
        ("apt-get", f'echo "noise of $1"; [ $1 = update ] || exit {status_of_install}'),
        ("sudo", 'exec "$@"'),
    ):
        (programs / name).write_text(f"#!/bin/sh\n{text}\n")
        (programs / name).chmod(0o755)
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"}
    return subprocess.run(
        [checkout / "tools/setup"],
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
    assert "noise of install\n" in done.stderr
    assert done.stderr.endswith("exit status 100; all of its output is in build/setup.log\n")
