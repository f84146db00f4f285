"""The programs of one run: those of its suite, those in the background, and the files they may write."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from rtrun.execution import download, system, topology_runs
from rtrun.execution.preparation import SAMPLER as SAMPLER_PROGRAM
from rtrun.execution.preparation import Prepared
from rtrun.plan import conditions, suites
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.program import Program
from rtrun.plan.run import Run
from rtrun.targets.inspection.kernel_trace import OPTIONS as TRACE_OPTIONS
from rtrun.validity.observations import SAMPLER, SAMPLER_OUTPUT, output_bytes_max

# How many subscribers a publisher waits for, where nobody else knows.
AWAITED = "awaited_subscribers"
# What is observed is started, waited for and probed before its time begins; a lost link takes time as well.
OBSERVED_EXTRA_S = 1800.0
# A suite that needs longer than this for the time it should take hangs.
DEADLINE_FACTOR = 5
DEADLINE_EXTRA_S = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPrograms:
    """What runs on the target for one run."""

    stages: tuple[tuple[Program, ...], ...]
    """The programs of the suite in the order of their start: those of a stage when all before them are ready."""
    background: tuple[conditions.Background, ...]
    sampler: Program | None
    """What observes all that; None where the campaign has switched it off."""
    outputs: tuple[str, ...]
    """What the suite writes, without ending."""
    file_limits: Mapping[str, int]
    """The files that the run may write, and the largest size of each that is believable, in bytes."""
    texts: Mapping[str, str] = field(default_factory=dict)
    """The files that its programs read, by name: they are put into its folder on the target."""
    need_one_another: bool = False
    """Whether no program of the suite has anything to do once another one has failed."""

    @property
    def measuring(self) -> tuple[Program, ...]:
        """Those that start last; before they start nothing is measured."""
        return self.stages[-1]

    @property
    def awaited(self) -> tuple[Program, ...]:
        """Those that start before, and without which the last ones have nothing to do."""
        return tuple(program for stage in self.stages[:-1] for program in stage)

    @property
    def of_suite(self) -> tuple[Program, ...]:
        """All programs of the suite."""
        return (*self.measuring, *self.awaited)

    @property
    def suite_names(self) -> list[str]:
        """The names of the suite's programs."""
        return [program.name for program in self.of_suite]

    @property
    def load_names(self) -> list[str]:
        """The names of the background programs that are loads."""
        return [each.program.name for each in self.background if each.is_load]

    @property
    def other_names(self) -> list[str]:
        """The names of the background programs that hold a setting, and of the sampler."""
        names = [each.program.name for each in self.background if not each.is_load]
        return [*names, *([self.sampler.name] if self.sampler else [])]

    @property
    def names(self) -> list[str]:
        """The names of all programs."""
        return [*self.suite_names, *self.load_names, *self.other_names]


def programs_of(prepared: Prepared, run: Run, remote: PurePosixPath, token: str) -> RunPrograms:
    """Return the programs of a run in its folder `remote` on the target.

    `token` is unique to one attempt.
    """
    deadline_s = DEADLINE_FACTOR * run.expected_s + DEADLINE_EXTRA_S
    stages: tuple[tuple[Program, ...], ...]
    of_topology: topology_runs.TopologyPrograms | None = None
    if run.topology is not None:
        environment = (*_environment(prepared, run.middleware), *suites.environment(run.parameters))
        of_topology = topology_runs.topology_programs(prepared, run, run.topology, remote, environment, deadline_s)
        stages, outputs = (of_topology.programs,), list[str]()
    elif run.observation is not None:
        deadline_s = run.expected_s + OBSERVED_EXTRA_S
        stages, outputs = _observed(run, deadline_s), []
    else:
        stages, outputs = _of_suite(prepared, run, deadline_s, token)
    of_suite = [program for stage in stages for program in stage]
    background = conditions.background(
        run.condition,
        run.settings,
        cpus=prepared.equipment.cpus,
        programs=prepared.programs,
        scripts=prepared.scripts,
        environment=_environment(prepared, conditions.middleware_of_loads(run.condition)),
        expected_s=run.expected_s,
        deadline_s=deadline_s,
    )
    names = [each.program.name for each in background]
    priority = str(run.parameters.get("priority") or 1)
    sampler = Program(
        name=SAMPLER,
        argv=(prepared.sampler, str(remote), priority, " ".join(names)),
        deadline_s=deadline_s + conditions.OUTLIVE_S,
    )
    limits = download.expected_files(
        run.suite,
        [*(program.name for program in of_suite), *names, SAMPLER],
        outputs,
        int(run.parameters.get("repetitions") or 0),
        traced=any(run.parameters.get(option) is not None for option in TRACE_OPTIONS),
    )
    program_json = suites.program_json_names(run.suite, run.parameters)
    limits |= {f"{program.name}.cgroups": download.CGROUPS_LIMIT_BYTES for program in of_suite}
    limits[SAMPLER_OUTPUT] = output_bytes_max(sampler.deadline_s)
    return RunPrograms(
        stages=stages,
        background=tuple(background),
        sampler=None if run.settings.get(conditions.SAMPLER) else sampler,
        outputs=tuple(outputs),
        file_limits=limits
        | dict.fromkeys(program_json.values(), download.JSON_LIMIT_BYTES)
        | (dict(of_topology.file_limits) if of_topology else {}),
        texts=of_topology.texts if of_topology else {},
        need_one_another=of_topology is not None,
    )


def _environment(prepared: Prepared, middleware: str) -> tuple[tuple[str, str], ...]:
    return middlewares()[middleware].environment_with(ros_master_port=prepared.link.target.master_port)


def _observed(run: Run, deadline_s: float) -> tuple[tuple[Program, ...], ...]:
    """The program that runs the command of the user's system, where there is one."""
    command = run.observation.system.start if run.observation else ""
    return ((system.program_of(command, deadline_s),) if command else (),)


def _of_suite(
    prepared: Prepared, run: Run, deadline_s: float, token: str
) -> tuple[tuple[tuple[Program, ...], ...], list[str]]:
    """Return the programs of the suite by stage, and the outputs they write."""
    suite, middleware = suites.suite(run.suite), middlewares()[run.middleware]
    environment = (*_environment(prepared, run.middleware), *suites.environment(run.parameters))
    if libraries := suites.preloaded(run.parameters):
        folder = PurePosixPath(prepared.programs[SAMPLER_PROGRAM]).parent
        environment = (*environment, ("LD_PRELOAD", " ".join(str(folder / name) for name in libraries)))
    count = int(run.parameters.get("subscribers") or 1)
    outputs: list[str] = []

    def instances(name: str) -> Iterator[Program]:
        repeated = name == suite.repeated
        path = prepared.programs[suites.executable(run.suite, name, run.parameters)]
        for number in range(count if repeated else 1):
            prefix = {"prefix": str(number)} if repeated and count > 1 else {}
            parameters = dict(run.parameters) | prefix | ({AWAITED: count} if suite.repeated else {})
            further = [word.format(number=number, token=token) for word in middleware.repeated] if repeated else []
            yield Program(
                name=f"{name}-{number}" if prefix else name,
                argv=(path, *suites.argv(run.suite, name, parameters)[1:], *further),
                environment=environment,
                deadline_s=deadline_s,
            )
            if not suite.is_baseline and (repeated or suite.repeated is None):
                outputs.append(suites.output_name(run.suite, parameters))

    stages = tuple(tuple(program for name in stage for program in instances(name)) for stage in suite.stages)
    return stages, outputs
