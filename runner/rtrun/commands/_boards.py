"""The targets of `rtrun run`, one or several, and a campaign measured on them."""

import contextlib
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtfiles.output import console
from rtrun.execution import campaign_runner
from rtrun.execution.board import Observer
from rtrun.execution.board_progress import showing_boards
from rtrun.execution.campaign_runner import PlanRounds
from rtrun.execution.farm import Board
from rtrun.plan.campaign import Variant
from rtrun.plan.run import Run
from rtrun.results.record import RunStatus
from rtrun.target.config import TargetConfig, connect, read_target


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetFile:
    """What a target file says, and the folder that its relative paths are relative to."""

    config: TargetConfig
    folder: Path

    @property
    def name(self) -> str:
        """Of the target."""
        return self.config.name


def read_targets(paths: Sequence[Path]) -> tuple[TargetFile, ...]:
    """Read target files. Raises UsageError with what is wrong, also when two are of one name."""
    targets: dict[str, TargetFile] = {}
    for path in paths:
        target = TargetFile(config=read_target(path), folder=path.parent)
        if target.name in targets:
            raise UsageError(f"{path}: name: a second target called {target.name}: each board needs a name of its own")
        targets[target.name] = target
    return tuple(targets.values())


def measure_on(
    targets: Sequence[TargetFile],
    name: str,
    runs: Sequence[Run],
    results: Path,
    observer: Observer,
    *,
    variants: Mapping[str, Variant],
    rounds: PlanRounds | None = None,
) -> dict[str, RunStatus]:
    """Measure a campaign on these targets. `observer` shows the progress where it is one target."""
    if len(targets) == 1:
        (only,) = targets
        with connect(only.config, only.folder, results / "console.log") as target:
            return campaign_runner.run_campaign(target, name, runs, results, observer, variants=variants, rounds=rounds)
    with contextlib.ExitStack() as stack:
        lines = stack.enter_context(showing_boards([each.name for each in targets], console()))
        boards = [
            Board(
                name=each.name,
                connect=functools.partial(connect, each.config, each.folder, results / f"console-{each.name}.log"),
                observer=lines[each.name],
            )
            for each in targets
        ]
        return campaign_runner.run_campaign_on_boards(
            boards, name, runs, results, observer, variants=variants, rounds=rounds
        )
