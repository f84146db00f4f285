"""tools/quick, tools/test and .ci/run: each does its set-up first, and `make` is no more than another name of it.

What they call is a stand-in that notes how it was called. tests/test_demo.py and tests/test_setup.py have the others.
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

TOP = Path(__file__).parents[1]
NOTE = '#!/bin/sh\necho "${0##*/}${*:+ $*}" >>calls\necho "${0##*/} prints"\n[ "${0##*/}" != "$FAILS" ]\n'
SUMMARY = "=== 3 passed in 0.01s ==="


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout whose set-up, programs and tests are stand-ins."""
    for folder in ("tools", ".ci", ".venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("Makefile", "tools/quick", "tools/test", "tools/step.sh", ".ci/run"):
        shutil.copy(TOP / name, tmp_path / name)
    for name in ("tools/rtfiles", "runner"):
        (tmp_path / name).symlink_to(TOP / name)
    for name in ("tools/setup", *(f".venv/bin/{name}" for name in ("rtgen", "rtrun", "python", "sphinx-build"))):
        write_program(tmp_path / name, NOTE)
    for name in ("ruff", "mypy"):
        write_program(tmp_path / ".venv/bin" / name, NOTE)
    write_program(tmp_path / ".venv/bin/pytest", f'{NOTE.replace("prints", "runs")}echo "{SUMMARY}"\n')
    return tmp_path


def write_program(path: Path, script: str) -> None:
    path.write_text(script)
    path.chmod(0o755)


def call(checkout: Path, *words: str, fails: str = "") -> tuple[int, list[str], str, str]:
    """The exit status, the calls of stand-ins, and what was printed."""
    command = ["env", f"FAILS={fails}", *words]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    noted = checkout / "calls"
    return done.returncode, noted.read_text().splitlines() if noted.exists() else [], done.stdout, done.stderr


QUICK = ["setup quick", "rtgen suites build", "rtrun quick --deadline 1ms"]


@pytest.mark.parametrize("words", [["tools/quick", "--deadline", "1ms"], ["make", "--silent", "quick"]])
def test_quick_sets_up_builds_and_measures(checkout: Path, words: list[str]) -> None:
    status, calls, printed, errors = call(checkout, *words)
    assert (status, calls, errors) == (0, QUICK, "")
    assert re.fullmatch(r"setup prints\nbuilding the suites for this machine \.\.\. \d+ s\nrtrun prints\n", printed)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--deadline", "1"], "'1' is no time above 0 with its unit"),
        (["--deadline", "1ms", "--nights", "3"], "unknown arguments --nights 3"),
    ],
)
def test_a_wrong_call_is_refused_before_anything_is_installed(checkout: Path, words: list[str], message: str) -> None:
    status, calls, printed, errors = call(checkout, "tools/quick", *words)
    assert (status, calls, printed) == (2, [], "")
    assert message in errors


def test_help_installs_nothing(checkout: Path) -> None:
    status, calls, printed, errors = call(checkout, "tools/quick", "--help")
    assert (status, calls, errors) == (0, [], "")
    assert "--deadline TIME" in printed


@pytest.mark.parametrize(("fails", "number"), [("setup", 1), ("rtgen", 2), ("rtrun", 3)])
def test_a_step_that_fails_ends_it(checkout: Path, fails: str, number: int) -> None:
    status, calls, _, errors = call(checkout, *QUICK[2].replace("rtrun ", "tools/").split(), fails=fails)
    assert (status, calls) == (1, QUICK[:number])
    assert ("tools/quick: building the suites for this machine: exit status 1" in errors) == (fails == "rtgen")


def test_a_first_answer_installs_nothing_of_tests_and_boards() -> None:
    quick, board, dev = (
        set((TOP / f"tools/apt-packages{name}.txt").read_text().split()) for name in ("-quick", "", "-dev")
    )
    assert not quick & dev
    # What builds for this machine builds for the board, too.
    assert quick & board == {"catkin", "cmake", "ninja-build", "python3-venv", "ros-message-generation"}


COMMON = "--dist loadgroup --no-loadscope-reorder -m not kernel and not slow and not boards and not ros2"
FAST = "-m not kernel and not slow and not boards and not qemu and not ros and not bitbake"


@pytest.mark.parametrize(
    ("words", "end"),
    [
        (["tools/test"], COMMON),
        (["tools/test", "-n", "3", "tests/rtgen"], f"{COMMON} -n 3 tests/rtgen"),
        (["make", "test"], COMMON),
        (["make", "test", "WORKERS=3"], f"{COMMON} -n 3"),
        (["make", "test-fast"], f"{COMMON} {FAST}"),
    ],
)
def test_tests_are_set_up_and_run(checkout: Path, words: list[str], end: str) -> None:
    status, calls, printed, errors = call(checkout, *words)
    assert (status, errors, calls[0], len(calls)) == (0, "", "setup dev", 2)
    assert calls[1].startswith("pytest -n ") and calls[1].endswith(end)
    assert printed == f"setup prints\npytest runs\n{SUMMARY}\n"


def test_ci_checks_the_style_runs_the_tests_and_ends_with_their_summary(checkout: Path) -> None:
    status, calls, printed, errors = call(checkout, ".ci/run")
    assert (status, errors, printed.splitlines()[-1]) == (0, "", SUMMARY)
    assert calls[0] == "setup dev"  # what brings make
    assert {"ruff check .", "mypy"} < set(calls) and calls[-1].startswith("pytest ")


@pytest.mark.parametrize("fails", ["setup", "mypy", "pytest"])
def test_ci_fails_where_a_part_of_it_does(checkout: Path, fails: str) -> None:
    write_program(checkout / ".venv/bin/pytest", NOTE)
    status, calls, _, _ = call(checkout, ".ci/run", fails=fails)
    assert status != 0 and calls[-1].startswith(fails)


def test_the_readme_begins_with_both() -> None:
    first = re.findall(r"^    (.*)$", (TOP / "README.md").read_text(), re.M)[:2]
    assert [line.partition("#")[0].strip() for line in first] == ["tools/quick --deadline 1ms", "tools/test"]
