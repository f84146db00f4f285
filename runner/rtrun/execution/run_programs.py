"""The programs of one run: those of its suite, those in the background, and the files they may write."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

from rtrun.execution import download
from rtrun.execution.preparation import Prepared
from rtrun.plan import conditions, suites
from rtrun.plan.program import Program
from rtrun.plan.run import Run
from rtrun.targets.inspection.kernel_trace import OPTIONS as TRACE_OPTIONS
from rtrun.validity.observations import SAMPLER, SAMPLER_OUTPUT, output_bytes_max

SUBSCRIBER = "ct_subscriber"
# A suite that needs longer than this for the time it should take hangs.
DEADLINE_FACTOR = 5
DEADLINE_EXTRA_S = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPrograms:
    """What runs on the target for one run."""

    subscribers: tuple[Program, ...]
    """Programs of the suite that wait for the messages of the others: they start first."""
    measuring: tuple[Program, ...]
    """The other programs of the suite; before they start nothing is measured."""
    background: tuple[conditions.Background, ...]
    sampler: Program | None
    """What observes all that; None where the campaign has switched it off."""
    outputs: tuple[str, ...]
    """What the suite writes, without ending."""
    file_limits: Mapping[str, int]
    """The files that the run may write, and the largest size of each that is believable, in bytes."""

    @property
    def of_suite(self) -> tuple[Program, ...]:
        """All programs of the suite."""
        return (*self.measuring, *self.subscribers)

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

    `token` makes the names of their ROS nodes unique to one attempt: a master remembers nodes that were killed.
    """
    deadline_s = DEADLINE_FACTOR * run.expected_s + DEADLINE_EXTRA_S
    port = prepared.link.target.ros_master_port
    environment = (("ROS_MASTER_URI", f"http://127.0.0.1:{port}"), ("ROS_IP", "127.0.0.1"))
    subscribers, measuring, outputs = _of_suite(prepared, run, environment, deadline_s, token)
    background = conditions.background(
        run.condition,
        run.settings,
        cpus=prepared.equipment.cpus,
        programs=prepared.programs,
        scripts=prepared.scripts,
        environment=environment,
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
        [*(program.name for program in (*measuring, *subscribers)), *names, SAMPLER],
        outputs,
        int(run.parameters.get("repetitions") or 0),
        traced=any(run.parameters.get(option) is not None for option in TRACE_OPTIONS),
    )
    program_json = suites.program_json_names(run.suite, run.parameters)
    limits |= {f"{program.name}.cgroups": download.CGROUPS_LIMIT_BYTES for program in (*measuring, *subscribers)}
    limits[SAMPLER_OUTPUT] = output_bytes_max(sampler.deadline_s)
    return RunPrograms(
        subscribers=tuple(subscribers),
        measuring=tuple(measuring),
        background=tuple(background),
        sampler=None if run.settings.get(conditions.SAMPLER) else sampler,
        outputs=tuple(outputs),
        file_limits=limits | dict.fromkeys(program_json.values(), download.JSON_LIMIT_BYTES),
    )


def _of_suite(
    prepared: Prepared, run: Run, environment: tuple[tuple[str, str], ...], deadline_s: float, token: str
) -> tuple[list[Program], list[Program], list[str]]:
    """Return the subscribers, the other programs, and the outputs they write."""
    suite = suites.suite(run.suite)
    count = int(run.parameters.get("subscribers") or 1)
    subscribers: list[Program] = []
    others: list[Program] = []
    outputs: list[str] = []
    for executable in suite.programs:
        repeated = executable == suite.repeated
        for number in range(count if repeated else 1):
            prefix = {"prefix": str(number)} if repeated and count > 1 else {}
            parameters = dict(run.parameters) | prefix
            argv = suites.argv(run.suite, executable, parameters)
            # A ROS master ends the older of two nodes of one name.
            node = (f"__name:={SUBSCRIBER}{number}_{token}",) if repeated else ()
            program = Program(
                name=f"{executable}-{number}" if prefix else executable,
                argv=(prepared.programs[executable], *argv[1:], *node),
                environment=environment,
                deadline_s=deadline_s,
            )
            (subscribers if repeated else others).append(program)
            if not suite.is_baseline and (repeated or suite.repeated is None):
                outputs.append(suites.output_name(run.suite, parameters))
    return subscribers, others, outputs
