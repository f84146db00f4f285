"""The commands that README.md and docs/ show: the real parsers take all of them, and those that can run here do.

A command is an indented line, or a part of a sentence in backquotes, that begins with rtgen, rtrun or make. Those in
fenced blocks are for other tests.
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

import rtgen.cli
import rtrun.cli
from logs import LOGS_2014
from rtfiles.command import parser_of
from rtfiles.config import read_yaml
from rtfiles.start import commands_of
from rtrun.targets.config import read_target

TOP = Path(__file__).parents[1]
PAGES = [TOP / "README.md", *sorted((TOP / "docs").glob("*.md"))]
RUN_HERE = [page for page in PAGES if page.name != "tutorial.md"]  # tests/test_tutorial.py
COMMANDS = {name: commands_of(name, cli.COMMANDS) for name, cli in (("rtgen", rtgen.cli), ("rtrun", rtrun.cli))}

# Commands that are only parsed here, and why.
NOT_RUN = {
    "rtgen board build": "minutes; tests/rtgen/test_board_build.py",
    "rtgen suites build": "minutes; tests/suites, tests/integration/test_boards.py",
    "rtgen doctor": "its answer is that of the host; tests/rtgen/test_doctor.py",
    "rtgen flash": "writes to a card; tests/rtgen/test_flash.py",
    "rtgen kconfig verify": "a kernel tree; tests/rtgen/test_kconfig_verify.py",
    "rtgen kernel build": "minutes; tests/rtgen/test_kernel_build.py",
    "rtrun bisect": "an archive of several commits; tests/rtrun/archive/test_trends.py",
    "rtrun check-rt": "a target; tests/rtrun/targets/test_rt_readiness.py",
    "rtrun probe": "a target; tests/integration",
    "rtrun run": "a target; tests/integration",
    "rtrun observe": "programs that run already; tests/suites/test_observe.py",
    "rtrun quick": "a minute; tests/suites/test_quick.py",
    "rtrun new-target": "a board; tests/rtrun/commands/test_new_target.py",
    "rtrun compare RESULTS --by kernel": "results on two kernels; tests/rtrun/judgement/test_sides.py",
    "rtrun compare RESULTS --by middleware": "results through two; tests/suites/test_ros2.py",
    "rtrun compare RESULTS --by trace": "results with traces; tests/rtrun/report/test_tracing_cost.py",
    "rtrun why": "results with traces; tests/rtrun/commands/test_why.py",
}
LOG = "oneshot_timer_tests_l50_tm2000-measured.log"  # the name of a log of 2014 says what was measured
FAILED_GATE = ("rtrun gate",)  # the results that the tests make up prove nothing


def commands(page: Path) -> Iterator[str]:
    """The commands of a page in the order in which they stand there, without the remark that follows some."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S)
    for line in text.splitlines():
        if line.startswith("    "):
            command = re.split(r"\s{2,}|\s#", line.strip())[0].removeprefix("$ ").removeprefix(".venv/bin/")
            if command.partition(" ")[0] in COMMANDS:
                yield command
        else:
            for command in re.findall(r"`(?:\.venv/bin/)?((?:rtgen|rtrun) [^`]+)`", line):
                program, name, *rest = command.split()
                if rest and any(name == each.NAME for each in COMMANDS[program]):
                    yield command


def arguments(command: str) -> list[str]:
    """The words of a command; of what is optional all, of alternatives the first."""
    plain = re.sub(r"\[([^]|]*)(\|[^]]*)?\]", r"\1", command).replace("...", "")
    return shlex.split(plain.replace("import FILE", f"import {LOG}"))


ALL = [(page, command) for page in PAGES for command in commands(page)]


@pytest.mark.parametrize(("page", "command"), ALL, ids=[f"{page.name}:{command}" for page, command in ALL])
def test_the_parser_takes_it(page: Path, command: str) -> None:
    program, *words = arguments(command)
    parser_of(program, "", COMMANDS[program]).parse_args(words)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the checkout with the files that the pages take for granted."""
    folder = tmp_path_factory.mktemp("docs") / "checkout"
    ignored = shutil.ignore_patterns("__pycache__")
    for name in ("tools", "runner", "kconfig", "recipes-tests", "meta-rt-tests", "campaigns", "targets"):
        shutil.copytree(TOP / name, folder / name, symlinks=True, ignore=ignored)
    shutil.copy(TOP / "kas.yml", folder)
    for name in ("results/demo", "results/local", "results/before", "results/after", "RESULTS", "A", "B"):
        write_campaign(folder / name, n=500)
    goal = (TOP / "README.md").read_text().partition("and no longer:\n")[2].partition("`rtrun plan CAMPAIGN.yml")[0]
    (folder / "CAMPAIGN.yml").write_text(f"schema: 1\nname: goal\n{textwrap.dedent(goal)}")
    for name in ("X.log", LOG):
        shutil.copy(LOGS_2014 / LOG, folder / name)
    return folder


@pytest.mark.parametrize("page", RUN_HERE, ids=[page.name for page in RUN_HERE])
def test_what_can_run_here_runs(page: Path, copy: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": f"{copy / 'tools'}:{copy / 'runner'}"}
    for command in dict.fromkeys(commands(page)):
        if command.startswith(tuple(NOT_RUN)):
            continue
        program, *words = arguments(command)
        done = subprocess.run(
            [sys.executable, "-m", f"{program}.cli", *words],
            cwd=copy, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
        )  # fmt: skip
        expected = (0, 1) if command.startswith(FAILED_GATE) else (0,)
        assert done.returncode in expected, f"{command}\n{done.stdout}{done.stderr}"


def test_every_reason_not_to_run_is_needed() -> None:
    assert all(any(command.startswith(prefix) for _, command in ALL) for prefix in NOT_RUN)


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_make_has_the_targets(page: Path) -> None:
    targets = set(re.findall(r"^([a-z0-9-]+):", (TOP / "Makefile").read_text(), re.M))
    shown = re.findall(r"(?:^    (?:\$ )?|`)make ([a-z0-9-]+)", page.read_text(), re.M)
    assert set(shown) <= targets


def test_the_target_file_of_the_readme(tmp_path: Path) -> None:
    text = (TOP / "README.md").read_text()
    block = text.partition("what the board lacks. The file:\n")[2].partition("\nthen\n")[0]
    file = tmp_path / "my-board.yml"
    (tmp_path / "build/suites/qemu-armv7").mkdir(parents=True)
    file.write_text(block.replace("    ", "", 1).replace("\n    ", "\n").replace("SHA256:...", "SHA256:" + "A" * 43))
    assert read_target(file).name == read_yaml(file)["name"] == yaml.safe_load(block)["name"]


def test_pages_link_to_what_is_there() -> None:
    for page in PAGES:
        for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
