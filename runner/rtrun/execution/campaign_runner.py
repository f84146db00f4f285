"""A campaign on a target: every planned run is measured and closed, through lost links and restarts."""

import contextlib
import fcntl
import functools
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from rtfiles.errors import UsageError
from rtrun.execution import journal, preparation, resumption, run_execution
from rtrun.execution.goal import Round
from rtrun.execution.run_state import RunEvent, RunLife, RunState
from rtrun.execution.trace_threshold import with_found_threshold
from rtrun.plan import campaign_digest
from rtrun.plan.campaign import Variant
from rtrun.plan.kernels import blocks
from rtrun.plan.run import KernelName, Run
from rtrun.results import run_directory
from rtrun.results.record import RunRecord, RunStatus, read_record, verify
from rtrun.target.config import Target
from rtrun.target.errors import TargetError
from rtrun.target.inspection import running_kernel
from rtrun.target.kernel_trace import tracing
from rtrun.target.link import Link, TargetRebooted
from rtrun.target.restart import check_restart, restart

# A board that restarts during each of so many attempts will not complete this run.
ATTEMPTS = 3

Clock = Callable[[], datetime]
# From the time spent so far, in seconds, to the rounds.
PlanRounds = Callable[[Callable[[], float]], Iterable[Round]]


def utc_now() -> datetime:
    """The time now, for records only: nothing is measured with it."""
    return datetime.now(UTC)


class Observer(Protocol):
    """What shows the user the progress of a campaign."""

    def began(self, number: int, run: Run) -> None: ...
    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None: ...
    def note(self, text: str) -> None: ...


def find_unfinished(results: Path, name: str, runs: Sequence[Run], target_name: str) -> list[tuple[int, Run]]:
    """Return the runs of a campaign that are still to be measured into a results folder, with their numbers.

    Raises UsageError when the folder holds another campaign, or this one on another target.
    """
    run_directory.make_results(results)
    with _lock(results), _open_journal(results, name, runs, target_name):
        return _unfinished(results, runs)


def has_rounds(results: Path, name: str, groups: Sequence[Run], target_name: str, rounds: PlanRounds) -> bool:
    """Whether there is something left to measure for a campaign with rounds. Raises UsageError as `find_unfinished`."""
    run_directory.make_results(results)
    with _lock(results), _open_journal(results, name, groups, target_name) as log:
        return next(iter(rounds(lambda: log.spent_s(utc_now()))), None) is not None


def run_campaign(
    target: Target,
    name: str,
    runs: Sequence[Run],
    results: Path,
    observer: Observer,
    *,
    variants: Mapping[str, Variant] | None = None,
    rounds: PlanRounds | None = None,
    now: Clock = utc_now,
) -> dict[str, RunStatus]:
    """Measure every run that is not finished yet and return run name to status.

    `rounds` plans what is measured instead, from the runs as their groups; the statuses are those of this call then.
    Raises UsageError when the folder holds another campaign, TargetError when the target cannot go on. What was
    finished before is kept in either case, and another call continues after it.
    """
    run_directory.make_results(results)
    with _lock(results), _open_journal(results, name, runs, target.name) as log:
        needed, statuses = list(runs), dict[str, RunStatus]()
        if rounds is None:
            needed = [run for _, run in _unfinished(results, runs)]
            statuses = {run.name: RunStatus.OK for run in runs}
            if not needed:
                return statuses
            if len(needed) < len(runs):
                observer.note(f"going on in {results}: {len(runs) - len(needed)} of {len(runs)} runs are finished")
        if len(kernels := dict.fromkeys(run.kernel for run in needed if run.kernel)) > 1:
            check_restart(target, kernels)
        numbers = {run.name: number for number, run in enumerate(runs)}
        remote = target.work_dir / "runs" / log.uid
        log.begin_session(now().isoformat())
        with (
            Link(target, observer.note) as link,
            _PreparedTarget(link, log.uid, needed, variants or {}, observer.note) as prepared,
        ):
            # Runs that an earlier call left on the target come first: two runs at once would disturb each other.
            started = frozenset(resumption.list_folders(link, remote))
            planned = rounds(lambda: log.spent_s(now())) if rounds else _rounds(results, runs, needed, started)
            for each in planned:
                try:
                    if link.boot_id in each.used_boots:
                        prepared.restart(each.runs[0].kernel)
                    # Now, so that it is not in the time of a run.
                    prepared.get(each.runs[0].kernel)
                except TargetRebooted as error:
                    # By itself. The first run prepares it anew.
                    prepared.drop()
                    observer.note(str(error))
                for run in sorted(each.runs, key=lambda run: run.name not in started):
                    # In a round the name of a run is not that of its group.
                    number = numbers.get(run.name, 0)
                    observer.began(number, run)
                    try:
                        run = with_found_threshold(run, results)
                    except UsageError as error:
                        statuses[run.name] = RunStatus.INCOMPLETE
                        observer.ended(number, run, RunStatus.INCOMPLETE, f"no limit for its traces: {error}")
                        continue
                    record = _measure(prepared, log, name, run, results / run.name, observer, now)
                    statuses[run.name] = record.status
                    observer.ended(number, run, record.status, record.reason)
            # A runner that was killed may have left something of runs that it had closed.
            with contextlib.suppress(TargetRebooted):
                link.check(["rm", "-rf", str(remote)])
        return statuses


def _rounds(results: Path, runs: Sequence[Run], needed: Collection[Run], started: frozenset[str]) -> Iterator[Round]:
    """Yield the runs that are needed, a round for each block; a block whose runs `started` on the target is first."""
    names = {run.name for run in needed}
    divided = blocks(runs)
    for block in sorted(divided, key=lambda block: started.isdisjoint(run.name for run in block)):
        if todo := tuple(run for run in block if run.name in names):
            others = [run for each in divided if each is not block for run in each]
            yield Round(runs=todo, used_boots=frozenset(filter(None, (_boot_of(results / run.name) for run in others))))


def _boot_of(folder: Path) -> str:
    """The boot that a run was measured on; empty where that is not known."""
    try:
        return str(read_record(folder).target.boot_id or "")
    except UsageError:
        return ""


def _measure(
    prepared: "_PreparedTarget",
    log: journal.Journal,
    campaign: str,
    run: Run,
    folder: Path,
    observer: Observer,
    now: Clock,
) -> RunRecord:
    """Measure a run, again after each restart of the target that cut it off. Raises TargetRebooted after too many."""
    for attempts_left in reversed(range(ATTEMPTS)):
        life = RunLife(lambda state, reason: log.note(now().isoformat(), run.name, state, reason))
        try:
            ready = prepared.get(run.kernel).for_run(run)
            with tracing(ready.link, ready.scripts, run.parameters):
                return run_execution.measure(ready, log.uid, campaign, run, folder, life, now)
        except TargetRebooted as error:
            prepared.drop()
            life.move(RunEvent.RESTART, str(error))
            observer.note(f"{run.name}: {error}")
            if life.state is RunState.CLOSED:
                return read_record(folder)
            if not attempts_left:
                raise
    raise AssertionError("the last attempt returns or raises")


class _PreparedTarget:
    """The target, prepared when it is asked for, and anew when it was restarted since."""

    def __init__(
        self,
        link: Link,
        owner: str,
        runs: Sequence[Run],
        variants: Mapping[str, Variant],
        notify: Callable[[str], None],
    ) -> None:
        self._link, self._notify = link, notify
        self._prepare = functools.partial(preparation.prepared, link, owner, runs, variants)
        self._stack = contextlib.ExitStack()
        self._ready: preparation.Prepared | None = None
        self._kernels: dict[str, KernelName] = {}
        """That it ran, by its boot."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def get(self, kernel: KernelName | None = None) -> preparation.Prepared:
        """Return it ready for runs; where a kernel is named, it runs that one, restarted into it if need be.

        Raises UsageError when the target cannot be restarted into it, TargetError when it runs another one then.
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
        self.drop()
        restart(self._link, kernel)

    def drop(self) -> None:
        """Forget what was prepared: after a restart it is gone."""
        self._ready = None
        self._stack.close()


@contextlib.contextmanager
def _open_journal(results: Path, name: str, runs: Sequence[Run], target_name: str) -> Iterator[journal.Journal]:
    """Open the journal of these results. Raises UsageError when it is of another campaign or target."""
    digest = campaign_digest.digest(runs)
    with contextlib.closing(journal.open_journal(results, name, digest, target_name)) as log:
        remedy = "give another folder with --results, or --fresh"
        if log.target != target_name:
            raise UsageError(f"{results}: holds runs on the target {log.target}, not {target_name}: {remedy}")
        if not campaign_digest.is_digest_of(log.plan, runs):
            raise UsageError(f"{results}: holds another campaign, its file has changed since: {remedy}")
        if log.plan != digest:
            log.replace_plan(digest)
        yield log


@contextlib.contextmanager
def _lock(results: Path) -> Iterator[None]:
    """Keep a second runner away from these results; the lock ends with the process, however that ends."""
    path = results / ".lock"
    try:
        # Not through a link, and nothing is written: the file may be somebody else's.
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise UsageError(f"{path}: cannot be locked, remove it: {error.strerror}") from error
    with os.fdopen(handle, "rb", buffering=0) as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UsageError(f"{results}: another rtrun is at work there: wait for it, or give --results") from error
        yield


def count_finished(results: Path, runs: Sequence[Run]) -> int:
    """Return how many runs of a plan are finished in a results folder."""
    return len(runs) - len(_unfinished(results, runs))


def _unfinished(results: Path, runs: Sequence[Run]) -> list[tuple[int, Run]]:
    return [(number, run) for number, run in enumerate(runs) if not _is_finished(results / run.name)]


def _is_finished(folder: Path) -> bool:
    """Whether a run is closed with status ok and its files are those that it was closed with."""
    try:
        return verify(folder).status is RunStatus.OK
    except UsageError:
        return False
