"""The state of each board of an archive and of a labgrid farm: failed, offline, in quarantine, new, last seen."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from rtrun.archive.runs import RunRow, by_time
from rtrun.archive.states import LEAST_BOOTS
from rtrun.targets.labgrid.coordinator import (
    LabgridPlace,
    OfferedResource,
    list_places,
    list_resources,
    nobody_offers,
    unoffered,
)
from rtrun.targets.labgrid.health import FAILED


@dataclass(frozen=True, kw_only=True, slots=True)
class Farm:
    """The places of a labgrid coordinator, and what its exporters offer now."""

    places: Sequence[LabgridPlace]
    offered: Sequence[OfferedResource]


@dataclass(frozen=True, kw_only=True, slots=True)
class ScenarioHealth:
    """A scenario on a board: its last run, and the failed runs since the last good one, oldest first.

    A run failed if it is not `ok`: it has no measurements that count.
    """

    last: RunRow
    failures: Sequence[RunRow]

    @property
    def reason(self) -> str:
        """Why its last run failed, or else its status."""
        return f"{self.last.status}: {self.last.reason}" if self.last.reason else self.last.status


@dataclass(frozen=True, kw_only=True, slots=True)
class BoardHealth:
    """A board: its scenarios, on how many boots it was measured, and what the farm reports about it.

    `last_run` is the start of its last run, `last_seen` the start of the last run in which the board answered; UTC,
    without a zone. `quarantine` and `failed_check` are tags of its place, `offline` names what is not offered. All
    three are also None where no farm has such a place, or no farm was asked (`in_farm`).
    """

    board: str
    scenarios: Sequence[ScenarioHealth]
    boots: int
    last_run: datetime | None
    last_seen: datetime | None
    in_farm: bool
    quarantine: str | None
    failed_check: str | None
    offline: str | None

    @property
    def failed(self) -> list[ScenarioHealth]:
        """The scenarios whose last run failed."""
        return [each for each in self.scenarios if each.failures]

    @property
    def is_new(self) -> bool:
        """Whether it was measured on too few boots to see a change."""
        return self.boots < LEAST_BOOTS

    @property
    def is_ill(self) -> bool:
        """Whether somebody has to look after it."""
        return bool(self.failed or self.offline or self.quarantine)


def ask_farm(coordinator: str) -> Farm:
    """What a coordinator reports about its places. Raises as `list_places` does."""
    return Farm(places=list_places(coordinator), offered=list_resources(coordinator))


def boards_of(runs: Iterable[RunRow], farm: Farm | None) -> list[BoardHealth]:
    """Every board that was measured or is a place of the farm, by name; boards that need attention come first."""
    of_board: dict[str, list[RunRow]] = {}
    for row in runs:
        of_board.setdefault(row.machine, []).append(row)
    places = {place.name: place for place in farm.places} if farm else {}
    offered = farm.offered if farm else ()
    boards = [_board(name, of_board.get(name, []), places.get(name), offered) for name in {*of_board, *places}]
    return sorted(boards, key=lambda one: (not one.is_ill, one.board))


def _board(
    name: str, rows: Sequence[RunRow], place: LabgridPlace | None, offered: Sequence[OfferedResource]
) -> BoardHealth:
    scenarios: dict[tuple[str, ...], list[RunRow]] = {}
    for row in sorted(rows, key=by_time):
        scenarios.setdefault((row.scenario, row.suite, row.parameters, row.platform), []).append(row)
    tags: Mapping[str, str] = place.tags if place else {}
    missing = unoffered(place, offered) if place else []
    return BoardHealth(
        board=name,
        scenarios=[_scenario(scenarios[key]) for key in sorted(scenarios)],
        boots=len({row.boot for row in rows if row.status == "ok"}),
        last_run=_last(rows),
        last_seen=_last(row for row in rows if row.status == "ok" or row.boot_id),
        in_farm=place is not None,
        quarantine=place.quarantine if place else None,
        failed_check=tags.get(FAILED),
        offline=nobody_offers(missing) if missing else None,
    )


def _scenario(rows: Sequence[RunRow]) -> ScenarioHealth:
    good = max((number for number, row in enumerate(rows) if row.status == "ok"), default=-1)
    return ScenarioHealth(last=rows[-1], failures=rows[good + 1 :])


def _last(rows: Iterable[RunRow]) -> datetime | None:
    return max((row.start_utc for row in rows if row.start_utc), default=None)
