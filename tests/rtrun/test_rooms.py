"""The order of the runner's rooms, from the imports: no room imports a later one."""

import ast
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import rtfiles
import rtgen
import rtrun
from rooms import find_late_imports, imports, modules_of_rooms
from rtrun.plan.suites import suites

# docs/house.md names them in this order.
ROOMS = (
    "kinds", "plan", "targets", "analysis", "probes", "results", "evidence", "validity", "causes", "flows", "execution",
    "judgement", "report", "thesis", "archive", "on_target", "commands", "cli",
)  # fmt: skip


def test_every_module_stands_in_a_room():
    assert modules_of_rooms(rtrun).keys() == set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_imports_a_later_one(room):
    assert find_late_imports(rtrun, ROOMS, room) == []


def test_no_module_imports_itself_by_way_of_others():
    imported = imports(rtrun)
    assert "rtrun.kinds.values" in imported["rtrun.kinds.rows"]
    TopologicalSorter(imported).prepare()
    with pytest.raises(CycleError):
        TopologicalSorter(imported | {"rtrun.kinds.values": {"rtrun.kinds.rows"}}).prepare()


def test_no_module_asks_for_a_suite_or_a_kind_by_its_name():
    """They ask the kind; plan/ alone, which reads suites.yml, knows which names there are."""
    names = {*suites().suites, "oneshot", "cyclic"}
    rooms = modules_of_rooms(rtrun)
    modules = [path for room in ROOMS if room not in ("plan", "kinds") for path in rooms[room]]
    texts = [(path, node) for path in modules for node in ast.walk(ast.parse(path.read_text()))]
    assert [(path, node.value) for path, node in texts if isinstance(node, ast.Constant) and node.value in names] == []


def test_an_import_of_a_later_room_is_found():
    assert find_late_imports(rtrun, tuple(reversed(ROOMS)), "commands")


def test_a_class_name_stands_once():
    """In all of the runner and the tools: one word for one thing."""
    paths = [path for top in (rtrun, rtgen, rtfiles) for path in Path(str(top.__file__)).parent.rglob("*.py")]
    nodes = [node for path in paths for node in ast.walk(ast.parse(path.read_text()))]
    names = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    assert names["Group"] == 1 and [name for name, count in names.items() if count > 1] == []
