"""The commands that README.md and docs/ show: the real parsers take all of them, and those that can run here do.

And the site of docs/: what `make docs` refuses.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from report.campaigns import write_campaign

from logs import LOGS_2014
from pages import COMMANDS, PAGES, TOP, commands, file_of, name_of
from rtfiles.command import called_as, parser_of

# Those of tests/test_tutorial.py and tests/suites/test_start_pages.py run there.
RUN_THERE = ("docs/tutorial.md", *(f"docs/start/{name}.md" for name in ("board", "control", "images", "lab", "nodes")))
RUN_HERE = [page for page in PAGES if name_of(page) not in RUN_THERE]

# Commands that are only parsed here, and why.
NOT_RUN = {
    "rtgen board build": "minutes; tests/rtgen/test_board_build.py",
    "rtgen suites build": "minutes; tests/suites, tests/integration/test_boards.py",
    "rtgen doctor": "its answer is that of the host; tests/rtgen/test_doctor.py",
    "rtgen flash": "writes to a card; tests/rtgen/test_flash.py",
    "rtgen kconfig verify": "a kernel tree; tests/rtgen/test_kconfig_verify.py",
    "rtgen kernel build": "minutes; tests/rtgen/test_kernel_build.py",
    "rtrun archive annotate ARCHIVE --": "runs that it has; tests/rtrun/archive/test_notes.py",
    "rtrun import lab": "files of years; tests/rtrun/archive/test_others.py",
    "rtrun archive add results/lab": "these",
    "rtrun archive compact archive": "these",
    "rtrun history archive": "these",
    "rtrun trends archive": "these",
    "rtrun site archive": "these",
    "rtrun bisect": "an archive of several commits; tests/rtrun/archive/test_trends.py",
    "rtrun check-rt": "a target; tests/rtrun/targets/test_rt_readiness.py",
    "rtrun farm": "a labgrid coordinator; tests/rtrun/targets/labgrid",
    "rtrun notify": "receivers; tests/rtrun/archive/test_notify.py",
    "rtrun probe": "a target; tests/integration",
    "rtrun run": "a target; tests/integration",
    "rtrun observe": "programs that run already; tests/suites/test_observe.py",
    "rtrun influence": "minutes; tests/suites/test_topology.py",
    "rtrun quick": "a minute; tests/suites/test_quick.py",
    "rtrun new-target": "a board; tests/rtrun/commands/test_new_target.py",
    "rtrun compare RESULTS --by kernel": "results on two kernels; tests/rtrun/judgement/test_sides.py",
    "rtrun compare RESULTS --by middleware": "results through two; tests/suites/test_ros2.py",
    "rtrun compare --with-last": "results of two days; tests/rtrun/commands/test_latest.py",
    "rtrun compare RESULTS --with-last": "these",
    "rtrun compare RESULTS --by trace": "results with traces; tests/rtrun/report/test_tracing_cost.py",
    "rtrun why": "results with traces; tests/rtrun/commands/test_why.py",
}
LOG = "oneshot_timer_tests_l50_tm2000-measured.log"  # the name of a log of 2014 says what was measured
MAKEFILE = (TOP / "Makefile").read_text()
FAILED_GATE = ("rtrun gate",)  # the results that the tests make up prove nothing


def arguments(command: str) -> list[str]:
    """The words of a command; of what is optional all, of alternatives the first."""
    plain = re.sub(r"\[([^]|]*)(\|[^]]*)?\]", r"\1", command).replace("...", "")
    return shlex.split(plain.replace("import FILE", f"import {LOG}"))


ALL = [(page, command) for page in PAGES for command in commands(page)]


@pytest.mark.parametrize(("page", "command"), ALL, ids=[f"{name_of(page)}:{command}" for page, command in ALL])
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
    for name in (
        "results/demo",
        "results/smoke",
        "results/before",
        "results/after",
        "RESULTS",
        "A",
        "B",
    ):
        write_campaign(folder / name, n=500)
    (folder / "CAMPAIGN.yml").write_text(file_of(TOP / "docs/start/board.md", "brakes.yml"))
    for name in ("X.log", LOG):
        shutil.copy(LOGS_2014 / LOG, folder / name)
    return folder


@pytest.mark.parametrize("page", RUN_HERE, ids=map(name_of, RUN_HERE))
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


@pytest.mark.parametrize("page", PAGES, ids=map(name_of, PAGES))
def test_make_has_the_targets(page: Path) -> None:
    targets = set(re.findall(r"^([a-z0-9-]+):", MAKEFILE, re.M))
    shown = re.findall(r"(?:^    (?:\$ )?|`)make ([a-z0-9-]+)", page.read_text(), re.M)
    assert set(shown) <= targets


def test_every_command_stands_on_the_page_of_commands() -> None:
    text = (TOP / "docs/commands.md").read_text()
    names = [f"{program} {called_as(module.__name__)}" for program, modules in COMMANDS.items() for module in modules]
    assert [name for name in names if not re.search(rf"`{name}[ `]", text)] == []


def test_what_one_begins_with_is_short() -> None:
    most = {TOP / "README.md": 120} | dict.fromkeys((TOP / "docs/start").iterdir(), 80)
    assert [page.name for page, lines in most.items() if len(page.read_text().splitlines()) > lines] == []


def test_long_pages_begin_with_an_index() -> None:
    """Nobody reads them from the top. The site build checks that the links lead somewhere."""
    for page in PAGES:
        if len(lines := page.read_text().splitlines()) > 250:
            links = re.findall(r"\]\(#[^)]+\)", page.read_text().split("\n\n")[1])
            assert len(links) == sum(line.startswith("## ") for line in lines), page.name


def test_the_readme_links_to_what_is_there() -> None:
    """The links of the other pages are those of the site: `make docs`."""
    for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", (TOP / "README.md").read_text()):
        assert (TOP / link).exists(), link


@pytest.mark.parametrize(
    ("line", "refused"),
    [
        ("[a page](index.md), [a heading](index.md#the-pages)", None),
        ("[a page](none.md)", "'none.md'"),
        ("[a heading](index.md#none)", "'none'"),
        ("![a picture](none.png)", "none.png"),
    ],
)
def test_the_site_is_built_only_with_links_that_lead_somewhere(tmp_path: Path, line: str, refused: str | None) -> None:
    words = shlex.split(re.search(r"^\t\$\(BIN\)/(sphinx-build .+) docs build/docs$", MAKEFILE, re.M)[1])  # type: ignore[index]
    assert "lint: docs\n" in MAKEFILE
    for name in ("conf.py", "site.css"):
        shutil.copy(TOP / "docs" / name, tmp_path)
    (tmp_path / "index.md").write_text(f"# The pages\n\n{line}\n")
    command = [Path(sys.executable).with_name(words[0]), *words[1:], ".", "built"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (refused is None), done.stderr
    assert (refused or "") in done.stderr
