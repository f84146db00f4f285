"""The commands of docs/tutorial.md, run on a board behind a real sshd; output that is always the same is compared.

The rehearsal board is that of tests/integration: here its results are made up, and tools/demo is tests/test_demo.py.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from report.campaigns import write_campaign

from conftest import Sshd
from pages import TOP, file_of

pytestmark = [pytest.mark.sshd, pytest.mark.ros, pytest.mark.timeout(600)]

PAGE = TOP / "docs/tutorial.md"
TUTORIAL = PAGE.read_text()
OURS = (".venv/bin/rtrun", ".venv/bin/rtgen")
# The lines, or beginnings of lines, that are the same on every board; of commands that are not here, none.
SAME = {
    "suites": r".+",
    "plan": r".+",
    "probe": r"\S.*?(?=  )",
    "run": r"asked: .*|next: .*",
    "verdict": r"asked: .*",
}
ENDS_WITH_1 = ("check-rt", "gate")  # where the answer is no


def steps() -> Iterator[tuple[str, list[str]]]:
    """Every command of the page, and the lines that the page shows below it."""
    for block in re.findall(r"(?:^    .*\n(?:\n(?=    ))?)+", TUTORIAL, re.M):
        for step in re.split(r"^\$ ", textwrap.dedent(block), flags=re.M)[1:]:
            command, *lines = step.splitlines()
            yield command, [line.rstrip() for line in lines]


@pytest.fixture
def checkout(tmp_path: Path, sshd: Sshd, ros_master: int) -> Path:
    """A checkout with its programs, the reader's two files, and results of the rehearsal board."""
    (tmp_path / ".venv/bin").mkdir(parents=True)
    for program in OURS:
        (tmp_path / program).symlink_to(Path(sys.executable).with_name(Path(program).name))
    write_campaign(tmp_path / "results/demo", n=500)
    address = sshd.address
    target = yaml.safe_load(file_of(PAGE, "my-board.yml")) | {
        "host": address.host,
        "port": address.port,
        "user": address.user,
        "key": str(address.key),
        "host_key": address.host_key,
        "work_dir": str(tmp_path / "target"),
        "ros_master_port": ros_master,
    }
    (tmp_path / "my-board.yml").write_text(yaml.safe_dump(target))
    (tmp_path / "brakes.yml").write_text(file_of(PAGE, "brakes.yml"))
    return tmp_path


def same(command: str, lines: list[str]) -> list[str]:
    pattern = SAME.get(command, "(?!)")
    return [match[0] for line in lines if (match := re.match(pattern, line.rstrip()))]


@pytest.mark.root
def test_its_commands_run_and_print_what_it_shows(checkout: Path) -> None:
    environment = os.environ | {"PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"}  # the programs have their paths
    ran = []
    for command, shown in steps():
        words = shlex.split(command, comments=True)
        if words[0] not in OURS:
            continue
        if words[1] == "run":
            limit_time(checkout / "brakes.yml")
        done = subprocess.run(words, cwd=checkout, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode in ((0, 1) if words[1] in ENDS_WITH_1 else (0,)), (
            f"{command}\n{done.stdout}{done.stderr}"
        )
        if shown:
            assert same(words[1], done.stdout.splitlines()) == same(words[1], shown), command
        ran.append(words[1])
    assert {"suites", "probe", "check-rt", "plan", "run", "verdict", "report", "gate", "show"} == set(ran)
    assert (checkout / "results/brakes/report.html").is_file()


def limit_time(campaign: Path) -> None:
    """Leave a slow machine time for its first round, and let no answer take for ever."""
    text = campaign.read_text()
    assert text.count("at_most: 30s") == 1
    campaign.write_text(text.replace("at_most: 30s", "at_most: 60s"))


def test_its_other_commands_are_there() -> None:
    programs = {shlex.split(command, comments=True)[0] for command, _ in steps()} - set(OURS)
    assert programs == {"git", "cd", "tools/demo", "ssh-copy-id", "ssh-keygen"}
    assert shutil.which("ssh-copy-id") and shutil.which("ssh-keygen")
