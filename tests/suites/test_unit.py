"""The ROS-free parts of the suites: their GoogleTest programs, each a test here."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent / "unit"
BUILD = Path(__file__).parents[2] / "build" / "suites-unit"
PROGRAMS = ("options", "summary", "log", "output", "oneshot", "cyclic", "communication", "allocations")


def say(*command: str) -> str:
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}"
    return done.stdout


@pytest.fixture(scope="module")
def programs() -> Path:
    """The folder of the compiled tests; what did not change is not compiled again."""
    launcher = ["-DCMAKE_CXX_COMPILER_LAUNCHER=ccache"] if shutil.which("ccache") else []
    say("cmake", "-G", "Ninja", "-S", str(SOURCE), "-B", str(BUILD), *launcher)
    say("ninja", "-C", str(BUILD), "-j", str(min(2, os.cpu_count() or 1)))
    return BUILD


def test_every_program_is_run() -> None:
    assert {f"test_{name}" for name in PROGRAMS} == {path.stem for path in SOURCE.glob("test_*.cpp")}


@pytest.mark.parametrize("name", PROGRAMS)
def test_gtest(programs: Path, name: str) -> None:
    said = say(str(programs / f"test_{name}"))
    print(said)
    assert "[  PASSED  ]" in said
