"""The order of the runner's rooms, from the imports: no room imports a later one."""

import pytest

import rtrun
from rooms import find_late_imports, modules_of_rooms

# docs/house.md names them in this order.
ROOMS = (
    "plan", "targets", "analysis", "kinds", "results", "validity", "causes", "execution", "judgement", "report",
    "archive", "commands", "cli",
)  # fmt: skip


def test_every_module_stands_in_a_room():
    assert modules_of_rooms(rtrun).keys() == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_imports_a_later_one(room):
    assert find_late_imports(rtrun, ROOMS, room) == []


def test_an_import_of_a_later_room_is_found():
    assert find_late_imports(rtrun, tuple(reversed(ROOMS)), "commands")
