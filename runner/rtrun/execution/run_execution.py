"""One run on a prepared target: resumed or started, waited for or observed, ended; then it is closed."""

import contextlib
import secrets
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.interruption import deferred
from rtfiles.quantities import duration
from rtrun.execution import download, observation, observed_runs, resumption, system
from rtrun.execution.closing import ActiveRun, Clock, RunEnd, close
from rtrun.execution.observation import KEPT_FIRST, NOBODY, ObservationResult, Onlooker, defect_in_words
from rtrun.execution.preparation import Prepared
from rtrun.execution.resumption import Attempt, Leftovers
from rtrun.execution.run_programs import programs_of
from rtrun.plan import conditions
from rtrun.plan.program import Exit, Program
from rtrun.plan.run import UNTRACED, Run
from rtrun.results import run_directory
from rtrun.results.journal import KEPT
from rtrun.results.record import RunRecord, moment
from rtrun.results.run_state import GivenUp, RunEvent, RunLife, RunState
from rtrun.targets import processes
from rtrun.targets.connection import parse_listing
from rtrun.targets.errors import DeadlineExpired, TargetError
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.link import OUT_OF_REACH, TargetRebooted

SUBSCRIBED_S = 60.0
# The target ends a program at its deadline; the runner waits this much longer for that.
END_GRACE_S = 60.0
# Who interrupts a run after this share of the time that it should take, and so much more, may do it because it hangs.
HUNG_FACTOR = 2
HUNG_EXTRA_S = 10.0
# A run has some ten files for each of its programs. Of a folder with more than this the user is told.
FILES_USUAL = 10_000
# For a folder with some million files.
LISTING_S = 120.0
# A lost link ends the input early: what is not whole does not get its name.
_PUT = 'cat >"$1.new" && [ "$(wc -c <"$1.new")" -eq "$2" ] && mv "$1.new" "$1"'
# Stands between the state of the target and the list of files.
_FILES = "== files"


def must_give_up(state: RunState, error: BaseException) -> bool:
    """Whether an error ends what runs on the target; otherwise the run stays as it is, for the next call to pick up."""
    if isinstance(error, OUT_OF_REACH):
        return False
    if state in (RunState.STARTING, RunState.LAUNCHING, RunState.OBSERVING):
        return isinstance(error, KeyboardInterrupt | InfrastructureError)
    # The target itself should have ended it long before the deadline of the runner.
    return state is RunState.MEASURING and isinstance(error, KeyboardInterrupt | DeadlineExpired)


def why_given_up(state: RunState, error: BaseException, taken_s: float, total_s: float) -> str:
    """What the journal says of an attempt that an error ended: by its first words (`GivenUp`) it is judged.

    It has taken `taken_s` of the `total_s` that it should take, in seconds. Who interrupts a run because it seems to
    hang is not to profit from that.
    """
    is_interrupted = isinstance(error, KeyboardInterrupt)
    if state in (RunState.LAUNCHING, RunState.MEASURING):
        if is_interrupted and taken_s > HUNG_FACTOR * total_s + HUNG_EXTRA_S:
            return f"{GivenUp.TOO_LONG}: interrupted after {duration(taken_s)}, of {duration(total_s)}"
        if isinstance(error, DeadlineExpired):
            return f"{GivenUp.TOO_LONG}: {error}"
    return GivenUp.INTERRUPTED if is_interrupted else f"{GivenUp.NOT_MEASURED}: {error}"


@dataclass(slots=True, kw_only=True)
class _Aftermath:
    """What comes after something was observed, which is kept first, whatever comes."""

    observed: ObservationResult | None = None
    """None: nothing is observed, and whatever comes is raised at once."""
    is_attended: bool = False
    troubles: list[str] = field(default_factory=list)
    """With the target."""
    cut_off: BaseException | None = None
    """What ends more than this run: raised once it is kept."""

    def deferring(self) -> AbstractContextManager[None]:
        """Where something was observed, let the first Ctrl-C wait for the end of the context."""
        return deferred(KEPT_FIRST) if self.observed else contextlib.nullcontext()

    @contextlib.contextmanager
    def keeping(self) -> Iterator[None]:
        """Note trouble, Ctrl-C or a defect of ours instead of raising it."""
        try:
            with self.deferring():
                yield
        except KeyboardInterrupt as error:
            if self.observed is None:
                raise
            self.cut_off = error
        except InfrastructureError as error:
            if self.observed is None:
                raise
            self.troubles.append(str(error))
            # Who sits before it has seen that, and waits for nothing more.
            if isinstance(error, TargetRebooted) and not self.is_attended:
                self.cut_off = self.cut_off or error
        except Exception as error:
            if self.observed is None:
                raise
            self.troubles.append(defect_in_words(error))
            self.cut_off = self.cut_off or error


@dataclass(frozen=True, slots=True, kw_only=True)
class _Measured:
    """What came of the measuring: how the programs ended, why they were ended early, if so, the service then."""

    exits: Sequence[Exit] = ()
    failure: str | None = None
    service: str = ""
    aftermath: _Aftermath = field(default_factory=_Aftermath)


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
    """Measure one run, or pick it up where an earlier call left it; return the record that `folder` is closed with.

    Of a run that observes there are further folders beside it, one for each stream; `onlooker` is told meanwhile.
    Where `may_be_begun` is false, nobody looks for what an earlier call left. Raises TargetError when the target cannot
    go on, TargetRebooted when this run was cut off by a restart. What was observed is kept before anything is raised.
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
    with observed_runs.room(folder) if run.observation else contextlib.nullcontext():
        return _measure(work, life, now, may_be_begun=may_be_begun)


def _measure(work: ActiveRun, life: RunLife, now: Clock, *, may_be_begun: bool) -> RunRecord:
    run, remote, begun = work.run, work.remote, now()
    try:
        attempt, not_started = (_resume(work, life) if may_be_begun else None), None
        if attempt is None:
            attempt, not_started = _start(work, life, now)
        else:
            begun = moment(attempt.start_time) or begun
        measured = _observe(work, life, not_started, now) if run.observation else _wait(work, life)
    except (KeyboardInterrupt, InfrastructureError) as error:
        if must_give_up(life.state, error):
            # It is known what became of it, whoever is killed before all is ended there.
            try:
                reason = why_given_up(life.state, error, (now() - begun).total_seconds(), run.total_s)
                life.move(RunEvent.GIVE_UP, reason)
            finally:
                _give_up_or_note(work)
        elif life.state is RunState.MEASURING and not isinstance(error, OUT_OF_REACH):
            raise TargetError(f"{error}; the run goes on and is picked up by the next call") from error
        raise
    aftermath = measured.aftermath
    # Where nothing more is heard of the target, that much is known of how the run ended there.
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


def _close(work: ActiveRun, attempt: Attempt, end: RunEnd, aftermath: _Aftermath, now: Clock) -> RunRecord:
    """Close it. What was observed and cannot be kept where it was to be is kept in a new folder for temporary files."""
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
    leftovers = resumption.inspect_leftovers(work.link, work.remote, work.programs.suite_names, others)
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
    """What the journal says of an attempt that is not picked up; one of programs that ran already left nothing."""
    if work.run.observation is None and leftovers.started.isdisjoint(work.measuring):
        return GivenUp.NOT_MEASURED
    return f"{GivenUp.LEFT}: {leftovers.unreadable}" if leftovers.unreadable else GivenUp.LEFT


def _give_up(work: ActiveRun) -> None:
    """End all that runs of it, and remove its folder on the target."""
    if work.starts_system:
        system.end(work.link, work.remote)
    processes.give_up(work.link, work.remote, work.programs.names)


def _give_up_or_note(work: ActiveRun) -> None:
    """Give it up, and say what stays on the target."""
    try:
        _give_up(work)
    except TargetError as left:
        work.link.note(
            f"{work.run.name} was given up, and {work.remote} stays on the target: {left}; run this again to end it"
        )


def _start(work: ActiveRun, life: RunLife, now: Clock) -> tuple[Attempt, str | None]:
    """Start the background, then the suite; return why its measuring programs were not started, if so.

    What is observed is started before the background: how it comes up under a load is no part of the run. Raises
    TargetError when nothing can be measured.
    """
    life.move(RunEvent.BEGIN)
    attempt = _begin(work, now)
    not_started = _start_system(work) if work.run.observation else None
    if work.programs.background and not_started is None:
        _start_background(work)
    if work.run.observation is None:
        not_started = _start_suite(work, life)
        life.move(RunEvent.START)
    return attempt, not_started


def _start_system(work: ActiveRun) -> str | None:
    """Start the user's system where the run names one, and wait until it is ready; return why it is not."""
    assert work.run.observation is not None
    link, scripts, plan = work.link, work.prepared.scripts, work.run.observation
    if work.starts_system:
        processes.start(link, scripts, work.remote, *work.programs.of_suite, setup=work.setup)
    # After a restart of the target it may still come up; who sits before it knows.
    is_at_once = work.onlooker.is_attended and not work.starts_system
    not_ready = system.wait_ready(link, scripts, work.remote, plan, deadline_s=0.0 if is_at_once else system.READY_S)
    if not_ready and is_at_once:
        raise TargetError(f"{link.target.address}: {not_ready}")
    return not_ready


def _begin(work: ActiveRun, now: Clock) -> Attempt:
    start_time = now()
    service = _service(work)
    if work.service and not service:
        raise TargetError(f"{work.link.target.address}: {work.service.name} died")
    state_script = work.prepared.scripts / "state.sh"
    if not work.programs.names:
        # Nothing of it comes to the target, and no other run there is disturbed.
        return resumption.without_folder(start_time.isoformat(), inspection.read_state(work.link, state_script))
    attempt = resumption.begin(
        work.link,
        work.remote,
        start_time=start_time.isoformat(),
        service=service,
        own_service=work.run.middleware in work.prepared.own_services,
        argv={program.name: program.argv for program in work.programs.of_suite},
        state_script=state_script,
    )
    for name, text in work.programs.texts.items():
        words = [str(work.remote / name), str(len(text.encode()))]
        work.link.check(["sh", "-c", _PUT, "sh", *words], stdin=text)
    return attempt


def _service(work: ActiveRun) -> str:
    """The identity of what the middleware of the run needs; empty: it needs nothing, or that does not run."""
    return (work.service.identity(work.link) if work.service else None) or ""


def _start_background(work: ActiveRun) -> None:
    """Start what the condition asks for. Raises TargetError when a program of it ends at once."""
    link, prepared = work.link, work.prepared
    programs = [each.program for each in work.programs.background]
    setup = prepared.setup_of(conditions.middleware_of_loads(work.run.condition))
    processes.start(link, prepared.scripts, work.remote, *programs, setup=setup)
    time.sleep(work.run.settle_s)
    for name in processes.list_ended(link, work.remote, [program.name for program in programs]):
        reason = processes.read_last_line(link, work.remote / f"{name}.stderr") or "it printed no reason"
        raise TargetError(f"{link.target.address}: condition {work.run.condition}: {name} does not run: {reason}")


def _start_suite(work: ActiveRun, life: RunLife) -> str | None:
    """Start the sampler, then the suite's programs stage by stage, each when those before it are ready.

    Return why the rest was not started: a program that it needs has ended.
    """
    link, remote = work.link, work.remote
    first, *later = work.programs.stages

    def start(*programs: Program, stage: Sequence[Program]) -> None:
        if stage is work.programs.measuring:
            life.move(RunEvent.LAUNCH)
        processes.start(link, work.prepared.scripts, remote, *programs, setup=work.setup)

    start(*([work.programs.sampler] if work.programs.sampler else []), *first, stage=first)
    for stage in later:
        names = [program.name for program in work.programs.awaited]
        _wait_ready(work, names)
        if ended := processes.list_ended(link, remote, names):
            # The run has failed. What publishes would not notice, and take as long as if all were there.
            processes.end(link, remote, *names)
            return f"{ended[0]} ended before {stage[0].name} was started: {_last_word(work, ended[0])}"
        start(*stage, stage=stage)
    return None


def _wait_ready(work: ActiveRun, names: Sequence[str]) -> None:
    """Wait until these programs of the suite are ready, or one of them has ended.

    Without a service nobody but the programs themselves knows: they wait for one another.
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


def _observe(work: ActiveRun, life: RunLife, not_started: str | None, now: Clock) -> _Measured:
    """Observe what the run is about, then end the user's system where the run has started it."""
    assert work.run.observation is not None
    link, scripts, plan = work.link, work.prepared.scripts, work.run.observation
    life.move(RunEvent.OBSERVE)
    aftermath, failure = _Aftermath(is_attended=work.onlooker.is_attended), None
    if not_started is None:
        if work.programs.sampler:
            processes.start(link, scripts, work.remote, work.programs.sampler)
        trace = "" if work.run.trace == UNTRACED else work.run.trace
        watched = observation.watch(link, scripts, plan, trace=trace)
        observed = observation.observe(
            link, scripts, watched, plan, trace=trace, onlooker=work.onlooker, now=now, folder=work.folder.parent
        )
        aftermath.observed, aftermath.cut_off = observed, observed.cut_off
        work.onlooker.on_end(observed)
        with aftermath.keeping():
            if work.starts_system and (ended := system.end_of(link, work.remote)):
                failure = f"the system ended while it was observed, {ended}"
    exits = [Exit(status=None, expired=False) for _ in work.programs.of_suite]
    with aftermath.keeping():
        if work.starts_system:
            exits = [system.end(link, work.remote)]
    with aftermath.keeping():
        life.move(RunEvent.END)
    return _Measured(exits=exits, failure=failure, aftermath=aftermath)


def _wait(work: ActiveRun, life: RunLife) -> _Measured:
    """Wait for the programs of the suite."""
    link, failure = work.link, None
    awaited = [program.name for program in work.programs.awaited]
    exits = []
    for program in work.programs.of_suite:
        needed = [] if failure or program.name in awaited else awaited
        if work.programs.need_one_another and not failure:
            needed = [name for name in work.programs.suite_names if name != program.name]
        deadline_s = program.deadline_s + END_GRACE_S
        ended = processes.wait(link, work.remote, program.name, deadline_s=deadline_s, needed=needed)
        if isinstance(ended, processes.NeededFailed):
            # As when it fails before: what publishes would go on for as long as if it were there.
            failure = f"{ended.name} ended while {program.name} was running: {_last_word(work, ended.name)}"
            processes.end(link, work.remote, *work.programs.suite_names)
            ended = processes.wait(link, work.remote, program.name, deadline_s=deadline_s)
        exits.append(ended)
        if failure is None and program.name not in awaited and exits[-1].status != 0:
            # What it sends to may never have seen it, and would wait until its own deadline.
            processes.end(link, work.remote, *awaited)
    service = _service(work)
    life.move(RunEvent.END)
    return _Measured(exits=exits, failure=failure, service=service)


def _end_background(work: ActiveRun, measured: _Measured, not_started: str | None) -> RunEnd:
    failure = not_started or measured.failure
    limits, state_script = work.programs.file_limits, work.prepared.scripts / "state.sh"
    if not work.programs.names:
        after = inspection.read_state(work.link, state_script)
        return RunEnd(failure=failure, exits=(), ended_early={}, service="", after=after, files={})
    ended = processes.end_background(
        work.link,
        work.remote,
        [] if work.run.observation else work.programs.suite_names,
        work.programs.load_names,
        work.programs.other_names,
        service=measured.service,
        # Of what is observed nobody else tells when it is over: the end of the loads must not be seen.
        first=[work.programs.sampler.name] if work.run.observation and work.programs.sampler else [],
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
