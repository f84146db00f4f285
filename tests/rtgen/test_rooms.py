"""The order of rtgen's modules, from the imports, wherever in a module they stand: none imports a later one."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import rtgen

TOP = Path(rtgen.__file__).parent
ROOMS = (
    "checkout",
    "process",
    "debian",
    "profile",
    "flash",
    "kconfig",
    "kernel",
    "board",
    "suites",
    "layer",
    "commands",
    "cli",
)


def imported_rooms(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        yield from (name.split(".")[1] for name in names if name.startswith("rtgen."))


def room_of(path: Path) -> str:
    return path.relative_to(TOP).parts[0].removesuffix(".py")


def test_every_module_stands_in_a_room() -> None:
    assert {room_of(path) for path in TOP.rglob("*.py") if path != TOP / "__init__.py"} == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_imports_a_later_one(room: str) -> None:
    allowed = ROOMS[: ROOMS.index(room) + 1]
    modules = [path for path in TOP.rglob("*.py") if room_of(path) == room]
    assert not {f"{path}: {name}" for path in modules for name in imported_rooms(path) if name not in allowed}
