"""Each limit in docs/security.md equals the constant that it names, and each limit of the code stands there."""

import ast
import importlib
import re
from pathlib import Path

import pytest

TOP = Path(__file__).parents[1]
PAGE = TOP / "docs/security.md"
UNITS = {"": 1, "KiB": 2**10, "MiB": 2**20, "s": 1, "bytes/s": 1, "characters": 1}
ROWS = re.findall(r"^\| [^|]+ \| ([0-9]+) ?([A-Za-z/]*) \| `([\w.]+)\.(\w+)` \|$", PAGE.read_text(), re.M)

# By its name a constant is a limit on size or number, and in the rooms that talk to a target also one on time.
LIMIT = re.compile(r"_?MAX_\w+|\w+_MAX|\w*LIMIT_BYTES")
TIME = re.compile(r"\w+_S")
TIMED = ("rtrun.targets.", "rtrun.execution.")
# Pauses between two attempts, parts of a time that stands on the page, and what is printed or counted at most.
NO_LIMIT = re.compile(
    r"_?(POLL|FOLLOW|LOOK|RETRY|WAIT|SLICE|WATCH|READ|SAY_AFTER|KILL_GRACE|DEADLINE_EXTRA|OBSERVED_EXTRA)_S|"
    r"_?(NAME|NAMED|THREAD_NAME|REASON|LISTED|SHOWN|POINTS|PLACES|WIDTH|GRID|COUNT|OFF|PERIOD_OFF)_MAX"
)
NO_LIMITS = {
    "ranges of numbers, which take no room": {
        "rtfiles.untrusted.INT64_MAX",
        "rtrun.kinds.limits.EXIT_STATUS_MAX",
        "rtrun.kinds.limits.MEASURING_PRIORITY_MAX",
        "rtrun.kinds.limits.RT_PRIORITY_MAX",
        "rtrun.plan.question.BURSTS_MAX",
    },
    "what is printed or computed at most": {
        "rtrun.analysis.response_time.STEPS_MAX",
        "rtrun.causes.control.WINDOWS_MAX",
        "rtrun.plan.topology.rates._UNIONS_MAX",
        "rtrun.report.causes.NAMES_MAX",
        "rtrun.report.causes.REMEDIES_MAX",
        "rtrun.execution.observation._KERNEL_EVENTS_PER_S",
    },
    "times of programs of our own": {
        "rtrun.targets.building.BUILD_S",
        "rtrun.targets.building.END_GRACE_S",
        "rtrun.targets.qemu.kvm.DEADLINE_S",
        "rtrun.targets.qemu.emulator.STOP_S",
    },
}


def limits() -> set[str]:
    """The constants of the code that are limits by their names."""
    names = set()
    for package in (TOP / "tools/rtfiles", TOP / "tools/rtgen", TOP / "runner/rtrun"):
        for path in package.rglob("*.py"):
            module = ".".join(path.relative_to(package.parent).with_suffix("").parts)
            for statement in ast.parse(path.read_text()).body:
                if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
                    name = statement.targets[0].id
                    is_time = module.startswith(TIMED) and TIME.fullmatch(name)
                    if (is_time or LIMIT.fullmatch(name)) and not NO_LIMIT.fullmatch(name):
                        names.add(f"{module}.{name}")
    return names


@pytest.mark.parametrize(("number", "unit", "module", "name"), ROWS, ids=[row[3] for row in ROWS])
def test_limit(number: str, unit: str, module: str, name: str) -> None:
    assert getattr(importlib.import_module(module), name) == int(number) * UNITS[unit]


def test_every_row_of_the_table_is_read() -> None:
    assert len(ROWS) == PAGE.read_text().count("\n| ") - 1 > 30


def test_every_limit_of_the_code_stands_on_the_page() -> None:
    on_page = {f"{module}.{name}" for _, _, module, name in ROWS}
    others = set().union(*NO_LIMITS.values())
    assert limits() - on_page == others
