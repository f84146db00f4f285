"""Notes that people add to the runs of an archive: files next to the tables, each with author, time and reason.

Nothing in the tables is rewritten for them. A note is undone by another note that withdraws it.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from fnmatch import fnmatchcase
from typing import Annotated, Literal, TypeVar

from pydantic import Field, TypeAdapter

from rtfiles.config import Config
from rtrun.archive.entries import EntryKind, Moment, Text, add_entry, read_entries, stamp_of
from rtrun.archive.store import Store

_NOTES_MAX = 10_000  #: notes of an archive
_BYTES_MAX = 1 << 16  #: a note of an archive
Days = Annotated[int, Field(ge=1, le=100_000)]
Table = Literal["runs", "histograms", "samples"]


class NoteHead(Config):
    """Who wrote a note, when (UTC, without a zone) and why."""

    at: Moment
    who: Text
    reason: Text

    @property
    def words(self) -> str:
        """The reason, and its author."""
        return f"{self.reason} ({self.who}, {self.at:%Y-%m-%d})"


class IgnoreNote(NoteHead):
    """Runs that count in no answer: those that match all patterns and started from `begin` on and before `end`."""

    kind: Literal["ignore"] = "ignore"
    machine: Text | None = None
    scenario: Text | None = None
    kernel_release: Text | None = None
    commit: Text | None = None
    image: Text | None = None
    boot_id: Text | None = None
    run: Text | None = None
    begin: Moment | None = None
    end: Moment | None = None


class AcceptNote(NoteHead):
    """The level of the courses that match these patterns is as it should be from `begin` on."""

    kind: Literal["accept"] = "accept"
    machine: Text | None = None
    scenario: Text | None = None
    begin: Moment


class KnownNote(NoteHead):
    """What got worse on these boards and in these scenarios before this note is known.

    Without a scenario, so is a quarantine. The course stays WORSE, but nobody is notified.
    """

    kind: Literal["known"] = "known"
    machine: Text | None = None
    scenario: Text | None = None


class RetainNote(NoteHead):
    """How long a table keeps the rows of a run after its start; None: forever. The last such note of a table counts."""

    kind: Literal["retain"] = "retain"
    table: Table
    days: Days | None = None  # earlier versions left it out to mean forever


class WithdrawNote(NoteHead):
    """Withdraws another note, by its name."""

    kind: Literal["withdraw"] = "withdraw"
    note: Text


_CourseNote = TypeVar("_CourseNote", AcceptNote, KnownNote)
HeldNote = IgnoreNote | AcceptNote | KnownNote | RetainNote
Note = Annotated[HeldNote | WithdrawNote, Field(discriminator="kind")]
PATTERNS = ("machine", "scenario", "kernel_release", "commit", "image", "boot_id", "run")
"""The facts that select runs; each is a shell pattern, such as board-*."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Notes:
    """The notes of an archive that hold, by name, oldest first."""

    held: Mapping[str, HeldNote]

    def ignoring(self, facts: Callable[[str], str | None], start: datetime | None) -> IgnoreNote | None:
        """The first note that excludes a run with these facts; None where no note does."""
        ignores = (note for note in self.held.values() if isinstance(note, IgnoreNote))
        return next((note for note in ignores if fits_run(note, facts, start)), None)

    def accepted(self, machine: str, scenario: str) -> AcceptNote | None:
        """The last note that accepted the level of a course."""
        fitting = self._fitting(AcceptNote, machine, scenario)
        return max(reversed(fitting), key=lambda note: note.begin, default=None)

    def known(self, machine: str, scenario: str | None) -> list[KnownNote]:
        """The notes that call a problem known: of a course, or of a board (`scenario` None)."""
        return self._fitting(KnownNote, machine, scenario)

    def _fitting(self, kind: type[_CourseNote], machine: str, scenario: str | None) -> list[_CourseNote]:
        of_kind = (note for note in self.held.values() if isinstance(note, kind))
        return [note for note in of_kind if _fits(note.machine, machine) and _fits(note.scenario, scenario)]

    def kept_since(self, table: str, now: datetime, grace: timedelta = timedelta(0)) -> datetime | None:
        """The start time before which a table keeps no runs, and has kept none during `grace` by any note of that time.

        None: all runs are kept. `now` is in UTC. Measurements are not kept longer than the row of their run.
        """
        known = [days for name in {table, "runs"} if (days := self._days(name, now - grace)) is not None]
        return now - grace - timedelta(days=min(known)) if known else None

    def _days(self, table: str, since: datetime) -> int | None:
        """The longest time, in days, for which a table had to be kept at any moment since then; None: forever.

        Notes are ordered by their stamps. If two have the same stamp, their order is unknown, and the longer time
        holds.
        """
        retains = [
            (stamp_of(name), math.inf if note.days is None else note.days, note.at)
            for name, note in self.held.items()
            if isinstance(note, RetainNote) and note.table == table
        ]
        held = [math.inf]
        for _, days, at in sorted(retains):
            held = [days] if at <= since else [*held, days]
        longest = max(held)
        return None if longest == math.inf else int(longest)


def _fits(pattern: str | None, text: str | None) -> bool:
    return pattern is None or (text is not None and fnmatchcase(text, pattern))


def fits_course(note: AcceptNote | KnownNote, machine: str, scenario: str) -> bool:
    """Whether a note is about a course or another series of it, such as "cyclic_timer RR 1000 Hz, jitter"."""
    patterns = (note.scenario, note.scenario and note.scenario.rpartition(", ")[0])
    return _fits(note.machine, machine) and any(_fits(pattern, scenario) for pattern in patterns)


def fits_run(note: IgnoreNote, facts: Callable[[str], str | None], start: datetime | None) -> bool:
    """Whether a note ignores a run, by the facts and the start of the run."""
    if (note.begin or note.end) and start is None:
        return False
    if (note.begin and start and start < note.begin) or (note.end and start and start >= note.end):
        return False
    return all(_fits(getattr(note, name), facts(name)) for name in PATTERNS)


_READER: TypeAdapter[HeldNote | WithdrawNote] = TypeAdapter(Note)
_KIND = EntryKind(folder="notes", reader=_READER, entries_max=_NOTES_MAX, bytes_max=_BYTES_MAX)


def read_notes(store: Store) -> Notes:
    """The notes that hold. Raises UsageError for a file that is not a note, InfrastructureError."""
    found: dict[str, HeldNote] = {}
    withdrawn: set[str] = set()
    for name, note in read_entries(store, _KIND):
        if isinstance(note, WithdrawNote):
            withdrawn.add(note.note)
        else:
            found[name] = note
    return Notes(held={name: note for name, note in found.items() if name not in withdrawn})


def add_note(store: Store, note: HeldNote | WithdrawNote) -> str:
    """Add a note to an archive, after all existing ones; returns its name. Raises UsageError, InfrastructureError."""
    return add_entry(store, _KIND, note, note.at)


def in_words(name: str, note: HeldNote) -> str:
    """A note in a line."""
    match note:
        case RetainNote():
            what = f"{note.table} are kept {f'for {note.days} days' if note.days else 'for ever'}"
        case AcceptNote():
            what = f"accepted from {note.begin:%Y-%m-%d %H:%M} on: {_selected(note, ('machine', 'scenario'))}"
        case KnownNote():
            what = f"known: {_selected(note, ('machine', 'scenario'))}"
        case IgnoreNote():
            times = [
                f"{word} {time:%Y-%m-%d %H:%M}" for word, time in (("from", note.begin), ("before", note.end)) if time
            ]
            what = f"ignored: {' '.join([_selected(note, PATTERNS), *times])}"
    return f"{name}  {what}: {note.words}"


def _selected(note: IgnoreNote | AcceptNote | KnownNote, names: Iterable[str]) -> str:
    texts: Sequence[str] = [f"{name} {text}" for name in names if (text := getattr(note, name)) is not None]
    return ", ".join(texts) or "all"
