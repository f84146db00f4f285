"""The state of each board of an archive and of a labgrid farm, what it is, what failed last, and when it was seen."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from rtfiles.output import counted
from rtrun.archive.runs import RunRow, by_time
from rtrun.archive.states import JUDGED_FROM
from rtrun.targets.labgrid.coordinator import (
    LabgridPlace,
    OfferedResource,
    list_places,
    list_resources,
    nobody_offers,
    unoffered,
)
from rtrun.targets.labgrid.health import FAILED

STATES = {
    "QUARANTINE": "in quarantine",
    "OFFLINE": "offline",
    "FAILED": "failed in the last run",
    "NEW": "new",
    "MEASURING": "measuring",
    "IDLE": "idle",
    "OK": "in order",
}
"""The words for the states of a board, gravest first, and their meaning in a sentence; a board may be in several.

Only a farm knows whether a board measures or idles; without one, a board that lacks nothing is OK.
"""


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
        return reason_of(self.last)


@dataclass(frozen=True, kw_only=True, slots=True)
class BoardHealth:
    """A board: its scenarios, on how many boots it was measured, and what the farm reports about it.

    `last_run` is the start of its last run, `last_seen` the start of the last run in which the board answered; UTC,
    without a zone. `quarantine` and `failed_check` are tags of its place, `offline` names what is not offered. All
    three are also None where no farm has such a place, or no farm was asked (`in_farm`). `holder` has the place now.
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
    holder: str | None
    rows: Sequence[RunRow]
    """Its runs, first to last."""

    @property
    def states(self) -> list[str]:
        """Its states, gravest first."""
        is_there = self.in_farm and not (self.quarantine or self.offline)
        holds = {
            "QUARANTINE": self.quarantine,
            "OFFLINE": self.offline,
            "FAILED": self.failed,
            "NEW": self.is_new,
            "MEASURING": is_there and self.holder,
            "IDLE": is_there and not self.holder,
        }
        return [word for word, does in holds.items() if does] or ["OK"]

    @property
    def last_failed(self) -> RunRow | None:
        """Its last run that failed, whatever came after it."""
        return next((row for row in reversed(self.rows) if row.status != "ok"), None)

    @property
    def description(self) -> list[str]:
        """What it is, as far as its runs tell: processor, CPUs, memory, kernel, image."""
        cpus, memory = self._fact("cpus"), self._fact("memory_kib")
        kernel, image = self._fact("kernel_release"), self._fact("image")
        known = (
            self._fact("cpu"),
            cpus and counted(int(cpus), "CPU"),
            memory and f"{memory / 1024:.0f} MiB of memory",
            kernel and f"kernel {kernel}",
            image and f"image {image}",
        )
        return [text for text in known if text]

    @property
    def command_line(self) -> str | None:
        """The command line of its kernel, as in the last run that knows it."""
        text: str | None = self._fact("command_line")
        return text

    def _fact(self, name: str) -> Any:
        return next((value for row in reversed(self.rows) if (value := getattr(row, name)) is not None), None)

    @property
    def failed(self) -> list[ScenarioHealth]:
        """The scenarios whose last run failed."""
        return [scenario for scenario in self.scenarios if scenario.failures]

    @property
    def is_new(self) -> bool:
        """Whether it was measured on too few boots to see a change."""
        return self.boots < JUDGED_FROM

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
    return sorted(boards, key=lambda board: (not board.is_ill, board.board))


def reason_of(row: RunRow) -> str:
    """Why a run failed, or else its status."""
    return f"{row.status}: {row.reason}" if row.reason else row.status


def counts_in_words(boards: Sequence[BoardHealth]) -> str:
    """How many boards are in each state; one that is in several counts in each."""
    counts = Counter(word for board in boards for word in board.states)
    texts = [f"{counts[word]} {text}" for word, text in STATES.items() if counts[word]]
    return f"{counted(len(boards), 'board')}: {', '.join(texts)}"


def _board(
    name: str, rows: Sequence[RunRow], place: LabgridPlace | None, offered: Sequence[OfferedResource]
) -> BoardHealth:
    scenarios: dict[tuple[str, ...], list[RunRow]] = {}
    rows = sorted(rows, key=by_time)
    for row in rows:
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
        holder=place.holder if place else None,
        rows=rows,
    )


def _scenario(rows: Sequence[RunRow]) -> ScenarioHealth:
    good = max((number for number, row in enumerate(rows) if row.status == "ok"), default=-1)
    return ScenarioHealth(last=rows[-1], failures=rows[good + 1 :])


def _last(rows: Iterable[RunRow]) -> datetime | None:
    return max((row.start_utc for row in rows if row.start_utc), default=None)
