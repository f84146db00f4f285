"""The programs of a run, of its subject and in the background, and the files that they may write."""

from pathlib import PurePosixPath

from rtrun.execution import download
from rtrun.execution.preparation import Prepared
from rtrun.execution.run_programs import RunPrograms, environment_of
from rtrun.execution.subjects.known import subject_of
from rtrun.plan import conditions, suites
from rtrun.plan.program import Program
from rtrun.plan.run import Run
from rtrun.targets.inspection.kernel_trace import OPTIONS as TRACE_OPTIONS
from rtrun.validity.observations import SAMPLER, SAMPLER_OUTPUT, output_bytes_max


def programs_of(prepared: Prepared, run: Run, remote: PurePosixPath, token: str) -> RunPrograms:
    """Return the programs of a run in its folder `remote` on the target.

    `token` is unique to one attempt.
    """
    planned = subject_of(run).plan(prepared, run, remote, token)
    deadline_s = planned.deadline_s
    background = conditions.background(
        run.condition,
        run.settings,
        cpus=prepared.equipment.cpus,
        programs=prepared.programs,
        scripts=prepared.scripts,
        environment=environment_of(prepared, conditions.middleware_of_loads(run.condition)),
        expected_s=run.expected_s,
        deadline_s=deadline_s,
    )
    names = [entry.program.name for entry in background]
    priority = str(run.parameters.get("priority") or 1)
    sampler = Program(
        name=SAMPLER,
        argv=(prepared.sampler, str(remote), priority, " ".join(names)),
        deadline_s=deadline_s + conditions.OUTLIVE_S,
    )
    limits = download.expected_files(
        run.suite,
        [*(program.name for program in planned.foreground), *names, SAMPLER],
        planned.outputs,
        int(run.parameters.get("repetitions") or 0),
        traced=any(run.parameters.get(option) is not None for option in TRACE_OPTIONS),
    )
    program_json = suites.program_json_names(run.suite, run.parameters)
    limits |= {f"{program.name}.cgroups": download.CGROUPS_LIMIT_BYTES for program in planned.foreground}
    limits[SAMPLER_OUTPUT] = output_bytes_max(sampler.deadline_s)
    return RunPrograms(
        subject=planned,
        background=tuple(background),
        sampler=None if run.settings.get(conditions.SAMPLER) else sampler,
        file_limits=limits
        | dict.fromkeys(program_json.values(), download.JSON_LIMIT_BYTES)
        | dict(planned.file_limits),
    )
