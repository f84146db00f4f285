"""A campaign on a target: every planned run is measured, pulled back and closed, whatever happens in between."""

import contextlib
import fcntl
import functools
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from rtfiles.errors import UsageError
from rtrun.execution import journal, preparation, resumption, run_execution
from rtrun.plan.campaign import Run
from rtrun.results import run_directory
from rtrun.results.record import RunStatus
from rtrun.target.config import Target
from rtrun.target.kernel_trace import tracing
from rtrun.target.link import Link, TargetRebooted

# A board that restarts under every attempt will not carry this run.
ATTEMPTS = 3

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """The time now, for records only: nothing is measured with it."""
    return datetime.now(UTC)


class Observer(Protocol):
    """Whoever shows the user how far a campaign is."""

    def began(self, number: int, run: Run) -> None: ...
    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None: ...
    def note(self, text: str) -> None: ...


def run_campaign(
    target: Target,
    name: str,
    runs: Sequence[Run],
    results: Path,
    observer: Observer,
    *,
    now: Clock = utc_now,
) -> dict[str, RunStatus]:
    """Measure every run that is not finished yet and return run name to status.

    Raises UsageError when the folder holds another campaign, TargetError when the target cannot go on. What was
    finished before is kept in either case, and another call goes on behind it.
    """
    run_directory.make_results(results)
    digest = hashlib.sha256(json.dumps([asdict(run) for run in runs], sort_keys=True).encode()).hexdigest()
    with _alone(results), contextlib.closing(journal.open_journal(results, name, digest, target.name)) as log:
        if (log.plan, log.target) != (digest, target.name):
            raise UsageError(
                f"{results}: holds another campaign (its file or target has changed since): "
                "give another folder with --results, or --fresh"
            )
        statuses = {run.name: RunStatus.OK for run in runs if _is_finished(results / run.name)}
        todo = [(number, run) for number, run in enumerate(runs) if run.name not in statuses]
        if statuses and todo:
            observer.note(f"going on in {results}: {len(statuses)} of {len(runs)} runs are finished")
        if not todo:
            return statuses
        with contextlib.ExitStack() as stack:
            link = stack.enter_context(Link(target, observer.note))
            prepared_stack = stack.enter_context(contextlib.ExitStack())
            preparing = functools.partial(preparation.prepared, link, log.uid, [run for _, run in todo])
            prepared: preparation.Prepared | None = prepared_stack.enter_context(preparing())
            # First what an earlier call left going on: two runs at once would disturb each other.
            there = resumption.folders(link, target.work_dir / "runs" / log.uid)
            todo.sort(key=lambda each: each[1].name not in there)
            for number, run in todo:
                observer.began(number, run)
                folder = results / run.name
                for trial in range(1, ATTEMPTS + 1):
                    closed = run_directory.closing_record(folder)
                    log.note(now().isoformat(), run.name, "began")
                    try:
                        if prepared is None:
                            prepared = prepared_stack.enter_context(preparing())
                        with tracing(link, prepared.scripts, run.parameters):
                            ended = run_execution.measure(prepared, log.uid, name, run, folder, now)
                    except TargetRebooted as error:
                        prepared_stack.close()
                        prepared = None
                        observer.note(f"{run.name}: {error}")
                        record = run_directory.closing_record(folder)
                        if record is None or record == closed:
                            log.note(now().isoformat(), run.name, "cut off", str(error))
                            if trial == ATTEMPTS:
                                raise
                            continue
                        # It was closed already: the restart has cut nothing off.
                        ended = record
                    except BaseException as error:
                        log.note(now().isoformat(), run.name, "stopped", str(error) or type(error).__name__)
                        raise
                    log.note(now().isoformat(), run.name, ended.status, ended.reason)
                    statuses[run.name] = ended.status
                    observer.ended(number, run, ended.status, ended.reason)
                    break
            # A runner that was killed may have left something of runs it had closed.
            leftovers = str(target.work_dir / "runs" / log.uid)
            with contextlib.suppress(TargetRebooted):
                link.check(["rm", "-rf", leftovers])
        return statuses


@contextlib.contextmanager
def _alone(results: Path) -> Iterator[None]:
    """Keep a second runner away from these results; the lock ends with the process, however that ends."""
    with (results / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UsageError(f"{results}: another rtrun is at work there: wait for it, or give --results") from error
        yield


def finished(results: Path, runs: Sequence[Run]) -> int:
    """Return how many runs of a plan are finished in a results folder."""
    return sum(_is_finished(results / run.name) for run in runs)


def _is_finished(folder: Path) -> bool:
    closed = run_directory.closing_record(folder)
    return closed is not None and closed.status is RunStatus.OK
