"""Prepare a target: deploy scripts and suites, check its tools, and run the services that middlewares need."""

import contextlib
import gzip
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from rtfiles.invocation import as_called
from rtrun.execution.middleware.known import SERVICES
from rtrun.plan import conditions, suites
from rtrun.plan.campaign import Variant
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.run import Run
from rtrun.plan.topology.planning import TopologyPlan
from rtrun.targets import deploy
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.inspection import platform_signs
from rtrun.targets.inspection.platform import KnownPlatform
from rtrun.targets.link import OUT_OF_REACH, Link

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
    """The path of the sampler: the program of the suites, or the script if they have none."""
    programs: dict[str, str]
    kernel_config: bytes
    own_services: frozenset[str]
    """The middlewares whose service is ours."""
    no_service: Mapping[str, str]
    """The middlewares whose service does not run, and why."""
    setup: str | None = None
    """The shell file that a variant names for its programs."""
    variants: Mapping[str, "Prepared"] = field(default_factory=dict)
    """By name of the variant: the same target with the suites and the set-up of that variant."""

    def for_run(self, run: Run) -> "Prepared":
        """The target with what the run's variant needs."""
        return self.variants.get(run.variant, self)

    def lacks(self, run: Run) -> str | None:
        """Say what a run needs that the target does not have, or None."""
        for middleware in middlewares_of(run):
            if middleware in self.no_service:
                return self.no_service[middleware]
            if not self.setup and (several := inspection.several_of(self.link.target, self.equipment, middleware)):
                return several
        looked_for = self.equipment.middlewares.get(run.middleware)
        if run.middleware not in SERVICES and looked_for == inspection.Installed() and not self.setup:
            return (
                f"{self.link.target.address}: {middlewares()[run.middleware].summary} was not found on the target: "
                "install it, or name the shell file that sets it up as ros_setup in the target file"
            )
        own = [suites.executable(run.suite, program, run.parameters) for program in suites.suite(run.suite).programs]
        preloading = [SAMPLER] if suites.preloaded(run.parameters) else []  # the libraries are next to it
        for program in (*own, *sorted(conditions.suites_programs(run.condition)), *preloading):
            if program not in self.programs:
                return (
                    f"{self.link.target.address}: {program} is not installed on the target: "
                    f"name a folder of {as_called('rtgen')} suites build as suites in the target file"
                )
        return None

    def setup_of(self, middleware: str) -> str | None:
        """The shell file that sets up a middleware for its programs; None: nothing does."""
        is_installed = middleware in self.equipment.middlewares
        return (self.setup or self.equipment.installed(middleware).setup) if is_installed else None


@contextlib.contextmanager
def prepared(
    link: Link,
    owner: str,
    runs: Sequence[Run],
    may_run_go_on: Callable[[], bool],
    variants: Mapping[str, Variant] | None = None,
) -> Iterator[Prepared]:
    """Deploy scripts and suites, and keep services running while the context lasts or a run goes on.

    Raises TargetError if no run can be measured.
    """
    target = link.target
    equipment = inspection.inspect(link)
    of_target = target.suites if any(map(_needs_suites, runs)) else None
    for folder in filter(None, [of_target, *(variant.suites for variant in (variants or {}).values())]):
        inspection.check_suites(folder, target, equipment)
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    installed = equipment.programs if of_target is None else _deploy_suites(link, of_target)
    # A trace that a killed runner left would slow down the next measurement. A trace that is in use stays.
    link.check([str(scripts / "trace.sh"), "down"])
    kernel_config = inspection.read_kernel_config(link)
    tools = _tools(link, scripts, runs, kernel_config)
    programs = {
        name: (_deploy_suites(link, variant.suites) if variant.suites else installed) | tools
        for name, variant in ({"": Variant()} | dict(variants or {})).items()
    }
    # All variants share one sampler, so that its cost is not taken for an effect of a variant.
    samplers = [paths[SAMPLER] for paths in (*programs.values(), equipment.programs) if SAMPLER in paths]
    deploy.prune(link, 1 + len(variants or {}))
    with contextlib.ExitStack() as running:
        own_services, no_service = set(), {}
        priority = _highest_priority(runs)
        above = priority + 1 if priority else None
        for name in sorted({name for run in runs for name in middlewares_of(run)} & SERVICES.keys()):
            if several := inspection.several_of(target, equipment, name):
                no_service[name] = several
                continue
            service = SERVICES[name].running(link, scripts, equipment.installed(name), owner, above, may_run_go_on)
            try:
                own_services |= {name} if running.enter_context(service) else set()
            except OUT_OF_REACH:
                raise
            except TargetError as error:
                no_service[name] = str(error)
        ready = Prepared(
            link=link,
            equipment=equipment,
            platform=platform_signs.find_platform(link),
            scripts=scripts,
            sampler=samplers[0] if samplers else str(scripts / "sample.sh"),
            programs=programs[""],
            kernel_config=kernel_config,
            own_services=frozenset(own_services),
            no_service=no_service,
        )
        by_name = {
            name: replace(ready, programs=programs[name], setup=variant.ros_setup)
            for name, variant in (variants or {}).items()
        }
        ready = replace(ready, variants=by_name)
        lacking = [ready.for_run(run).lacks(run) for run in runs]
        if lacking and all(lacking):
            raise TargetError(str(lacking[0]))
        yield ready


def _needs_suites(run: Run) -> bool:
    """Whether a run uses programs of the suites: its own, a load's, or the sampler."""
    observes_alone = run.subject.is_observed and bool(run.settings.get(conditions.SAMPLER))
    return not observes_alone or bool(conditions.suites_programs(run.condition))


def middlewares_of(run: Run) -> set[str]:
    """The names of the middlewares whose programs a run starts."""
    return {run.middleware, conditions.middleware_of_loads(run.condition)}


def _deploy_suites(link: Link, folder: Path) -> dict[str, str]:
    """Put a folder of suites on the target; return the paths of its programs there, by name."""
    tree = deploy.deploy(link, folder, "suites")
    return {path.name: str(tree / path.relative_to(folder)) for path in (folder / "lib").glob("*/*") if path.is_file()}


def _highest_priority(runs: Sequence[Run]) -> int:
    """Return the highest real-time priority that runs ask for; 0 when none does."""
    priorities = [int(run.parameters["priority"] or 0) for run in runs if suites.is_real_time(run.parameters)]
    graphs = [run.subject.topology for run in runs if isinstance(run.subject, TopologyPlan)]
    priorities += [executor.priority for graph in graphs for executor in graph.executors]
    return max(priorities, default=0)


def _tools(link: Link, scripts: PurePosixPath, runs: Sequence[Run], kernel_config: bytes) -> dict[str, str]:
    """Return the tools of the target that are programs of a run, by name. Raises TargetError naming what it lacks."""
    baselines = {run.suite: suites.suite(run.suite) for run in runs if suites.suite(run.suite).is_baseline}
    tools = {program for suite in baselines.values() for program in suite.programs}
    needs = set(tools)
    for run in runs:
        needs |= conditions.needs(run.condition, run.settings)
        needs |= {
            f"option={run.suite} {option.flag} {option.since}"
            for key, value in run.parameters.items()
            if value is not None and (option := suites.options().get(key)) and option.since
        }
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
