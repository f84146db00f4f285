"""tools/demo: measures, reports, and names commands that the programs take. The board is that of tests/integration."""

import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from rtfiles.command import parser_of
from rtfiles.start import commands_of
from rtgen.board.machine import machines
from rtrun.cli import COMMANDS

TOP = Path(__file__).parents[1]
# Notes how it is called; `run` makes the results folder.
RTRUN = """#!/bin/sh
echo "$*" >>calls
[ "$1" != run ] || { mkdir -p results/demo/001-a results/demo/002-b
    for run in results/demo/*/; do printf '{\\n  "platform_evidence": "by magic",\\n}\\n' >$run/run.json; done; }
[ "$1" != {fails} ]
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    for folder in ("tools", ".venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("tools/setup", ".venv/bin/rtgen"):
        (tmp_path / name).write_text('#!/bin/sh\necho "${0##*/}${*:+ $*}" >>made\n[ "$1" != "${FAILS:-none}" ]\n')
        (tmp_path / name).chmod(0o755)
    shutil.copy(TOP / "tools/demo", tmp_path / "tools")
    shutil.copytree(TOP / "targets", tmp_path / "targets")
    return tmp_path


def demo(
    checkout: Path, *, fails: str = "nothing", kvm_machine: str = "", machine: str = "qemu-armv7"
) -> subprocess.CompletedProcess[str]:
    """Run it; `kvm_machine` is what tools/kvm-machine prints."""
    for name, script in (("rtrun", RTRUN.replace("{fails}", fails)), ("python", f"#!/bin/sh\necho {kvm_machine}\n")):
        (checkout / ".venv/bin" / name).write_text(script)
        (checkout / ".venv/bin" / name).chmod(0o755)
    command = ["env", f"MACHINE={machine}", checkout / "tools/demo"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("machine", "packages"), [("qemu-armv7", "setup"), ("qemu-x86_64", "setup all")])
def test_it_sets_up_and_builds_first(checkout: Path, machine: str, packages: str) -> None:
    assert demo(checkout, machine=machine).returncode == 0
    first, *built = (checkout / "made").read_text().splitlines()
    assert first == packages
    assert sorted(built) == [f"rtgen {what} build --machine {machine}" for what in ("board", "suites")]


@pytest.mark.parametrize("what", ["board", "suites"])
def test_nothing_is_measured_where_a_build_fails(checkout: Path, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    monkeypatch.setenv("FAILS", what)
    assert demo(checkout).returncode != 0
    assert not (checkout / "calls").exists()


def test_every_command_that_it_names_is_one(checkout: Path) -> None:
    done = demo(checkout)
    assert (done.returncode, done.stderr) == (0, "")
    named = re.findall(r"\.venv/bin/rtrun (.*?)(?:  .*)?$", done.stdout, re.M)
    assert {command.split()[0] for command in named} == {"run", "report", "show", "verdict"}
    for command in named:
        parser_of("rtrun", "", commands_of("rtrun", COMMANDS)).parse_args(command.split())
    assert (checkout / "calls").read_text().splitlines() == named[:2]
    assert "results/demo/report.html" in done.stdout
    assert "\nMeasured on qemu-armv7: by magic\n" in done.stdout
    assert "MACHINE=" not in done.stdout


def test_where_kvm_works_it_names_the_machine_with_a_real_clock(checkout: Path) -> None:
    hint = "MACHINE=qemu-x86_64 tools/demo  the same with a real clock"
    assert hint in demo(checkout, kvm_machine="qemu-x86_64").stdout
    assert hint not in demo(checkout, kvm_machine="qemu-x86_64", machine="qemu-x86_64").stdout


@pytest.mark.parametrize("machine", [name for name, machine in machines().items() if machine.qemu is not None])
def test_each_machine_in_qemu_has_a_target_of_its_own(checkout: Path, machine: str) -> None:
    assert demo(checkout, machine=machine).returncode == 0
    (target,) = re.findall(r"--target (\S+)", (checkout / "calls").read_text())
    named = yaml.safe_load((TOP / target).read_text())
    assert (named["kind"], named["name"], Path(named["suites"]).name) == ("qemu", machine, machine)


def test_a_machine_without_a_target_is_a_clear_line(checkout: Path) -> None:
    done = demo(checkout, machine="abacus")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "tools/demo: no file in targets/ has build/board/abacus as its board\n"


@pytest.mark.parametrize(("status", "is_named"), [(0, True), (1, False)])
def test_a_machine_is_named_where_a_guest_ends(tmp_path: Path, status: int, is_named: bool) -> None:
    fitting = {name for name, machine in machines().items() if machine.qemu is not None and machine.qemu.kvm}
    for name in fitting:
        binary = tmp_path / str(machines()[name].qemu.binary)  # type: ignore[union-attr]
        binary.write_text(f"#!/bin/sh\nexit {status}\n")
        binary.chmod(0o755)
    (tmp_path / "kernel").touch()
    command = ["env", f"PATH={tmp_path}:/usr/bin:/bin", sys.executable, TOP / "tools/kvm-machine", tmp_path / "kernel"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    if not is_named or platform.machine() not in ("x86_64", "aarch64"):
        assert done.stdout == ""
    else:
        assert done.stdout.strip() in fitting


def test_an_earlier_demo_is_kept(checkout: Path) -> None:
    (checkout / "results/demo/001-of-earlier").mkdir(parents=True)
    assert demo(checkout).returncode == 0
    assert not (checkout / "results/demo/001-of-earlier").exists()
    assert list((checkout / "results").glob("demo-*/001-of-earlier"))


@pytest.mark.parametrize("command", ["run", "report"])
def test_a_command_that_fails_ends_it(checkout: Path, command: str) -> None:
    done = demo(checkout, fails=command)
    assert done.returncode != 0 and "Made:" not in done.stdout
