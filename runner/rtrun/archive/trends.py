"""Where the course of a figure changed, and what else changed there."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from itertools import groupby
from typing import Any, get_args

from rtfiles.quantities import signed
from rtrun.analysis.comparison.effects import examine_effect
from rtrun.analysis.order.change_points import ChangePoint, find_changes
from rtrun.archive.courses import ArchivedRun, Course, Figure, facts_of, figure_text, readings_of
from rtrun.archive.notes import AcceptNote, KnownNote

NOTHING_KNOWN = "nothing that the archive knows"
"""The suspected cause where nothing else changed."""
_SIGNIFICANT = 0.01  # for a reading that differs between two levels
_UNITS = {"temperature_max_mc": (1000, "°C"), "frequency_max_khz": (1000, "MHz"), "load_1min_max": (1, "")}
_NAMES = {"temperature_max_mc": "temperature", "frequency_max_khz": "CPU frequency", "load_1min_max": "load"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Trend:
    """A change of one figure of one course, over the runs that know the figure.

    The change lies between the boots that start at `last_before` and `first_after`. The new level may begin with any
    boot from `earliest` to `latest`. `circumstances` name what differs between the two sides of that interval, such as
    "kernel: 6.1 -> 6.6".
    """

    course: Course
    figure: Figure
    change: ChangePoint
    last_before: datetime | None
    first_after: datetime | None
    earliest: datetime | None
    latest: datetime | None
    circumstances: tuple[str, ...]
    accepted: AcceptNote | None

    @property
    def is_worse(self) -> bool:
        """Whether the figure rose and nobody accepted the new level."""
        return self.change.after > self.change.before and self.accepted is None

    @property
    def known(self) -> KnownNote | None:
        """The note, written after the change began, that calls it known; None without one, or if nothing got worse."""
        begun = self.first_after or datetime.max
        return next((note for note in self.course.known if self.is_worse and begun <= note.at), None)

    @property
    def word(self) -> str:
        """The word for the change."""
        return "accepted" if self.accepted else "WORSE" if self.is_worse else "better"


def trends(courses: Sequence[Course], *, confidence: float) -> list[Trend]:
    """Every change of every course; the chance that a course without changes shows one is at most 1 - confidence."""
    shown: list[Trend] = []
    for course in courses:
        known = [(figure, part) for figure in get_args(Figure) if (part := course.knowing(figure))]
        for figure, part in known:
            level = 1 - (1 - confidence) / len(known)  # Bonferroni
            changes = find_changes(part.values(figure), confidence=level)
            # Each level ends where the next one may have begun.
            begins = [0, *(change.latest for change in changes)]
            ends = [*(change.earliest for change in changes[1:]), None][: len(changes)]
            shown += [
                _trend(part, figure, change, begin, end)
                for change, begin, end in zip(changes, begins[:-1], ends, strict=True)
            ]
    return shown


def _trend(course: Course, figure: Figure, change: ChangePoint, begin: int, end: int | None) -> Trend:
    """A change between the levels of the boots from `begin` on and up to `end`."""
    boots = course.boots()
    starts = [boot[0].point.start_utc for boot in boots]
    rose, note, last = change.after > change.before, course.accepted, starts[max(0, change.earliest - 1)]
    before, after = boots[begin : change.earliest], boots[change.latest : end]
    return Trend(
        course=course,
        figure=figure,
        change=change,
        last_before=starts[change.index - 1],
        first_after=starts[change.index],
        earliest=starts[change.earliest],
        latest=starts[min(change.latest, len(boots) - 1)],
        circumstances=(*changed_facts(before, after), *_changed_readings(before, after)),
        # Whatever came before the accepted time is accepted with it; what comes later is not.
        accepted=note if rose and note and last and last < note.begin else None,
    )


def changed_facts(before: Sequence[Sequence[ArchivedRun]], after: Sequence[Sequence[ArchivedRun]]) -> list[str]:
    """Facts whose value differs between the last boot before and the first boot after the change.

    If the values of a fact come and go within a level (two kernels measured in turn), the values of the levels are
    compared.
    """
    names = dict.fromkeys(name for boot in (*before[-1:], *after[:1]) for run in boot for name in run.facts)
    changed = []
    for name in names:
        values = [[", ".join(facts_of(boot, name)) or "not known" for boot in level] for level in (before, after)]
        if any(map(_comes_and_goes, values)):
            sides = [sorted({*side}) for side in values]
        else:
            sides = [values[0][-1:], values[1][:1]]
        if sides[0] != sides[1]:
            texts = [" and ".join(side) + (" in turn" if len(side) > 1 else "") for side in sides]
            changed.append(f"{name.replace('_', ' ')}: {texts[0] or 'not known'} -> {texts[1] or 'not known'}")
    return changed


def _comes_and_goes(values: Sequence[str]) -> bool:
    """Whether a value recurs after another one."""
    return len([*groupby(values)]) > len({*values})


def _changed_readings(before: Sequence[Sequence[ArchivedRun]], after: Sequence[Sequence[ArchivedRun]]) -> list[str]:
    """Readings that differ between the two levels (Welch 1947, two-sided at 1 %)."""
    changed = []
    for name, (divisor, unit) in _UNITS.items():
        old, new = readings_of(before, name), readings_of(after, name)
        if min(old.size, new.size) < 2:
            continue
        effect = examine_effect(old, new, sign=1, least_ns=0, refuting_ns=0)
        if min(effect.p_above, effect.p_below) < _SIGNIFICANT / 2:
            changed.append(f"{_NAMES[name]}: {old.mean() / divisor:.1f} -> {new.mean() / divisor:.1f} {unit}".rstrip())
    return changed


def as_text(trend: Trend, *, confidence: float) -> list[str]:
    """A change in a few lines: by how much, when, and what else changed then."""
    change = trend.change
    amounts = [figure_text(trend.figure, value) for value in (change.before, change.after)]
    low, high = (f"{value:+.2g}" if trend.figure == "P(miss)" else signed(value) for value in (change.low, change.high))
    when = f"between {shown_time(trend.last_before)} and {shown_time(trend.first_after)}"
    if trend.earliest != trend.latest:
        when += f"; the new level may have begun from {shown_time(trend.earliest)} to {shown_time(trend.latest)}"
    return [
        f"{trend.figure} {amounts[0]} -> {amounts[1]}, {100 * confidence:g} % CI of the shift {low} to {high}",
        f"when: {when}",
        f"changed there: {'; '.join(trend.circumstances) or NOTHING_KNOWN}",
        *([f"accepted: {trend.accepted.words}"] if trend.accepted else []),
        *([f"known: {trend.known.words}"] if trend.known else []),
    ]


def shown_time(time: datetime | None) -> str:
    """A time to the minute, in UTC."""
    return f"{time:%Y-%m-%d %H:%M}" if time else "unknown"


def as_data(trend: Trend) -> dict[str, Any]:
    """A change as plain data; times of a figure in ns."""
    course = trend.course
    times = {
        name: f"{moment.isoformat()}Z" if (moment := getattr(trend, name)) else None
        for name in ("last_before", "first_after", "earliest", "latest")
    }
    return {
        **{name: getattr(course, name) for name in ("scenario", "parameters", "machine", "platform")},
        "figure": trend.figure,
        "worse": trend.is_worse,
        "accepted": trend.accepted and trend.accepted.words,
        "known": trend.known and trend.known.words,
        **{f"{name}_boot" if name in ("index", "earliest", "latest") else name: value
           for name, value in asdict(trend.change).items()},
        **times,
        "circumstances": list(trend.circumstances),
    }  # fmt: skip
