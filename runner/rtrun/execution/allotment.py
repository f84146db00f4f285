"""Which board measures what next: runs are handed out in rounds, and a free board takes the next one."""

import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.plan.run import Run
from rtrun.results.record import read_record


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """Runs to measure now. If the target's present boot is among `used_boots`, restart it first."""

    runs: tuple[Run, ...]
    used_boots: frozenset[str] = frozenset()


NextRound = Callable[[Collection[str], Collection[str]], Round | None]
"""Returns the round that a board measures next; None: nothing is left for it.

The arguments are the names of the runs that other boards have, and of the runs that were begun on this board.
"""


def rounds_of_blocks(
    blocks: Sequence[Sequence[Run]], needed: Collection[str], done: Collection[str], results: Path
) -> NextRound:
    """Hand out the `needed` runs of a plan, one block per round; `done` grows while the caller measures.

    A block with a run that was begun on the board comes first. In a plan with several kernels no two blocks share a
    boot.
    """
    has_kernels = len({run.kernel for block in blocks for run in block}) > 1

    def next_round(taken: Collection[str], begun: Collection[str]) -> Round | None:
        # Waiting boards ask again whenever a run ends, so this must be fast even with many runs.
        no_more = {*taken, *done}
        ordered = sorted(blocks, key=lambda block: {*begun}.isdisjoint(run.name for run in block)) if begun else blocks
        for block in ordered:
            if todo := tuple(run for run in block if run.name in needed and run.name not in no_more):
                others = [run for other in blocks if has_kernels and other is not block for run in other]
                boots = filter(None, (_boot_of(results / run.name) for run in others))
                return Round(runs=todo, used_boots=frozenset(boots))
        return None

    return next_round


def _boot_of(folder: Path) -> str:
    """The boot that a run was measured on; empty where that is not known."""
    try:
        return str(read_record(folder).target.boot_id or "")
    except UsageError:
        return ""


class Allotment:
    """Hands out the rounds of a campaign to boards that ask from their own threads; no two boards get the same run.

    `owners` maps each unfinished run to the board that an earlier call gave it to. The run stays with that board as
    long as the board takes part.
    """

    def __init__(self, next_round: NextRound, boards: Collection[str], owners: Mapping[str, str]) -> None:
        self._next_round = next_round
        self._owners = {run: board for run, board in owners.items() if board in boards}
        self._measuring: dict[str, tuple[str, ...]] = {}
        self._is_stopped = False
        self.is_over = False
        """Whether nothing is left to measure, or `end` or `stop` was called."""
        self._changed = threading.Condition()
        self._is_planning = False
        self._returned = 0
        """How many times a board gave back its runs."""

    def take(self, board: str, begun: Collection[str]) -> Round | None:
        """Return the next round for a board that has closed the runs of its last one; None: the campaign is over.

        `begun` are the runs that an earlier call began on this board. Waits while other boards may fail and leave their
        runs to this one. Raises KeyboardInterrupt after `stop`.
        """
        with self._changed:
            self._return(board)
            asked_at = -1
            while not self._is_stopped:
                if self.is_over:
                    return None
                if self._is_planning or asked_at == self._returned:
                    self._changed.wait()
                    continue
                of_others = {run for runs in self._measuring.values() for run in runs}
                of_others |= {run for run, owner in self._owners.items() if owner != board}
                asked_at = self._returned
                planned = self._plan(of_others, begun)
                # The board was just offered the runs that an earlier call gave it; now any board may take them.
                self._owners = {run: owner for run, owner in self._owners.items() if owner != board}
                if self.is_over:
                    continue
                if planned is not None:
                    self._measuring[board] = tuple(run.name for run in planned.runs)
                    return planned
                if asked_at == self._returned and not self._measuring and not self._owners:
                    self.is_over = True
                    return None
            raise KeyboardInterrupt

    def _plan(self, of_others: Collection[str], begun: Collection[str]) -> Round | None:
        """Find the next round, which may require an analysis of all results; None if the campaign ends meanwhile.

        The analysis has its own thread. Only boards that also want a round wait for it.
        """
        planned: Future[Round | None] = Future()

        def plan() -> None:
            try:
                planned.set_result(self._next_round(of_others, begun))
            except BaseException as error:
                planned.set_exception(error)
            with self._changed:
                self._changed.notify_all()

        self._is_planning = True
        threading.Thread(target=plan, daemon=True).start()
        while not planned.done() and not self.is_over:
            self._changed.wait()
        self._is_planning = False
        self._changed.notify_all()
        return planned.result() if planned.done() else None

    def _return(self, board: str) -> None:
        self._measuring.pop(board, None)
        self._returned += 1
        self._changed.notify_all()

    def withdraw(self, board: str) -> None:
        """Leave the runs of a board to the others; it takes no more."""
        with self._changed:
            self._owners = {run: owner for run, owner in self._owners.items() if owner != board}
            self._return(board)

    def end(self) -> None:
        """Hand out nothing more; the boards finish the runs that they have."""
        with self._changed:
            self.is_over = True
            self._changed.notify_all()

    def stop(self) -> None:
        """Let the boards end at once."""
        with self._changed:
            self._is_stopped = self.is_over = True
            self._changed.notify_all()
