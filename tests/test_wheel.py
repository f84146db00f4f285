"""Every command of both programs, installed from the built wheel where nothing of the checkout is in reach.

All works there but what writes into the repository, which says in one line that it needs a checkout.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest
from report.campaigns import write_campaign

import rtgen.cli
import rtrun.cli
from logs import LOGS_2014
from rtfiles.command import called_as
from rtfiles.start import commands_of

TOP = Path(__file__).parents[1]
VERSION = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]["version"]
CHECKOUT = "rtgen: this writes into a checkout of meta-rt-tests, and here is the Python package alone\n"
CAMPAIGN = "schema: 1\nname: test\nruns: [{suite: cyclic_timer_tests, frequency_hz: 100, repetitions: 100}]\n"
# Nothing listens on the discard port of loopback.
TARGET = "schema: 1\nname: none\nkind: ssh\nhost: 127.0.0.1\nport: 9\nuser: root\nhost_key: SHA256:" + "A" * 43 + "\n"

# Arguments, exit status, and words on standard output or standard error.
COMMANDS = [
    ("rtgen --help", 0, "Generate images"),
    ("rtgen --version", 0, f"rtgen {VERSION}\n"),
    ("rtgen profiles", 0, "scarthgap-noetic"),
    ("rtgen new-profile mine.yml", 0, "mine.yml: a copy of"),
    ("rtgen doctor missing", 2, "missing: not a folder"),  # what it says of a folder is up to the host
    ("rtgen explain", 0, "release: scarthgap"),
    ("rtgen render", 2, CHECKOUT),
    ("rtgen render --check", 2, CHECKOUT),
    ("rtgen render --output out", 0, "out/recipes-tests: now a link to"),
    ("rtgen kconfig render", 2, CHECKOUT),
    ("rtgen kconfig render --check", 2, CHECKOUT),
    ("rtgen kconfig verify --config /dev/null --machine none", 2, "unknown machine 'none'"),
    ("rtgen kernel build --machine none", 2, "none"),
    ("rtgen suites build", 0, "build/suites/host"),
    ("rtgen board build", 0, "build/board/qemu-armv7"),
    ("rtgen flash --image none.wic --device /dev/null", 2, "none.wic: No such file"),
    ("rtrun --help", 0, "Measure"),
    ("rtrun --version", 0, f"rtrun {VERSION}\n"),
    ("rtrun --print-completion bash", 0, "complete "),
    ("rtrun plan campaign.yml", 0, "1 runs"),
    ("rtrun plan demo", 0, "10 runs"),
    ("rtrun plan campaign.yml --json", 0, '"schema": 1'),
    ("rtrun run campaign.yml --target target.yml --results measured", 3, "127.0.0.1"),
    ("rtrun observe --target target.yml --for 1s --results observed", 3, "127.0.0.1"),
    ("rtrun influence missing.yml --of other_nodes --target target.yml", 2, "missing.yml"),
    ("rtrun quick --deadline 1ms --target root@127.0.0.1 --for 1s", 3, "127.0.0.1"),
    ("rtrun build-suites recipes-tests --target target.yml", 3, "127.0.0.1"),
    ("rtrun new-target --host 127.0.0.1 --port 9 --user root", 3, "root@127.0.0.1:9: cannot connect"),
    ("rtrun probe --target target.yml", 3, "127.0.0.1"),
    ("rtrun check-rt --target target.yml", 3, "127.0.0.1"),
    ("rtrun verify results", 0, "all "),
    ("rtrun verify results", 0, "whole"),
    ("rtrun show results", 0, "oneshot_timer"),
    ("rtrun report results", 0, "report.html"),
    ("rtrun verdict results --deadline 400us", 0, "95 % sure"),
    ("rtrun why results", 0, "No run kept kernel traces"),
    ("rtrun gate results", 1, "failed"),
    ("rtrun compare results results", 0, "NO DIFFERENCE"),
    ("rtrun claims results", 0, "test:"),
    ("rtrun archive add results --to archive", 0, "runs added"),
    ("rtrun history archive", 0, "oneshot_timer"),
    ("rtrun trends archive", 0, "0 changes in 15 courses"),
    (
        "rtrun bisect archive --order order.txt --deadline 1ms",
        2,
        "order.txt: 1 line, but no commit of a run in ",
    ),
    ("rtrun site archive --output site", 0, "site/index.html"),
    ("rtrun farm --target missing.yml", 2, "missing.yml: No such file"),
    ("rtrun notify missing.yml archive", 2, "missing.yml: No such file"),
    ("rtrun import 2014.log --results imported --platform hardware", 0, "imported/"),
]


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs that pip installed from the wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    ignored = shutil.ignore_patterns("__pycache__", "*.egg-info", "build")
    for name in ("tools", "runner", "recipes-tests", "kconfig", "campaigns"):
        shutil.copytree(TOP / name, source / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(TOP / name, source)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    build = [*pip, "wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", str(folder), str(source)]
    subprocess.run(build, check=True, capture_output=True)
    shutil.rmtree(source)
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "venv", symlinks=True)
    python = folder / "venv/bin/python"
    install = [*pip, "--python", str(python), "install", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    # The dependencies are those of this environment. Python reads the .pth files of its own folder alone, so the
    # checkout that is installed in this environment stays out.
    (own,) = (folder / "venv").glob("lib/python*/site-packages")
    (own / "dependencies.pth").write_text(f"{sysconfig.get_paths()['purelib']}\n")
    return folder / "venv/bin"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("work")
    (folder / "campaign.yml").write_text(CAMPAIGN)
    (folder / "target.yml").write_text(TARGET)
    (folder / "order.txt").write_text("c0ffee\n")
    write_campaign(folder / "results", n=500)
    name = "oneshot_timer_tests_l50_tm2000-measured.log"
    shutil.copy(LOGS_2014 / name, folder / "2014.log")
    return folder


@pytest.mark.parametrize(("command", "status", "words"), COMMANDS, ids=[command for command, _, _ in COMMANDS])
def test_command(programs: Path, folder: Path, command: str, status: int, words: str) -> None:
    program, *arguments = command.split()
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [programs / program, *arguments],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stdout + done.stderr
    assert words in done.stdout + done.stderr
    if status == 2:
        assert done.stderr.count("\n") == 1


def test_every_command_is_here() -> None:
    given = {tuple(command.split()[:2]) for command, _, _ in COMMANDS}
    for program, cli in (("rtgen", rtgen.cli), ("rtrun", rtrun.cli)):
        assert {(program, called_as(command.__name__)) for command in commands_of(program, cli.COMMANDS)} <= given
