"""Getting a target ready: scripts and suites are put there, a ROS master answers, and what is missing is said."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from rtrun import deploy, master, probe, suites
from rtrun.campaign import Run
from rtrun.errors import TargetError
from rtrun.link import Link


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A target with everything in place for runs."""

    link: Link
    equipment: probe.Equipment
    scripts: PurePosixPath
    programs: dict[str, str]
    kernel_config: bytes
    own_master: bool


@contextlib.contextmanager
def prepared(link: Link, owner: str, runs: Sequence[Run]) -> Iterator[Prepared]:
    """Put scripts and suites on the target and see to it that a ROS master answers while the context lasts."""
    target = link.target
    equipment = probe.find(link, (deploy.ON_TARGET / "find.sh").read_text(encoding="utf-8"))
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    programs = equipment.programs
    if target.suites is not None:
        tree = deploy.deploy(link, target.suites, "suites")
        programs = {
            program: str(tree / "lib" / suite / program)
            for suite, described in suites.suites().suites.items()
            for program in described.programs
        }
    for run in runs:
        for program in suites.suite(run.suite).programs:
            if program not in programs:
                raise TargetError(
                    f"{target.address}: {program} is not installed on the target: "
                    "name a folder of `rtgen suites build` as suites in the target file"
                )
    priorities = [int(run.parameters["priority"] or 0) for run in runs if run.parameters["policy"] != "0"]
    with master.running(link, scripts, equipment, owner, max(priorities) + 1 if priorities else None) as own_master:
        yield Prepared(
            link=link,
            equipment=equipment,
            scripts=scripts,
            programs=programs,
            kernel_config=probe.kernel_config(link),
            own_master=own_master,
        )
