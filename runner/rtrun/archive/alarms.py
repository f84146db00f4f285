"""What somebody is to hear of: figures that got worse, a build that is, a board in quarantine."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime
from typing import Literal

from rtrun.archive.against import LEAST_MARGIN_NS, SHARE_OF_MARGIN
from rtrun.archive.courses import Course
from rtrun.archive.notes import Notes
from rtrun.archive.trends import NOTHING_KNOWN, Trend, as_text
from rtrun.judgement.gate import Gate
from rtrun.targets.labgrid.coordinator import LabgridPlace
from rtrun.targets.labgrid.health import in_words, since


@dataclass(frozen=True, kw_only=True, slots=True)
class Alarm:
    """Something that got worse, of one line each: where, by how much, since when, and what may have done it.

    `key` tells it from others, of which it is told once. Of a course it is told again when a level `begins` after all
    that was known (`last_run`) when it was told, or is above the one of then: `levels` has for each figure its new
    level, in ns or as a share, and what that is above for sure. `known` is what somebody said of it, so that nobody is
    called.
    """

    kind: Literal["worse", "worse build", "quarantine"]
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
    """An alarm for each course of which a figure's last change is for the worse, by more than is of no concern."""
    last: dict[tuple[str, ...], dict[str, Trend]] = {}
    for trend in trends:
        last.setdefault(trend.course.identity, {})[trend.figure] = trend
    alarms = []
    for figures in last.values():
        worse = [trend for trend in figures.values() if trend.is_worse and _is_of_concern(trend)]
        if worse:
            alarms.append(_of_course(worse[0].course, worse, confidence))
    return alarms


def _is_of_concern(trend: Trend) -> bool:
    return trend.change.low > of_no_concern(trend.figure, trend.change.before)


def of_no_concern(figure: str, level: float) -> float:
    """By how much a figure may be above this level without anybody having to hear of it."""
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
        levels={one.figure: (one.change.after, one.change.before + one.change.low) for one in worse},
        known=known[0].words if known[0] and all(known) else None,
    )


def worse_builds(gate: Gate, build: str, notes: Notes, pages: Sequence[Course]) -> list[Alarm]:
    """An alarm for each case of `gate --against` that is WORSE; `build` tells its results from others."""
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
                known=next((note.words for note in notes.known(machine, scenario)), None),
            )
        )
    return alarms


def in_quarantine(places: Iterable[LabgridPlace], notes: Notes) -> list[Alarm]:
    """An alarm for each place in quarantine."""
    return [
        Alarm(
            kind="quarantine",
            about=place.name,
            size=in_words(place.quarantine),
            since="its second failed check",
            suspected="see its console, its power and its network",
            page="boards.html",
            key=_key("quarantine", place.name, place.quarantine),
            known=_known(place.name, since(place.quarantine), notes),
        )
        for place in places
        if place.quarantine is not None
    ]


def _known(place: str, day: date | None, notes: Notes) -> str | None:
    """What was said of a quarantine since it began; one that begins later is another one."""
    return next((note.words for note in notes.known(place, None) if day is None or day <= note.at.date()), None)


def _key(*words: str) -> str:
    return hashlib.sha256(repr(words).encode("utf-8", "replace")).hexdigest()
