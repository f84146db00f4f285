"""tools/demo: measures, reports, and names commands that the programs take. The board is that of tests/integration."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from rtfiles.command import parser_of
from rtrun.cli import COMMANDS

TOP = Path(__file__).parents[1]
# Notes how it is called; `run` makes the results folder.
RTRUN = """#!/bin/sh
echo "$*" >>calls
[ "$1" != run ] || mkdir -p results/demo
[ "$1" != {fails} ]
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    for folder in ("tools", ".venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(TOP / "tools/demo", tmp_path / "tools")
    return tmp_path


def demo(checkout: Path, *, fails: str = "nothing") -> subprocess.CompletedProcess[str]:
    (checkout / ".venv/bin/rtrun").write_text(RTRUN.format(fails=fails))
    (checkout / ".venv/bin/rtrun").chmod(0o755)
    return subprocess.run([checkout / "tools/demo"], capture_output=True, text=True, check=False)


def test_every_command_that_it_names_is_one(checkout: Path) -> None:
    done = demo(checkout)
    assert (done.returncode, done.stderr) == (0, "")
    named = re.findall(r"\.venv/bin/rtrun (.*?)(?:  .*)?$", done.stdout, re.M)
    assert {command.split()[0] for command in named} == {"run", "report", "show", "verdict"}
    for command in named:
        parser_of("rtrun", "", COMMANDS).parse_args(command.split())
    assert (checkout / "calls").read_text().splitlines() == named[:2]
    assert "results/demo/report.html" in done.stdout


def test_an_earlier_demo_is_kept(checkout: Path) -> None:
    (checkout / "results/demo/001-of-earlier").mkdir(parents=True)
    assert demo(checkout).returncode == 0
    assert not list((checkout / "results/demo").iterdir())
    assert list((checkout / "results").glob("demo-*/001-of-earlier"))


@pytest.mark.parametrize("command", ["run", "report"])
def test_a_command_that_fails_ends_it(checkout: Path, command: str) -> None:
    done = demo(checkout, fails=command)
    assert done.returncode != 0 and "Made:" not in done.stdout
