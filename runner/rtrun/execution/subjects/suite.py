"""The programs of a suite, which write down what they measure."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import PurePosixPath

from rtrun.execution.active_run import ActiveRun, Clock
from rtrun.execution.preparation import SAMPLER as SAMPLER_PROGRAM
from rtrun.execution.preparation import Prepared
from rtrun.execution.run_programs import SubjectPrograms, environment_of
from rtrun.execution.subjects.subject import Closing, MeasuringEnd
from rtrun.plan import suites
from rtrun.plan.middleware.description import middlewares
from rtrun.plan.program import Program
from rtrun.plan.run import Run
from rtrun.results.figures_so_far import ENDING, FiguresSoFar, pooled, read_figures
from rtrun.results.record import RunRecord
from rtrun.results.run_state import RunEvent, RunLife
from rtrun.targets import processes

# How many subscribers a publisher waits for, if no service counts them.
AWAITED = "awaited_subscribers"
# A suite hangs if it takes longer than this multiple of its expected time, plus this much.
DEADLINE_FACTOR = 5
DEADLINE_EXTRA_S = 120.0
SUBSCRIBED_S = 60.0  #: waiting for subscribers to register
END_GRACE_S = 60.0  #: more time for a program after its deadline on the target


def deadline_of(run: Run) -> float:
    """The time after which programs of a run count as hanging, in seconds."""
    return DEADLINE_FACTOR * run.expected_s + DEADLINE_EXTRA_S


def plan(prepared: Prepared, run: Run, remote: PurePosixPath, token: str) -> SubjectPrograms:
    """The programs of the suite by stage, and the outputs that they write."""
    deadline_s = deadline_of(run)
    suite, middleware = suites.suite(run.suite), middlewares()[run.middleware]
    environment = (*environment_of(prepared, run.middleware), *suites.environment(run.parameters))
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
    return SubjectPrograms(deadline_s=deadline_s, stages=stages, outputs=tuple(outputs))


def start(work: ActiveRun, life: RunLife, start_background: Callable[[], None]) -> str | None:
    """Start the background, then the suite; return why its measuring programs were not started, if so."""
    start_background()
    not_started = _start_stages(work, life)
    life.move(RunEvent.START)
    return not_started


def _start_stages(work: ActiveRun, life: RunLife) -> str | None:
    """Start the sampler, then the suite's programs stage by stage, each when those before it are ready.

    Return why the rest was not started: a program that the rest needs has ended.
    """
    link, remote = work.link, work.remote
    first, *later = work.programs.subject.stages

    def start(*programs: Program, stage: Sequence[Program]) -> None:
        if stage is work.programs.subject.measuring:
            life.move(RunEvent.LAUNCH)
        processes.start(link, work.prepared.scripts, remote, *programs, setup=work.setup)

    start(*([work.programs.sampler] if work.programs.sampler else []), *first, stage=first)
    for stage in later:
        names = [program.name for program in work.programs.subject.awaited]
        _wait_ready(work, names)
        if ended := processes.list_ended(link, remote, names):
            # The run has failed. The publisher would not notice, and would take its full time.
            processes.end(link, remote, *names)
            return f"{ended[0]} ended before {stage[0].name} was started: {_last_word(work, ended[0])}"
        start(*stage, stage=stage)
    return None


def _wait_ready(work: ActiveRun, names: Sequence[str]) -> None:
    """Wait until these programs of the suite are ready, or one of them has ended.

    Without a service only the programs themselves know: they wait for one another.
    """
    service, link = work.service, work.link
    if service is not None:
        processes.wait_until(
            lambda: (
                service.count_subscribers(link, work.token) >= len(names)
                or bool(processes.list_ended(link, work.remote, names))
            ),
            deadline_s=SUBSCRIBED_S,
            what=f"{link.target.address}: {len(names)} subscribers to register with {service.name}",
        )


def _last_word(work: ActiveRun, name: str) -> str:
    return processes.read_last_line(work.link, work.remote / f"{name}.stderr") or "it said nothing"


def wait(work: ActiveRun, life: RunLife, not_started: str | None, now: Clock) -> MeasuringEnd:
    """Wait for the programs of the suite."""
    link, failure, following = work.link, None, _following(work)
    awaited = [program.name for program in work.programs.subject.awaited]
    exits = []
    for program in work.programs.subject.of_suite:
        needed = [] if failure or program.name in awaited else awaited
        if work.programs.subject.need_one_another and not failure:
            needed = [name for name in work.programs.subject.suite_names if name != program.name]
        deadline_s = program.deadline_s + END_GRACE_S
        ended = processes.wait(
            link, work.remote, program.name, deadline_s=deadline_s, needed=needed, following=following
        )
        if isinstance(ended, processes.NeededFailed):
            # As before the start of a stage: the publisher would go on as if the program were there.
            failure = f"{ended.name} ended while {program.name} was running: {_last_word(work, ended.name)}"
            processes.end(link, work.remote, *work.programs.subject.suite_names)
            ended = processes.wait(link, work.remote, program.name, deadline_s=deadline_s)
        exits.append(ended)
        if failure is None and program.name not in awaited and exits[-1].status != 0:
            # Its receivers may never have seen it, and would wait until their own deadline.
            processes.end(link, work.remote, *awaited)
    service = work.service_identity()
    life.move(RunEvent.END)
    return MeasuringEnd(exits=exits, failure=failure, service=service)


def _following(work: ActiveRun) -> processes.Following | None:
    """What is read while the suite measures: the figures so far of each of its outputs, if they are shown."""
    show = work.onlooker.on_figures
    if show is None:
        return None
    seen: dict[str, FiguresSoFar] = {}

    def take(file: str, line: str) -> None:
        if figures := read_figures(line):
            seen[file] = figures
            show(pooled(seen.values()))

    return processes.Following(files=[f"{name}{ENDING}" for name in work.programs.subject.outputs], take=take)


def close(closing: Closing, record: RunRecord) -> RunRecord:
    """Return the record as it is: all measured values are in the files already."""
    return record
