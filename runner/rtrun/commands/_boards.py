"""The targets of `rtrun run`, one or several, and a campaign measured on them."""

import contextlib
import functools
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from rtfiles import atomic
from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.output import console, print_line, print_note
from rtrun.execution import campaign_runner
from rtrun.execution.board import Observer
from rtrun.execution.board_progress import showing_boards
from rtrun.execution.campaign_runner import PlanRounds
from rtrun.execution.farm import Board
from rtrun.execution.progress import showing
from rtrun.plan.campaign import Variant, read_campaign
from rtrun.plan.run import Run
from rtrun.results.journal import place_of_begun
from rtrun.results.record import RunStatus
from rtrun.targets.config import LabgridConfig, Target, TargetConfig, connect, parse_target, read_target
from rtrun.targets.labgrid import environment as labgrid_environment
from rtrun.targets.labgrid import places as labgrid
from rtrun.targets.labgrid.coordinator import coordinator_of, list_places, matching


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetFile:
    """The content of a target file, and the folder that its relative paths refer to."""

    config: TargetConfig
    folder: Path

    @property
    def name(self) -> str:
        """The name of the target."""
        return self.config.name


def read_targets(
    paths: Sequence[Path], farms: Sequence[str] = (), environment: Path | None = None
) -> tuple[TargetFile, ...]:
    """Read target files, and find the places of farms, given as ``labgrid:KEY=VALUE,...`` (tags of the places).

    `environment` is labgrid's environment file for all places; given alone, it selects the places that it names. Raises
    UsageError with what is wrong, also when two targets have the same name, and TargetError when a coordinator does not
    answer.
    """
    named = [(path, TargetFile(config=read_target(path), folder=path.parent)) for path in paths]
    given = None if environment is None else labgrid_environment.read_environment(environment)
    places = [place for farm in farms for place in _find_places(farm, given)]
    if given is not None and not paths and not farms:
        places = list(given.keys)
    named += [(Path(f"place {place}"), _target_of(place)) for place in places]
    if not named:
        raise UsageError("name what to measure on: --target FILE, --targets labgrid:TAG=VALUE or --lg-env FILE")
    targets: dict[str, TargetFile] = {}
    for path, target in named:
        if target.name in targets:
            raise UsageError(f"{path}: name: a second target called {target.name}: each board needs a name of its own")
        if environment is not None and isinstance(target.config, LabgridConfig):
            config = target.config.model_copy(update={"environment": str(environment.absolute())})
            target = replace(target, config=config)
        targets[target.name] = target
    return tuple(targets.values())


def _find_places(farm: str, environment: labgrid_environment.Environment | None) -> list[str]:
    """The places of ``labgrid:KEY=VALUE,...`` that are not in quarantine.

    Raises UsageError when there are none, TargetError when all are in quarantine.
    """
    kind, _, text = farm.partition(":")
    tags = dict(pair.partition("=")[::2] for pair in text.split(","))
    if kind != "labgrid" or not all(tags) or not all(tags.values()):
        raise UsageError(f"--targets {farm}: takes labgrid:KEY=VALUE, tags of the places, several with a comma between")
    coordinator = coordinator_of(None, environment or labgrid_environment.Environment())
    places = list_places(coordinator)
    if found := matching(places, tags):
        healthy, left_out = labgrid.without_quarantine(found)
        if left_out:
            print_note(f"rtrun: {left_out}: left out")
        return [place.name for place in healthy]
    there = ", ".join(place.name for place in places) or "none"
    raise UsageError(f"--targets {farm}: the coordinator at {coordinator} has no such place; its places: {there}")


def _target_of(place: str) -> TargetFile:
    # Characters that the name of a target must not have are replaced.
    name = re.sub("[^A-Za-z0-9._-]", "-", place).lstrip("._-") or "place"
    data = {"schema": 1, "name": name, "kind": "labgrid", "place": place}
    return TargetFile(config=parse_target(data, f"place {place}"), folder=Path())


def measure_on(
    targets: Sequence[TargetFile],
    name: str,
    runs: Sequence[Run],
    results: Path,
    observer: Observer,
    *,
    variants: Mapping[str, Variant],
    chosen: Sequence[Run] | None = None,
    rounds: PlanRounds | None = None,
) -> dict[str, RunStatus]:
    """Measure a campaign, or its chosen runs, on these targets. `observer` shows the progress of a single target."""
    if len(targets) == 1:
        (only,) = targets
        with _connect(only, results, "console.log", observer, lambda: False) as target:
            return campaign_runner.run_campaign(
                target, name, runs, results, observer, chosen=chosen, variants=variants, rounds=rounds
            )
    with contextlib.ExitStack() as stack:
        lines = stack.enter_context(showing_boards([target.name for target in targets], runs, console()))
        boards = [
            Board(
                name=target.name,
                connect=functools.partial(_connect, target, results, f"console-{target.name}.log", lines[target.name]),
                observer=lines[target.name],
            )
            for target in targets
        ]
        return campaign_runner.run_campaign_on_boards(
            boards, name, runs, results, observer, chosen=chosen, variants=variants, rounds=rounds
        )


def measure_made(campaign: Mapping[str, object], target: TargetFile, results: Path) -> dict[str, RunStatus]:
    """Measure what is not measured yet of a campaign of ours; its file is kept in the results."""
    file = results / "campaign.yml"
    atomic.write_text(file, yaml.safe_dump(dict(campaign), sort_keys=False))
    planned, runs = read_campaign(file)
    if not campaign_runner.find_unfinished(results, planned.name, runs, target.name):
        return {}
    with showing(runs, console()) as shown:
        return measure_on([target], planned.name, runs, results, shown, variants={})


def print_failed(statuses: Mapping[str, RunStatus]) -> int:
    """Print a line for each run that is not ok; return the exit status, which is 0 if there is none."""
    bad = {name: status for name, status in statuses.items() if status is not RunStatus.OK}
    for name, status in bad.items():
        print_line(f"{name}: {status}")
    return InfrastructureError.exit_status if bad else 0


def _connect(
    target: TargetFile, results: Path, console_log: str, observer: Observer, is_over: Callable[[], bool]
) -> AbstractContextManager[Target]:
    return connect(
        target.config,
        target.folder,
        results / console_log,
        notify=observer.note,
        is_over=is_over,
        preferred=place_of_begun(results, target.name),
    )
