"""A campaign: its results folder and journal, and every run that is not finished yet measured on its target."""

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.execution import journal
from rtrun.execution.allotment import NextRound, rounds_of_blocks
from rtrun.execution.board import Clock, Observer, Session, measure_rounds, utc_now
from rtrun.plan import campaign_digest
from rtrun.plan.campaign import Variant
from rtrun.plan.kernels import blocks
from rtrun.plan.run import Run
from rtrun.results import run_directory
from rtrun.results.record import RunStatus, verify
from rtrun.target.config import Target
from rtrun.target.link import Link

PlanRounds = Callable[[Callable[[], float]], NextRound]
"""From the time spent so far, in seconds, to the rounds."""


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
        return rounds(lambda: log.spent_s(utc_now()))((), ()) is not None


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
        session = Session(
            campaign=name,
            log=log,
            runs=runs,
            needed=needed,
            results=results,
            variants=variants or {},
            now=now,
        )
        log.begin_session(now().isoformat())
        if rounds:
            next_round = rounds(lambda: log.spent_s(now()))
        else:
            names = {run.name for run in needed}
            next_round = rounds_of_blocks(blocks(runs), names, session.statuses, results)
        measure_rounds(session, Link(target, observer.note), observer, lambda begun: next_round((), begun))
        return statuses | session.statuses


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
