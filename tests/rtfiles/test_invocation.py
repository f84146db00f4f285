"""The commands that messages name are written as the user has to write them."""

import os
from pathlib import Path

import pytest

from rtfiles.invocation import as_called


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment with both programs, of which rtrun runs; the shell does not find them by their names."""
    for name in ("rtrun", "rtgen"):
        path = tmp_path / ".venv/bin" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.setattr("sys.argv", [".venv/bin/rtrun", "plan"])
    return tmp_path / ".venv/bin"


def test_a_program_the_shell_does_not_find_has_its_path(programs: Path) -> None:
    assert as_called("rtrun") == ".venv/bin/rtrun"
    assert as_called("rtgen") == ".venv/bin/rtgen"


def test_a_program_the_shell_finds_has_its_name(programs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    assert as_called("rtrun") == "rtrun"


def test_another_program_of_the_name_does_not_count(programs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = programs / "other"
    other.mkdir()
    (other / "rtrun").touch(0o755)
    monkeypatch.setenv("PATH", f"{other}:{os.environ['PATH']}")
    assert as_called("rtrun") == ".venv/bin/rtrun"


def test_without_installed_programs_it_is_the_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.argv", [str(tmp_path / "cli.py")])
    assert as_called("rtrun") == "rtrun"
