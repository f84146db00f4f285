"""Which runs are measured next: they come in rounds."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.plan.run import Run
from rtrun.results.record import read_record


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """Runs to measure now. Where the target is on one of `used_boots`, it is to be restarted first."""

    runs: tuple[Run, ...]
    used_boots: frozenset[str] = frozenset()


NextRound = Callable[[Collection[str], Collection[str]], Round | None]
"""What a board measures next; None: nothing is left for it.

Called with the names of the runs that other boards have, and with those of the runs that were begun on this one.
"""


def rounds_of_blocks(
    blocks: Sequence[Sequence[Run]], needed: Collection[str], done: Collection[str], results: Path
) -> NextRound:
    """The runs of a plan that are `needed`, a round for each block; `done` grows while the caller measures.

    The block of a run that was begun on the board comes first. No two blocks are measured on one boot.
    """

    def next_round(taken: Collection[str], begun: Collection[str]) -> Round | None:
        ordered = sorted(blocks, key=lambda block: set(begun).isdisjoint(run.name for run in block))
        for block in ordered:
            if todo := tuple(run for run in block if run.name in needed and run.name not in {*taken, *done}):
                others = [run for each in blocks if each is not block for run in each]
                boots = filter(None, (_boot_of(results / run.name) for run in others)) if len(blocks) > 1 else ()
                return Round(runs=todo, used_boots=frozenset(boots))
        return None

    return next_round


def _boot_of(folder: Path) -> str:
    """The boot that a run was measured on; empty where that is not known."""
    try:
        return str(read_record(folder).target.boot_id or "")
    except UsageError:
        return ""
