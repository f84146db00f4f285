"""The order of the runner's rooms, from the imports: no room imports a later one."""

import ast
from pathlib import Path

import pytest

import rtrun

RUNNER = Path(rtrun.__file__).parent
# docs/house.md names them in this order.
ROOMS = ("plan", "target", "analysis", "results", "validity", "execution", "report", "commands", "cli")


def imported_rooms(path):
    """The rooms that a module imports from, wherever in the module the import stands."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            package, _, rest = name.partition(".")
            if package == "rtrun" and rest:
                yield rest.partition(".")[0]


def room_of(path):
    return path.relative_to(RUNNER).parts[0].removesuffix(".py")


def test_every_module_stands_in_a_room():
    modules = [path for path in RUNNER.rglob("*.py") if path != RUNNER / "__init__.py"]
    assert {room_of(path) for path in modules} == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_imports_a_later_one(room):
    modules = [path for path in RUNNER.rglob("*.py") if room_of(path) == room]
    allowed = ROOMS[: ROOMS.index(room) + 1]
    later = {f"{path}: {name}" for path in modules for name in imported_rooms(path) if name not in allowed}
    assert not later
