"""The order of rtgen's modules, from the imports: none imports a later one."""

import pytest

import rtgen
from rooms import find_late_imports, modules_of_rooms

ROOMS = (
    "checkout",
    "process",
    "debian",
    "profile",
    "doctor",
    "flash",
    "kconfig",
    "kernel",
    "board",
    "suites",
    "layer",
    "commands",
    "cli",
)


def test_every_module_stands_in_a_room() -> None:
    assert modules_of_rooms(rtgen).keys() == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_imports_a_later_one(room: str) -> None:
    assert find_late_imports(rtgen, ROOMS, room) == []
