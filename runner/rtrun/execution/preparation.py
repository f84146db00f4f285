"""Prepare a target: deploy scripts and suites, check its tools, see to it that a ROS master answers."""

import contextlib
import gzip
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from rtfiles.invocation import as_called
from rtrun.plan import conditions, suites
from rtrun.plan.campaign import Variant
from rtrun.plan.run import Run
from rtrun.targets import deploy, ros_master
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.inspection import platform_signs
from rtrun.targets.inspection.platform import KnownPlatform
from rtrun.targets.link import Link

# Both the package of the suites and its program.
SAMPLER = "rt_tests_sampler"


@dataclass(frozen=True, slots=True, kw_only=True)
class Prepared:
    """A target with everything in place for runs."""

    link: Link
    equipment: inspection.Equipment
    platform: KnownPlatform
    scripts: PurePosixPath
    sampler: str
    """The path of what observes the target: the program of the suites, or the script where they have none."""
    programs: dict[str, str]
    kernel_config: bytes
    own_master: bool
    variants: Mapping[str, "Prepared"] = field(default_factory=dict)
    """The same target with the suites and the ROS of each variant, by its name."""

    def for_run(self, run: Run) -> "Prepared":
        """The target with what the run's variant needs."""
        return self.variants.get(run.variant, self)


@contextlib.contextmanager
def prepared(
    link: Link,
    owner: str,
    runs: Sequence[Run],
    may_run_go_on: Callable[[], bool],
    variants: Mapping[str, Variant] | None = None,
) -> Iterator[Prepared]:
    """Deploy scripts and suites, and see to it that a ROS master answers while the context lasts, or a run goes on."""
    target = link.target
    equipment = inspection.inspect(link)
    for folder in filter(None, [target.suites, *(variant.suites for variant in (variants or {}).values())]):
        inspection.check_suites(folder, target, equipment)
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    installed = equipment.programs if target.suites is None else _deploy_suites(link, target.suites)
    # What a runner that was killed left would slow down what is measured next; a trace that is in use stays.
    link.check([str(scripts / "trace.sh"), "down"])
    kernel_config = inspection.read_kernel_config(link)
    tools = _tools(link, scripts, runs, kernel_config)
    programs = {
        name: (_deploy_suites(link, variant.suites) if variant.suites else installed) | tools
        for name, variant in ({"": Variant()} | dict(variants or {})).items()
    }
    # One for all variants: what it costs must not be taken for an effect of one of them.
    samplers = [each[SAMPLER] for each in (*programs.values(), equipment.programs) if SAMPLER in each]
    deploy.prune(link, 1 + len(variants or {}))
    for run in runs:
        for program in (*suites.suite(run.suite).programs, *conditions.suites_programs(run.condition)):
            if program not in programs[run.variant]:
                raise TargetError(
                    f"{target.address}: {program} is not installed on the target: "
                    f"name a folder of {as_called('rtgen')} suites build as suites in the target file"
                )
    priority = _highest_priority(runs)
    master = ros_master.running(link, scripts, equipment, owner, priority + 1 if priority else None, may_run_go_on)
    with master as own_master:
        ready = Prepared(
            link=link,
            equipment=equipment,
            platform=platform_signs.find_platform(link),
            scripts=scripts,
            sampler=samplers[0] if samplers else str(scripts / "sample.sh"),
            programs=programs[""],
            kernel_config=kernel_config,
            own_master=own_master,
        )
        by_name = {
            name: replace(
                ready,
                programs=programs[name],
                equipment=replace(equipment, setup=variant.ros_setup or equipment.setup),
            )
            for name, variant in (variants or {}).items()
        }
        yield replace(ready, variants=by_name)


def _deploy_suites(link: Link, folder: Path) -> dict[str, str]:
    """Put a folder of suites on the target; return the paths of its programs there, by name."""
    tree = deploy.deploy(link, folder, "suites")
    of_suites = {suite: described.programs for suite, described in suites.suites().suites.items()}
    # Suites of an earlier version have no sampler.
    sampler = {SAMPLER: (SAMPLER,)} if (folder / "lib" / SAMPLER / SAMPLER).is_file() else {}
    return {
        program: str(tree / "lib" / package / program)
        for package, programs in (of_suites | sampler).items()
        for program in programs
    }


def _highest_priority(runs: Sequence[Run]) -> int:
    """Return the highest real-time priority that runs ask for; 0 when none does."""
    priorities = [int(run.parameters["priority"] or 0) for run in runs if run.parameters.get("policy", "0") != "0"]
    return max(priorities, default=0)


def _tools(link: Link, scripts: PurePosixPath, runs: Sequence[Run], kernel_config: bytes) -> dict[str, str]:
    """Return the tools of the target that are programs of a run, by name. Raises TargetError naming what it lacks."""
    baselines = {run.suite: suites.suite(run.suite) for run in runs if suites.suite(run.suite).is_baseline}
    tools = {program for suite in baselines.values() for program in suite.programs}
    needs = set(tools)
    for run in runs:
        needs |= conditions.needs(run.condition, run.settings)
    if priority := _highest_priority(runs):
        needs.add(f"rt_priority={priority}")
    lacks = []
    if needs:
        command = ["sh", str(scripts / "missing.sh"), *sorted(needs)]
        lacks = link.check(command).splitlines()
    config = gzip.decompress(kernel_config).decode(errors="replace") if kernel_config else ""
    for suite in baselines.values():
        if suite.kernel and config and f"{suite.kernel}=" not in config:
            lacks.append(f"{suite.kernel} in its kernel")
    if lacks:
        raise TargetError(f"{link.target.address}: the target lacks {', '.join(lacks)}, which this campaign needs")
    return {tool: tool for tool in tools}
