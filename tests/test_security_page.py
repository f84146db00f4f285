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
NO_LIMITS = {
    "ranges of numbers, which take no room": {
        "rtfiles.untrusted.INT64_MAX",
        *(
            f"rtrun.kinds.limits.{name}"
            for name in ("COUNT_MAX", "RT_PRIORITY_MAX", "MEASURING_PRIORITY_MAX", "EXIT_STATUS_MAX")
        ),
        "rtrun.plan.question.BURSTS_MAX",
        "rtrun.validity.outcome.LISTED_MAX",
    },
    "what is printed or computed at most": {
        "rtrun.analysis.order.recurrence._COUNT_MAX",
        "rtrun.evidence.duplicates._PLACES_MAX",
        "rtfiles.output.WIDTH_MAX",
        "rtrun.archive.alarms.REASON_MAX",
        "rtrun.archive.bins._COUNT_MAX",
        "rtrun.archive.boards._POINTS_MAX",
        "rtrun.archive.receivers.SHOWN_MAX",
        "rtrun.targets.labgrid.health._REASON_MAX",
        "rtrun.targets.labgrid.places._NAMED_MAX",
        "rtrun.archive.bins._GRID_MAX",
        "rtrun.plan.topology.rates._UNIONS_MAX",
        "rtrun.analysis.response_time.STEPS_MAX",
        "rtrun.causes.control.WINDOWS_MAX",
        "rtrun.report.causes.NAMES_MAX",
        "rtrun.report.causes.REMEDIES_MAX",
        "rtrun.validity.requirements.NAMED_MAX",
        "rtrun.results.rate.OFF_MAX",
        "rtrun.flows.timers._PERIOD_OFF_MAX",
        "rtrun.flows.hazards._NAMED_MAX",
        "rtrun.execution.stream_runs._NAME_MAX",
        "rtrun.execution.topology_runs._THREAD_NAME_MAX",
        "rtrun.execution.observation._KERNEL_EVENTS_PER_S",
    },
    "pauses between two attempts, and parts of a time that stands on the page": {
        "rtrun.execution.system.LOOK_S",
        "rtrun.execution.system.POLL_S",
        "rtrun.targets.labgrid.places.POLL_S",
        "rtrun.targets.labgrid.places._SAY_AFTER_S",
        "rtrun.targets.labgrid.watch.WATCH_S",
        "rtrun.targets.link.RETRY_S",
        "rtrun.targets.processes.POLL_S",
        "rtrun.targets.processes.SLICE_S",
        "rtrun.targets.processes.WAIT_S",
        "rtrun.targets.restart.POLL_S",
        "rtrun.targets.shell.POLL_S",
        "rtrun.targets.labgrid.serial_console._READ_S",
        "rtrun.targets.labgrid.serial_console._RETRY_S",
        "rtrun.targets.ssh.ssh_shell.KILL_GRACE_S",
    },
    "times of programs of our own": {
        "rtrun.execution.ros_graph.LOOK_S",
        "rtrun.execution.subjects.suite.DEADLINE_EXTRA_S",
        "rtrun.execution.subjects.observation.OBSERVED_EXTRA_S",
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
                    if is_time or LIMIT.fullmatch(name):
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
