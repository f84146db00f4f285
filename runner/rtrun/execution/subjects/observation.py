"""Programs that are observed: those that run already, or the user's system, which is started for it."""

from collections.abc import Callable
from pathlib import PurePosixPath

from rtrun.execution import observation, observed_runs, system
from rtrun.execution.active_run import ActiveRun, Clock
from rtrun.execution.preparation import Prepared
from rtrun.execution.run_programs import SubjectPrograms
from rtrun.execution.subjects.subject import Aftermath, Closing, MeasuringEnd
from rtrun.plan.observation import ObservationPlan
from rtrun.plan.program import Exit
from rtrun.plan.run import UNTRACED, Run
from rtrun.results import run_directory
from rtrun.results.record import RunRecord
from rtrun.results.run_state import RunEvent, RunLife
from rtrun.targets import processes
from rtrun.targets.errors import TargetError

# Starting, waiting and placing probes come before the time of the observation; a lost link takes time as well.
OBSERVED_EXTRA_S = 1800.0


def _plan_of(run: Run) -> ObservationPlan:
    assert isinstance(run.subject, ObservationPlan)
    return run.subject


def plan(prepared: Prepared, run: Run, remote: PurePosixPath, token: str) -> SubjectPrograms:
    """The program that runs the command of the user's system, where there is one."""
    deadline_s, command = run.expected_s + OBSERVED_EXTRA_S, _plan_of(run).system.start
    return SubjectPrograms(deadline_s=deadline_s, system=system.program_of(command, deadline_s) if command else None)


def start(work: ActiveRun, life: RunLife, start_background: Callable[[], None]) -> str | None:
    """Start the user's system, then the background: its start under a load is not part of the run."""
    not_started = _start_system(work)
    if not_started is None:
        start_background()
    return not_started


def _start_system(work: ActiveRun) -> str | None:
    """Start the user's system if the run names one, and wait until it is ready; return why it is not."""
    link, scripts, asked = work.link, work.prepared.scripts, _plan_of(work.run)
    own = work.programs.subject.system
    if own is not None:
        processes.start(link, scripts, work.remote, own, setup=work.setup)
    # After a restart of the target the system may still be starting. An attending user knows that.
    is_at_once = work.onlooker.is_attended and own is None
    not_ready = system.wait_ready(link, scripts, work.remote, asked, deadline_s=0.0 if is_at_once else system.READY_S)
    if not_ready and is_at_once:
        raise TargetError(f"{link.target.address}: {not_ready}")
    return not_ready


def wait(work: ActiveRun, life: RunLife, not_started: str | None, now: Clock) -> MeasuringEnd:
    """Observe the programs of the run, then end the user's system if the run has started it."""
    link, scripts, asked = work.link, work.prepared.scripts, _plan_of(work.run)
    life.move(RunEvent.OBSERVE)
    aftermath, failure = Aftermath(is_attended=work.onlooker.is_attended), None
    if not_started is None:
        if work.programs.sampler:
            processes.start(link, scripts, work.remote, work.programs.sampler)
        trace = "" if work.run.trace == UNTRACED else work.run.trace
        watched = observation.watch(link, scripts, asked, trace=trace)
        observed = observation.observe(
            link, scripts, watched, asked, trace=trace, onlooker=work.onlooker, now=now, folder=work.folder.parent
        )
        aftermath.observed, aftermath.cut_off = observed, observed.cut_off
        work.onlooker.on_end(observed)
        with aftermath.keeping():
            if work.programs.subject.system and (ended := system.end_of(link, work.remote)):
                failure = f"the system ended while it was observed, {ended}"
    exits = [Exit(status=None, expired=False) for _ in work.programs.subject.foreground]
    with aftermath.keeping():
        if work.programs.subject.system:
            exits = [system.end(link, work.remote)]
    with aftermath.keeping():
        life.move(RunEvent.END)
    return MeasuringEnd(exits=exits, failure=failure, aftermath=aftermath)


def close(closing: Closing, record: RunRecord) -> RunRecord:
    """Write a run for each stream next to it, if something was observed."""
    work, observed = closing.work, closing.observed
    if observed is None:
        return record
    room = run_directory.room_of(work.folder)
    return observed_runs.write(
        closing.partial, closing.place, work.run, record, closing.before, observed, room, closing.troubles
    )
