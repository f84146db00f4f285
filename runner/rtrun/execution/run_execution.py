"""One run on a prepared target: it is resumed or started, awaited or observed, ended, and then closed."""

import contextlib
import secrets
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.quantities import duration
from rtrun.execution import download, observed_runs, resumption, system
from rtrun.execution.active_run import ActiveRun, Clock, RunEnd
from rtrun.execution.closing import close
from rtrun.execution.observation import NOBODY, Onlooker
from rtrun.execution.planned_programs import programs_of
from rtrun.execution.preparation import Prepared
from rtrun.execution.resumption import Attempt, Leftovers
from rtrun.execution.subjects.known import subject_of
from rtrun.execution.subjects.subject import Aftermath, MeasuringEnd
from rtrun.plan import conditions
from rtrun.plan.run import Run
from rtrun.results import run_directory
from rtrun.results.journal import KEPT
from rtrun.results.record import RunRecord, moment
from rtrun.results.run_state import GivenUp, RunEvent, RunLife, RunState
from rtrun.targets import processes
from rtrun.targets.connection import parse_listing
from rtrun.targets.errors import DeadlineExpired, TargetError
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.link import OUT_OF_REACH

# After this multiple of its expected time plus this much, a run may have been interrupted because it hangs.
HUNG_FACTOR = 2
HUNG_EXTRA_S = 10.0  #: beyond twice the expected time of a run: then Ctrl-C ends a run that hangs
# A run has some ten files for each of its programs. The user is notified of a folder with more than this.
FILES_USUAL = 10_000
# For a folder with some million files.
LISTING_S = 120.0  #: listing the files of a run that was cut off
# A lost link ends the input early: an incomplete file does not get its final name.
_PUT = 'cat >"$1.new" && [ "$(wc -c <"$1.new")" -eq "$2" ] && mv "$1.new" "$1"'
# Separates the state of the target from the list of files.
_FILES = "== files"


def must_give_up(state: RunState, error: BaseException) -> bool:
    """Whether an error ends the run on the target; otherwise the run stays as it is, and the next call resumes it."""
    if isinstance(error, OUT_OF_REACH):
        return False
    if state in (RunState.STARTING, RunState.LAUNCHING, RunState.OBSERVING):
        return isinstance(error, KeyboardInterrupt | InfrastructureError)
    # The target itself should have ended it long before the deadline of the runner.
    return state is RunState.MEASURING and isinstance(error, KeyboardInterrupt | DeadlineExpired)


def why_given_up(state: RunState, error: BaseException, taken_s: float, total_s: float) -> str:
    """The journal's reason for an attempt that an error ended; its first words (`GivenUp`) decide how it is judged.

    The attempt has taken `taken_s` of the `total_s` that it should take, in seconds. Interrupting a run because it
    seems to hang must not improve a result.
    """
    is_interrupted = isinstance(error, KeyboardInterrupt)
    if state in (RunState.LAUNCHING, RunState.MEASURING):
        if is_interrupted and taken_s > HUNG_FACTOR * total_s + HUNG_EXTRA_S:
            return f"{GivenUp.TOO_LONG}: interrupted after {duration(taken_s)}, of {duration(total_s)}"
        if isinstance(error, DeadlineExpired):
            return f"{GivenUp.TOO_LONG}: {error}"
    return GivenUp.INTERRUPTED if is_interrupted else f"{GivenUp.NOT_MEASURED}: {error}"


def measure(
    prepared: Prepared,
    uid: str,
    campaign: str,
    run: Run,
    folder: Path,
    life: RunLife,
    now: Clock,
    *,
    may_be_begun: bool,
    onlooker: Onlooker = NOBODY,
) -> RunRecord:
    """Measure one run, or resume one that an earlier call began; return the closing record of `folder`.

    An observation also writes one folder per stream next to `folder`, and keeps `onlooker` informed. Unless
    `may_be_begun`, no earlier attempt is searched for. Raises TargetError when the target cannot go on, TargetRebooted
    when a restart cut this run off. What was observed is kept before anything is raised.
    """
    remote = prepared.link.target.work_dir / "runs" / uid / run.name
    token = secrets.token_hex(4)
    work = ActiveRun(
        prepared=prepared,
        campaign=campaign,
        run=run,
        folder=folder,
        remote=remote,
        programs=programs_of(prepared, run, remote, token),
        token=token,
        onlooker=onlooker,
    )
    with observed_runs.room(folder) if run.subject.is_observed else contextlib.nullcontext():
        return _measure(work, life, now, may_be_begun=may_be_begun)


def _measure(work: ActiveRun, life: RunLife, now: Clock, *, may_be_begun: bool) -> RunRecord:
    run, remote, begun = work.run, work.remote, now()
    try:
        attempt, not_started = (_resume(work, life) if may_be_begun else None), None
        if attempt is None:
            attempt, not_started = _start(work, life, now)
        else:
            begun = moment(attempt.start_time) or begun
        measured = subject_of(run).wait(work, life, not_started, now)
    except (KeyboardInterrupt, InfrastructureError) as error:
        if must_give_up(life.state, error):
            # Record the outcome first: the runner may be killed before everything on the target is ended.
            try:
                reason = why_given_up(life.state, error, (now() - begun).total_seconds(), run.total_s)
                life.move(RunEvent.GIVE_UP, reason)
            finally:
                _give_up_or_note(work)
        elif life.state is RunState.MEASURING and not isinstance(error, OUT_OF_REACH):
            raise TargetError(f"{error}; the run goes on and is picked up by the next call") from error
        raise
    aftermath = measured.aftermath
    # If the target no longer answers, nothing else is known about how the run ended there.
    end = RunEnd(
        failure=not_started or measured.failure,
        exits=measured.exits,
        ended_early={},
        service=attempt.service,
        after=inspection.TargetState(),
        files={},
    )
    with aftermath.keeping():
        end = _end_background(work, measured, not_started)
    with aftermath.deferring():
        record = _close(work, attempt, end, aftermath, now)
        life.move(RunEvent.CLOSE, f"{record.status}: {record.reason}" if record.reason else record.status)
    with aftermath.keeping():
        processes.remove(work.link, remote)
    if aftermath.cut_off is not None:
        raise aftermath.cut_off
    return record


def _close(work: ActiveRun, attempt: Attempt, end: RunEnd, aftermath: Aftermath, now: Clock) -> RunRecord:
    """Close the run. An observation that cannot be kept in its own folder is kept in a new temporary folder."""
    try:
        return close(work, attempt, end, aftermath.observed, now, aftermath.troubles)
    except (UsageError, InfrastructureError) as error:
        if aftermath.observed is None:
            raise
        try:
            folder = Path(tempfile.mkdtemp(prefix="rtrun-")) / work.folder.name
            record = close(replace(work, folder=folder), attempt, end, aftermath.observed, now, aftermath.troubles)
        except (UsageError, InfrastructureError, OSError):
            raise error from None
        aftermath.cut_off = aftermath.cut_off or InfrastructureError(f"{error}; it is kept in {folder.parent} instead")
        return record


def _resume(work: ActiveRun, life: RunLife) -> Attempt | None:
    """Return the attempt of an earlier call that can be picked up, or make room for a new one and return None."""
    others = [*work.programs.load_names, *work.programs.other_names]
    foreground = [program.name for program in work.programs.subject.foreground]
    leftovers = resumption.inspect_leftovers(work.link, work.remote, foreground, others)
    if leftovers.can_be_picked_up(work.measuring, run_directory.closing_record(work.folder)):
        life.move(RunEvent.PICK_UP)
        return leftovers.attempt
    if leftovers.cut_off:
        life.move(RunEvent.RESTART, "the target was restarted while nobody looked")
        with run_directory.filling(work.folder) as partial:
            limits = work.programs.file_limits
            present = parse_listing(work.link.check(download.listing(work.remote, limits), deadline_s=LISTING_S)).sizes
            download.pull(work.link, work.remote, present, partial, limits)
            kept = run_directory.keep_beside(partial, work.folder, "incomplete")
        life.move(RunEvent.KEEP, f"{KEPT}{kept.name}")
    if leftovers.has_folder:
        life.move(RunEvent.GIVE_UP, _why_left(work, leftovers))
        _give_up(work)
    return None


def _why_left(work: ActiveRun, leftovers: Leftovers) -> str:
    """The journal's reason for an attempt that is not picked up. Observing programs that ran already leaves nothing."""
    if work.measuring and leftovers.started.isdisjoint(work.measuring):
        return GivenUp.NOT_MEASURED
    return f"{GivenUp.LEFT}: {leftovers.unreadable}" if leftovers.unreadable else GivenUp.LEFT


def _give_up(work: ActiveRun) -> None:
    """End everything of the run that still lives, and remove its folder on the target."""
    if work.programs.subject.system is not None:
        system.end(work.link, work.remote)
    processes.give_up(work.link, work.remote, work.programs.names)


def _give_up_or_note(work: ActiveRun) -> None:
    """Give the run up, and report what stays on the target."""
    try:
        _give_up(work)
    except TargetError as left:
        work.link.note(
            f"{work.run.name} was given up, and {work.remote} stays on the target: {left}; run this again to end it"
        )


def _start(work: ActiveRun, life: RunLife, now: Clock) -> tuple[Attempt, str | None]:
    """Start the background, then the suite; return why its measuring programs were not started, if so.

    A system to observe is started before the background: its start under a load is not part of the run. Raises
    TargetError when nothing can be measured.
    """
    life.move(RunEvent.BEGIN)
    attempt = _begin(work, now)

    def start_background() -> None:
        if work.programs.background:
            _start_background(work)

    not_started = subject_of(work.run).start(work, life, start_background)
    return attempt, not_started


def _begin(work: ActiveRun, now: Clock) -> Attempt:
    start_time = now()
    service = work.service_identity()
    if work.service and not service:
        raise TargetError(f"{work.link.target.address}: {work.service.name} died")
    state_script = work.prepared.scripts / "state.sh"
    if not work.programs.names:
        # The run puts nothing on the target, and disturbs no other run there.
        return resumption.without_folder(start_time.isoformat(), inspection.read_state(work.link, state_script))
    attempt = resumption.begin(
        work.link,
        work.remote,
        start_time=start_time.isoformat(),
        service=service,
        own_service=work.run.middleware in work.prepared.own_services,
        argv={program.name: program.argv for program in work.programs.subject.foreground},
        state_script=state_script,
    )
    for name, text in work.programs.subject.texts.items():
        words = [str(work.remote / name), str(len(text.encode()))]
        work.link.check(["sh", "-c", _PUT, "sh", *words], stdin=text)
    return attempt


def _start_background(work: ActiveRun) -> None:
    """Start the programs of the condition. Raises TargetError when one of them ends at once."""
    link, prepared = work.link, work.prepared
    programs = [entry.program for entry in work.programs.background]
    setup = prepared.setup_of(conditions.middleware_of_loads(work.run.condition))
    processes.start(link, prepared.scripts, work.remote, *programs, setup=setup)
    time.sleep(work.run.settle_s)
    for name in processes.list_ended(link, work.remote, [program.name for program in programs]):
        reason = processes.read_last_line(link, work.remote / f"{name}.stderr") or "it printed no reason"
        raise TargetError(f"{link.target.address}: condition {work.run.condition}: {name} does not run: {reason}")


def _end_background(work: ActiveRun, measured: MeasuringEnd, not_started: str | None) -> RunEnd:
    failure = not_started or measured.failure
    limits, state_script = work.programs.file_limits, work.prepared.scripts / "state.sh"
    if not work.programs.names:
        after = inspection.read_state(work.link, state_script)
        return RunEnd(failure=failure, exits=(), ended_early={}, service="", after=after, files={})
    ended = processes.end_background(
        work.link,
        work.remote,
        work.programs.subject.suite_names,
        work.programs.load_names,
        work.programs.other_names,
        service=measured.service,
        # The sampler must not see the loads end, and in an observation nothing else marks the end of measuring.
        first=[work.programs.sampler.name] if work.programs.sampler and not work.programs.subject.of_suite else [],
        then=[["sh", str(state_script)], ["echo", _FILES], download.listing(work.remote, limits)],
    )
    state, _, listed = ended.output.partition(f"{_FILES}\n")
    files = parse_listing(listed)
    if files.total > FILES_USUAL:
        work.link.note(f"{work.remote}: has {files.total} files; those that are not of the run are removed with it")
    return RunEnd(
        failure=failure,
        exits=measured.exits,
        ended_early=ended.early,
        service=ended.service,
        after=inspection.parse_state(state),
        files=files.sizes,
    )
