"""Run a campaign: open its results folder and journal, and measure every unfinished run on its target."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.execution.allotment import NextRound, rounds_of_blocks
from rtrun.execution.board import Clock, Observer, Session, measure_rounds, utc_now
from rtrun.execution.farm import Board, measure_on_boards
from rtrun.plan.campaign import Variant
from rtrun.plan.run import Run, blocks, digest_of
from rtrun.results import journal, run_directory
from rtrun.results.record import RunStatus, is_finished
from rtrun.targets.config import Target
from rtrun.targets.link import Link

PlanRounds = Callable[[Callable[[], float]], NextRound]
"""Makes the rounds from a function that returns the time spent so far, in seconds."""


def find_unfinished(results: Path, name: str, runs: Sequence[Run], *targets: str) -> list[tuple[int, Run]]:
    """Return the runs of a campaign that are still to be measured into a results folder, with their numbers.

    Raises UsageError when the folder holds another campaign, or this one on other targets.
    """
    run_directory.make_results(results)
    with journal.at_work(results), _open_journal(results, name, runs, targets):
        return _unfinished(results, runs)


def has_rounds(results: Path, name: str, groups: Sequence[Run], rounds: PlanRounds, *targets: str) -> bool:
    """Whether a campaign with rounds has anything left to measure. Raises UsageError as `find_unfinished`."""
    run_directory.make_results(results)
    with journal.at_work(results), _open_journal(results, name, groups, targets) as log:
        # No call has run since the last event, so the time since then does not count.
        return rounds(lambda: log.spent_s(None))((), ()) is not None


def run_campaign(
    target: Target,
    name: str,
    runs: Sequence[Run],
    results: Path,
    observer: Observer,
    *,
    chosen: Sequence[Run] | None = None,
    variants: Mapping[str, Variant] | None = None,
    rounds: PlanRounds | None = None,
    now: Clock = utc_now,
) -> dict[str, RunStatus]:
    """Measure every run that is not finished yet on a target and return run name to status.

    Only the `chosen` of a campaign's `runs` are measured, by default all. With `rounds`, the runs are groups, `rounds`
    plans what is measured, and the statuses are only those of this call. Raises UsageError when the folder holds
    another campaign, TargetError when the target cannot go on. In either case finished runs are kept, and another call
    continues after them.
    """
    chosen = runs if chosen is None else chosen
    with _session(results, name, runs, chosen, [target.name], observer, variants, rounds, now) as session:
        if session.needed:
            next_round = _next_round(session, blocks(runs), rounds)
            measure_rounds(session, Link(target, observer.note), observer, lambda begun: next_round((), begun))
        return session.all_statuses


def run_campaign_on_boards(
    boards: Sequence[Board],
    name: str,
    runs: Sequence[Run],
    results: Path,
    observer: Observer,
    *,
    chosen: Sequence[Run] | None = None,
    variants: Mapping[str, Variant] | None = None,
    rounds: PlanRounds | None = None,
    now: Clock = utc_now,
) -> dict[str, RunStatus]:
    """`run_campaign` on several boards at once: a free board measures what comes next.

    A board that cannot go on tells its observer and leaves its runs to the others. Raises TargetError when no board is
    left. `observer` takes the remarks that concern no single board.
    """
    names = [board.name for board in boards]
    chosen = runs if chosen is None else chosen
    with _session(results, name, runs, chosen, names, observer, variants, rounds, now) as session:
        if session.needed:
            divided = blocks(runs, is_shared=True)
            if rounds is None and len(divided) < len(boards):
                observer.note(f"{len(boards)} boards, but only {len(divided)} repeats to measure: some have no work")
            measure_on_boards(session, boards, _next_round(session, divided, rounds))
        return session.all_statuses


def _next_round(session: Session, divided: Sequence[Sequence[Run]], rounds: PlanRounds | None) -> NextRound:
    if rounds is not None:
        return rounds(lambda: session.log.spent_s(session.now()))
    return rounds_of_blocks(divided, {run.name for run in session.needed}, session.statuses, session.results)


@contextlib.contextmanager
def _session(
    results: Path,
    name: str,
    runs: Sequence[Run],
    chosen: Sequence[Run],
    targets: Sequence[str],
    observer: Observer,
    variants: Mapping[str, Variant] | None,
    rounds: PlanRounds | None,
    now: Clock,
) -> Iterator[Session]:
    run_directory.make_results(results)
    with journal.at_work(results), _open_journal(results, name, runs, targets) as log:
        needed, finished = list(chosen), dict[str, RunStatus]()
        if rounds is None:
            needed = [run for _, run in _unfinished(results, chosen)]
            finished = {run.name: RunStatus.OK for run in chosen}
            finished |= {run.name: RunStatus.INCOMPLETE for run in needed}
            if 0 < len(needed) < len(chosen):
                observer.note(f"going on in {results}: {len(chosen) - len(needed)} of {len(chosen)} runs are finished")
        owners = log.owners()
        log = log.add_targets(targets)
        log.begin_session(now().isoformat())
        yield Session(
            campaign=name,
            log=log,
            runs=runs,
            chosen=chosen,
            needed=needed,
            finished=finished,
            results=results,
            variants=variants or {},
            now=now,
            owners=owners,
        )


@contextlib.contextmanager
def _open_journal(results: Path, name: str, runs: Sequence[Run], targets: Sequence[str]) -> Iterator[journal.Journal]:
    """Open the journal of these results. Raises UsageError when it belongs to another campaign or other targets."""
    digest = digest_of(runs)
    with contextlib.closing(journal.open_journal(results, name, digest, *targets)) as log:
        remedy = "give another folder with --results, or --fresh"
        if set(targets).isdisjoint(log.targets):
            held = ", ".join(log.targets)
            raise UsageError(f"{results}: holds runs on the target {held}, not {', '.join(targets)}: {remedy}")
        if log.plan != digest:
            raise UsageError(f"{results}: holds another campaign, its file has changed since: {remedy}")
        yield log


def count_finished(results: Path, runs: Sequence[Run]) -> int:
    """Return how many runs of a plan are finished in a results folder."""
    return len(runs) - len(_unfinished(results, runs))


def _unfinished(results: Path, runs: Sequence[Run]) -> list[tuple[int, Run]]:
    return [(number, run) for number, run in enumerate(runs) if not is_finished(results / run.name)]
