"""What people are notified of: worse figures, a worse build, and boards that failed, are offline or new."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime, time
from typing import Literal

from rtfiles.output import counted
from rtrun.archive.against import LEAST_MARGIN_NS, SHARE_OF_MARGIN
from rtrun.archive.courses import Course
from rtrun.archive.fleet import BoardHealth, ScenarioHealth
from rtrun.archive.notes import Notes
from rtrun.archive.states import HISTORY
from rtrun.archive.trends import NOTHING_KNOWN, Trend, as_text
from rtrun.judgement.gate import Gate
from rtrun.targets.labgrid.health import in_words, since

Kind = Literal["worse", "worse build", "failed", "offline", "quarantine", "new"]
BOARDS_PAGE = "boards.html"
REASON_MAX = 300  #: characters of the reason in an alarm


@dataclass(frozen=True, kw_only=True, slots=True)
class Alarm:
    """Something that got worse, each field one line: where, by how much, since when, and the suspected cause.

    `key` identifies the alarm, so that it is sent once. The alarm of a course is sent again when a level `begins` after
    the last run (`last_run`) of the last message, or is above the level of that message: `levels` has the new level of
    each figure, in ns or as a share, and the lower bound of that level. `known` is the reason of a note that calls the
    problem known; nobody is notified then.
    """

    kind: Kind
    about: str
    size: str
    since: str
    suspected: str
    page: str | None
    key: str
    begins: datetime | None = None
    last_run: datetime | None = None
    levels: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    known: str | None = None


def worse_courses(trends: Iterable[Trend], *, confidence: float) -> list[Alarm]:
    """An alarm for each course where the last change of a figure is for the worse, by more than a negligible amount."""
    last: dict[tuple[str, ...], dict[str, Trend]] = {}
    for trend in trends:
        last.setdefault(trend.course.identity, {})[trend.figure] = trend
    alarms = []
    for figures in last.values():
        worse = [
            trend
            for trend in figures.values()
            if trend.is_worse and trend.change.low > of_no_concern(trend.figure, trend.change.before)
        ]
        if worse:
            alarms.append(_of_course(worse[0].course, worse, confidence))
    return alarms


def of_no_concern(figure: str, level: float) -> float:
    """How much a figure may exceed this level without an alarm."""
    return 0.0 if figure == "P(miss)" else max(SHARE_OF_MARGIN * level, LEAST_MARGIN_NS)


def _of_course(course: Course, worse: Sequence[Trend], confidence: float) -> Alarm:
    newest = max(worse, key=lambda trend: trend.first_after or datetime.min)
    _, when, *_ = as_text(newest, confidence=confidence)
    known = [trend.known for trend in worse]
    return Alarm(
        kind="worse",
        about=course.label,
        size="; ".join(as_text(trend, confidence=confidence)[0] for trend in worse),
        since=when.removeprefix("when: "),
        suspected="; ".join(newest.circumstances) or NOTHING_KNOWN,
        page=course.page,
        key=_key("worse", *course.identity),
        begins=newest.first_after,
        last_run=course.runs[-1].point.start_utc,
        levels={trend.figure: (trend.change.after, trend.change.before + trend.change.low) for trend in worse},
        known=known[0].words if known[0] and all(known) else None,
    )


def worse_builds(gate: Gate, build: str, notes: Notes, pages: Sequence[Course]) -> list[Alarm]:
    """An alarm for each case of `gate --against` that is WORSE; `build` distinguishes its results from others."""
    page_of = {course.label: course.page for course in pages}
    alarms = []
    for case in gate.cases:
        if case.answer != "WORSE":
            continue
        scenario, _, machine = case.about.rpartition(" on ")
        alarms.append(
            Alarm(
                kind="worse build",
                about=case.about,
                size=case.text,
                since="in these results",
                suspected="; ".join(case.changed) or NOTHING_KNOWN,
                page=page_of.get(case.about),
                key=_key("build", build, case.about),
                known=_known(notes, machine, scenario),
            )
        )
    return alarms


def board_alarms(boards: Iterable[BoardHealth], notes: Notes) -> list[Alarm]:
    """Alarms for each board: scenarios whose last run failed, then whether it is offline, in quarantine, or new."""
    alarms: list[Alarm] = []
    for board in boards:
        alarms += [_failed(board, scenario, notes) for scenario in board.failed]
        known = _known(notes, board.board)
        if board.offline:
            # If it was measured in between, it is offline anew.
            since_run = str(board.last_seen)
            alarms.append(_of_board("offline", board, board.offline, "not known", since_run, known))
        if board.quarantine:
            day = since(board.quarantine)
            # A note is about a quarantine that had begun; a later quarantine is another one.
            of_this = _known(notes, board.board, since=datetime.combine(day or date.min, time.min))
            when = str(day) if day else "not known: its tag has no day"
            alarms.append(_of_board("quarantine", board, in_words(board.quarantine), when, board.quarantine, of_this))
        if board.is_new:
            size = f"measured on {counted(board.boots, 'boot')}: {HISTORY}"
            alarms.append(_of_board("new", board, size, "its first run", "", known))
    return alarms


def _of_board(kind: Kind, board: BoardHealth, size: str, when: str, key: str, known: str | None) -> Alarm:
    return Alarm(
        kind=kind,
        about=board.board,
        size=size,
        since=f"{when}; {last_seen(board)}",
        suspected=NOTHING_KNOWN if kind == "new" else "see its console, its power and its network",
        page=BOARDS_PAGE,
        key=_key(kind, board.board, key),
        known=known,
    )


def _failed(board: BoardHealth, scenario: ScenarioHealth, notes: Notes) -> Alarm:
    first, row = scenario.failures[0], scenario.last
    since_first = f"{first.start_utc:%Y-%m-%d %H:%M} UTC" if first.start_utc else "an unknown time"
    return Alarm(
        kind="failed",
        about=f"{row.scenario} on {board.board}",
        size=f"{scenario.reason[:REASON_MAX]} ({counted(len(scenario.failures), 'run')} in a row)",
        since=f"{since_first}; {last_seen(board)}",
        suspected=f"see the run {row.run} in its results folder",
        page=BOARDS_PAGE,
        key=_key("failed", board.board, row.suite, row.parameters, row.platform, first.run_key),
        known=_known(notes, row.machine, row.scenario, first.start_utc or datetime.min),
    )


def last_seen(board: BoardHealth) -> str:
    """When a board last answered, in words."""
    return f"last seen {board.last_seen:%Y-%m-%d %H:%M} UTC" if board.last_seen else "never seen in a run"


def _known(notes: Notes, board: str, scenario: str | None = None, since: datetime = datetime.min) -> str | None:
    """The first note since then that calls a problem of a board, or of a scenario on it, known."""
    return next((note.words for note in notes.known(board, scenario) if since <= note.at), None)


def _key(*words: str) -> str:
    return hashlib.sha256(repr(words).encode("utf-8", "replace")).hexdigest()
