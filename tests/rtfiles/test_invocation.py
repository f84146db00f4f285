"""The commands that messages name are written as the user has to write them."""

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from rtfiles.invocation import DISTRIBUTION, as_called, install_extra

TOP = Path(__file__).parents[2]
# The project as an installer takes it from an index: with an extra, or as its argument, on this line or the next.
FROM_INDEX = re.compile(rf"{DISTRIBUTION}\[|\b(?:install|run|add)\s+(?:-\S+\s+)*['\"]?{DISTRIBUTION}\b")


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


def test_an_extra_is_installed_by_the_names_of_its_packages() -> None:
    extras = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    names = re.compile(r"[a-z0-9]+")
    for name in ("archive", "farm", "report", "all"):
        command = install_extra(name)
        assert [names.match(word)[0] for word in command.replace("'", "").split(" install ")[1].split()] == [
            names.match(requirement)[0] for requirement in extras[name]
        ]
        assert DISTRIBUTION not in command.split(" install ")[1]


@pytest.mark.parametrize(
    ("text", "is_from_index"),
    [
        ("pip install 'meta-rt-tests[archive]'", True),
        ("pip install\n'meta-rt-tests[report]'", True),
        ("pipx install meta-rt-tests", True),
        ("uv pip install --upgrade meta-rt-tests", True),
        ("pip install --editable '.[archive]'", False),
        ("git clone ADDRESS meta-rt-tests && cd meta-rt-tests", False),
        ("pip install ./meta-rt-tests", False),
    ],
)
def test_what_counts_as_taken_from_the_index(text: str, is_from_index: bool) -> None:
    assert bool(FROM_INDEX.search(text)) is is_from_index


def test_no_file_takes_the_project_from_the_package_index() -> None:
    """It is not there: whoever registered the name would run code of theirs."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=TOP, check=True, capture_output=True, text=True).stdout
    found = []
    for name in filter(None, listed.split("\0")):
        path = TOP / name
        if path == Path(__file__) or path.is_symlink() or not path.is_file():
            continue
        text = path.read_bytes().decode(errors="replace")
        found += [f"{name}: {match[0]}" for match in FROM_INDEX.finditer(text)]
    assert found == []
