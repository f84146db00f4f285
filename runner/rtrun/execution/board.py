"""The work on one board: its runs are measured and closed one after the other, through lost links and restarts."""

import contextlib
import functools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from rtfiles.errors import UsageError
from rtrun.execution import preparation, resumption, run_execution
from rtrun.execution.allotment import Round
from rtrun.execution.observation import Onlooker
from rtrun.execution.trace_threshold import with_threshold_of_warm_up
from rtrun.plan.campaign import Variant
from rtrun.plan.run import KernelName, Run
from rtrun.results.figures_so_far import FiguresSoFar
from rtrun.results.journal import Journal
from rtrun.results.record import RunStatus, is_finished, read_record
from rtrun.results.run_state import RunEvent, RunLife, RunState
from rtrun.targets import processes
from rtrun.targets.errors import TargetError
from rtrun.targets.inspection import work_folder
from rtrun.targets.inspection.facts import running_kernel
from rtrun.targets.inspection.kernel_trace import tracing
from rtrun.targets.link import Link, TargetRebooted
from rtrun.targets.restart import check_restart, restart

# If a board restarts during each of this many attempts, it will not complete the run.
ATTEMPTS = 3

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """The time now, for records only: nothing is measured with it."""
    return datetime.now(UTC)


class Observer(Protocol):
    """Shows the user the progress of a board."""

    def began(self, number: int, run: Run) -> None: ...
    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None: ...
    def note(self, text: str) -> None: ...

    @property
    def on_figures(self) -> Callable[[FiguresSoFar], None] | None:
        """Shows what the run has measured so far; None: this is not shown, and the target is not asked for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """One call's work on a campaign, the same for all boards that share it."""

    campaign: str
    log: Journal
    runs: Sequence[Run]
    """The runs of the campaign; if it has rounds, its groups."""
    chosen: Sequence[Run]
    """The runs that this call is to measure."""
    needed: Sequence[Run]
    """The chosen runs that are not finished yet; with rounds, all of them."""
    finished: Mapping[str, RunStatus]
    """What the chosen runs were before this call, by name: OK or INCOMPLETE; with rounds, empty."""
    results: Path
    variants: Mapping[str, Variant]
    now: Clock
    owners: Mapping[str, str] = field(default_factory=dict)
    """Name of an unfinished run to the target that an earlier call gave it to."""
    statuses: dict[str, RunStatus] = field(default_factory=dict)
    """The statuses of the runs of this call, by name. Each run that is closed adds its own."""

    @property
    def all_statuses(self) -> dict[str, RunStatus]:
        """The statuses of the runs of this call and of earlier calls, by name."""
        return {**self.finished, **self.statuses}

    def known_runs(self) -> set[str]:
        """The names of the runs that may have a folder on a board."""
        return {run.name for run in self.runs} | self.log.begun()


def measure_rounds(
    session: Session, link: Link, observer: Observer, take_round: Callable[[Collection[str]], Round | None]
) -> None:
    """Measure rounds on a board until `take_round` gives no more. Its argument are the runs begun there earlier.

    Raises UsageError when the board cannot do what the campaign asks for, TargetError when it cannot go on.
    """
    if len(kernels := dict.fromkeys(run.kernel for run in session.needed if run.kernel)) > 1:
        check_restart(link.target, kernels)
    if link.target.place is not None:
        session.log.note_place(session.now().isoformat(), link.target.name, link.target.place)
    numbers = {run.name: number for number, run in enumerate(session.chosen)}
    remote = link.target.work_dir / "runs" / session.log.uid

    def may_run_go_on() -> bool:
        # A run of another campaign may use a service of ours, for example the ROS master.
        return resumption.may_run_go_on(link, remote, session.known_runs()) or resumption.is_busy(link)

    with link, contextlib.closing(_PreparedTarget(link, session, may_run_go_on, observer.note)) as prepared:
        # This must come first: the contents of the folder decide what is ended or removed later.
        work_folder.make(link)
        # Runs that an earlier call left on the board come first: two runs at once would disturb each other.
        begun = frozenset(resumption.list_folders(link, remote, session.known_runs()))
        foreign = {name for name in begun if _is_foreign(session, name, link.target.name)}
        for name in foreign:
            processes.give_up(link, remote / name)
        while current_round := take_round(begun - foreign):
            if len(session.log.targets) > 1:
                for run in current_round.runs:
                    session.log.give(session.now().isoformat(), run.name, link.target.name)
            try:
                if link.boot_id in current_round.used_boots:
                    prepared.restart(current_round.runs[0].kernel)
                # Prepare now, so that it does not count as time of a run.
                prepared.get(current_round.runs[0].kernel)
            except TargetRebooted as error:
                # The target restarted on its own. The first run prepares it anew.
                prepared.close()
                observer.note(str(error))
            for run in sorted(current_round.runs, key=lambda run: run.name not in begun):
                # A run in a round does not have the name of its group.
                number = numbers.get(run.name, 0)
                observer.began(number, run)
                if is_finished(session.results / run.name):
                    # Another board closed the run, and failed afterwards.
                    session.statuses[run.name] = RunStatus.OK
                    observer.ended(number, run, RunStatus.OK, None)
                    continue
                try:
                    run = with_threshold_of_warm_up(run, session.results)
                except UsageError as error:
                    session.statuses[run.name] = RunStatus.INCOMPLETE
                    observer.ended(number, run, RunStatus.INCOMPLETE, f"no limit for its traces: {error}")
                    continue
                status, reason = _measure(session, prepared, run, observer, may_be_begun=run.name in begun)
                session.statuses[run.name] = status
                observer.ended(number, run, status, reason)
        if left := begun - foreign - session.statuses.keys():
            observer.note(f"{', '.join(sorted(left))}: begun by an earlier call, left for one that measures it")
            return
        # Nothing of the campaign stays on the board, not even an empty folder.
        with contextlib.suppress(TargetRebooted):
            processes.remove(link, remote)


def _is_foreign(session: Session, run: str, target: str) -> bool:
    """Whether another board has taken over a run that this board had begun before it became unreachable."""
    return session.owners.get(run, target) != target or is_finished(session.results / run)


def _measure(
    session: Session, prepared: "_PreparedTarget", run: Run, observer: Observer, *, may_be_begun: bool
) -> tuple[RunStatus, str | None]:
    """Measure a run, again after each restart of the target that cuts it off; return its status and the reason.

    Raises TargetRebooted after too many restarts.
    """
    folder = session.results / run.name
    for attempts_left in reversed(range(ATTEMPTS)):
        life = RunLife(lambda state, reason: session.log.note(session.now().isoformat(), run.name, state, reason))
        try:
            ready = prepared.get(run.kernel).for_run(run)
            if lacks := ready.lacks(run):
                return RunStatus.INCOMPLETE, lacks
            with tracing(ready.link, ready.scripts, run.parameters, prepared.may_run_go_on):
                record = run_execution.measure(
                    ready,
                    session.log.uid,
                    session.campaign,
                    run,
                    folder,
                    life,
                    session.now,
                    may_be_begun=may_be_begun,
                    onlooker=Onlooker(on_figures=observer.on_figures),
                )
            return record.status, record.reason
        except TargetRebooted as error:
            prepared.close()
            may_be_begun = True
            life.move(RunEvent.RESTART, str(error))
            observer.note(f"{run.name}: {error}")
            if life.state is RunState.CLOSED:
                record = read_record(folder)
                # An observation that was cut off has closed a run with what it saw.
                if not run.subject.is_observed or record.status is not RunStatus.INCOMPLETE or not attempts_left:
                    return record.status, record.reason
            if not attempts_left:
                raise
    raise AssertionError("the last attempt returns or raises")


class _PreparedTarget:
    """The target, prepared when it is first needed, and again after each restart."""

    def __init__(
        self, link: Link, session: Session, may_run_go_on: Callable[[], bool], notify: Callable[[str], None]
    ) -> None:
        self._link, self._notify = link, notify
        self.may_run_go_on = may_run_go_on
        owner, runs = session.log.uid, session.needed
        self._prepare = functools.partial(preparation.prepared, link, owner, runs, may_run_go_on, session.variants)
        self._stack = contextlib.ExitStack()
        self._ready: preparation.Prepared | None = None
        self._kernels: dict[str, KernelName] = {}
        """The kernel that the target ran, by boot."""

    def get(self, kernel: KernelName | None = None) -> preparation.Prepared:
        """Return the target ready for runs; if a kernel is named, restart into it where necessary.

        Raises UsageError when the target cannot be restarted into it, TargetError when it runs another one afterwards.
        """
        if kernel is not None and self._running_kernel() != kernel:
            self.restart(kernel)
            if (running := self._running_kernel()) != kernel:
                raise TargetError(
                    f"{self._link.target.address}: restarted into the kernel {kernel}, it runs {running} "
                    f"(uname -v says which): nothing is measured on it; check boot_kernel.{kernel} in the target file"
                )
        if self._ready is None:
            self._ready = self._stack.enter_context(self._prepare())
        return self._ready

    def _running_kernel(self) -> KernelName:
        boot_id = self._link.boot_id
        if boot_id not in self._kernels:
            self._kernels[boot_id] = running_kernel(self._link)
        return self._kernels[boot_id]

    def restart(self, kernel: KernelName | None) -> None:
        """Restart the target, into a kernel where one is named. Raises TargetError when a run is going on there."""
        resumption.check_idle(self._link)
        into = f"into the kernel {kernel}" if kernel else "for the next round, which is to be on another boot"
        self._notify(f"restarting the target {into}")
        self.close()
        restart(self._link, kernel)

    def close(self) -> None:
        """End what was prepared; after a restart it is gone."""
        self._ready = None
        self._stack.close()
