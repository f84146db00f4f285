"""What the suites share: its GoogleTest programs, each a test here."""

from pathlib import Path

import pytest

from .conftest import UNIT_SOURCE, output_of

PROGRAMS = (
    "options",
    "summary",
    "log",
    "output",
    "oneshot",
    "cyclic",
    "communication",
    "middleware",
    "allocations",
    "blocks",
    "heaps",
    "process",
    "trace",
)


def test_every_program_is_run() -> None:
    assert {f"test_{name}" for name in PROGRAMS} == {path.stem for path in UNIT_SOURCE.glob("test_*.cpp")}


@pytest.mark.parametrize("name", PROGRAMS)
def test_gtest(unit_build: Path, name: str) -> None:
    output = output_of(str(unit_build / f"test_{name}"))
    print(output)
    assert "[  PASSED  ]" in output
