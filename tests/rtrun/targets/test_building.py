"""Builds of the suites on a target: one at a time, whoever started it, and what a dead one left is in nobody's way."""

from pathlib import Path, PurePosixPath

import pytest

from rtrun.plan.program import Program
from rtrun.targets import building, deploy, processes
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link

pytestmark = pytest.mark.sshd
SCRIPTS = PurePosixPath(deploy.ON_TARGET)


def start(link, folder, *words):
    building._start(link, SCRIPTS, folder, Program(name=building.NAME, argv=words, deadline_s=600))


@pytest.fixture
def folders(target):
    return [PurePosixPath(target.work_dir) / "building" / name for name in ("first", "second", "third")]


def test_a_second_build_is_refused_and_the_first_goes_on(link, target, folders, remarks):
    first, second, third = folders
    start(link, first, "sleep", "600")
    with Link(target, remarks.append) as other:
        supervisor = Path(first / "build.pid")
        while not (supervisor.exists() and supervisor.read_text().strip()):
            pass
        how = f"started is going on there: wait for it, or end it there: kill -- -{supervisor.read_text().strip()}$"
        for _ in range(2):
            with pytest.raises(TargetError, match=how):
                start(other, second, "sleep", "600")
            # As the call does that was refused.
            processes.give_up(other, second)
        assert processes.list_ended(link, first, ["build"]) == [] and not Path(second).exists()
        # As after a lost link.
        start(link, first, "sleep", "600")
        processes.end(link, first, "build")
        start(other, third, "sleep", "600")
        assert processes.list_ended(other, third, ["build"]) == []
        processes.give_up(other, third)


def test_a_dead_build_is_in_nobodys_way(link, folders):
    """A killed one is removed; of one that ended its runner may be about to ask how."""
    killed, ended, third = folders
    start(link, killed, "sleep", "600")
    link.check(["touch", str(killed / "half")])
    processes.end(link, killed, "build")
    start(link, ended, "true")
    assert processes.wait(link, ended, "build", deadline_s=60).status == 0
    assert not Path(killed).exists()
    start(link, third, "true")
    assert processes.wait(link, third, "build", deadline_s=60).status == 0
    assert processes.wait(link, ended, "build", deadline_s=60).status == 0
    for folder in folders:
        processes.give_up(link, folder)
