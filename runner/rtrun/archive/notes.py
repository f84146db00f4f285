"""What people say of the runs of an archive: files that are added beside the tables, each with who, when and why.

Nothing in the tables is rewritten for them. A note is undone by another one that withdraws it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from fnmatch import fnmatchcase
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from rtfiles.config import Config
from rtrun.archive.entries import add_entry, read_entries
from rtrun.archive.store import Store

FOLDER = "notes"
_NOTES_MAX = 10_000
_BYTES_MAX = 1 << 16
Text = Annotated[str, Field(min_length=1, max_length=1000)]
Days = Annotated[int, Field(ge=1, le=100_000)]
Table = Literal["runs", "histograms", "samples"]


class NoteHead(Config):
    """Who wrote a note, when (UTC, without a zone) and why."""

    at: Annotated[datetime, Field(strict=False)]
    who: Text
    reason: Text

    @property
    def words(self) -> str:
        """The reason, and whose it is."""
        return f"{self.reason} ({self.who}, {self.at:%Y-%m-%d})"


class IgnoreNote(NoteHead):
    """Runs that count in no answer: those that all of these patterns are of, begun from `begin` on and before `end`."""

    kind: Literal["ignore"] = "ignore"
    machine: Text | None = None
    scenario: Text | None = None
    kernel_release: Text | None = None
    commit: Text | None = None
    image: Text | None = None
    boot_id: Text | None = None
    run: Text | None = None
    begin: Annotated[datetime | None, Field(strict=False)] = None
    end: Annotated[datetime | None, Field(strict=False)] = None


class AcceptNote(NoteHead):
    """The level of the courses that these patterns hold for is as it should be from `begin` on."""

    kind: Literal["accept"] = "accept"
    machine: Text | None = None
    scenario: Text | None = None
    begin: Annotated[datetime, Field(strict=False)]


class KnownNote(NoteHead):
    """What got worse before this was said, on these boards and in these scenarios, is known; so is a quarantine where
    no scenario is named. It stays WORSE, and nobody is called for it."""

    kind: Literal["known"] = "known"
    machine: Text | None = None
    scenario: Text | None = None


class RetainNote(NoteHead):
    """How long the rows of a table are kept after a run was begun; None: for ever. The last one of a table counts."""

    kind: Literal["retain"] = "retain"
    table: Table
    days: Days | None


class WithdrawNote(NoteHead):
    """A note that no longer holds, by its name."""

    kind: Literal["withdraw"] = "withdraw"
    note: Text


HeldNote = IgnoreNote | AcceptNote | KnownNote | RetainNote
Note = Annotated[HeldNote | WithdrawNote, Field(discriminator="kind")]
PATTERNS = ("machine", "scenario", "kernel_release", "commit", "image", "boot_id", "run")
"""What runs are told by; each is a pattern of the shell, as board-*."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Notes:
    """The notes of an archive that hold, by name, the first one first."""

    held: Mapping[str, HeldNote]

    def ignores(self) -> list[IgnoreNote]:
        """Those that runs are left out for."""
        return [note for note in self.held.values() if isinstance(note, IgnoreNote)]

    def accepted(self, machine: str, scenario: str) -> AcceptNote | None:
        """The last one that the level of a course was accepted by."""
        fitting = [
            note
            for note in self.held.values()
            if isinstance(note, AcceptNote) and _fits(note.machine, machine) and _fits(note.scenario, scenario)
        ]
        return max(fitting, key=lambda note: note.begin, default=None)

    def known(self, machine: str, scenario: str | None) -> list[KnownNote]:
        """Those that say that what is wrong is known: of a course, or of a board (`scenario` None)."""
        return [
            note
            for note in self.held.values()
            if isinstance(note, KnownNote) and _fits(note.machine, machine) and _fits(note.scenario, scenario)
        ]

    def kept_since(self, table: str, now: datetime) -> datetime | None:
        """Runs that were begun before are no longer kept in a table, of the notes that hold at this time in UTC.

        What was measured is not kept for longer than the run that it is of.
        """
        said = [each for each in self.held.values() if isinstance(each, RetainNote) and each.at <= now]
        said.sort(key=lambda each: each.at)
        days: dict[str, int | None] = {each.table: each.days for each in said}  # the last one of a table
        known = [each for name in {table, "runs"} if (each := days.get(name)) is not None]
        return now - timedelta(days=min(known)) if known else None


def _fits(pattern: str | None, text: str | None) -> bool:
    return pattern is None or (text is not None and fnmatchcase(text, pattern))


def fits_course(note: AcceptNote | KnownNote, machine: str, scenario: str) -> bool:
    """Whether a note is of a run's course, or of one by another series of it, as "cyclic_timer RR 1000 Hz, jitter"."""
    patterns = (note.scenario, note.scenario and note.scenario.rpartition(", ")[0])
    return _fits(note.machine, machine) and any(_fits(pattern, scenario) for pattern in patterns)


def fits_run(note: IgnoreNote, facts: Callable[[str], str | None], start: datetime | None) -> bool:
    """Whether a run is one of those that a note ignores, by its facts and its start."""
    if (note.begin or note.end) and start is None:
        return False
    if (note.begin and start and start < note.begin) or (note.end and start and start >= note.end):
        return False
    return all(_fits(getattr(note, name), facts(name)) for name in PATTERNS)


def read_notes(store: Store) -> Notes:
    """The notes that hold. Raises UsageError for a file that is none, InfrastructureError."""
    found: dict[str, HeldNote] = {}
    withdrawn: set[str] = set()
    reader: TypeAdapter[HeldNote | WithdrawNote] = TypeAdapter(Note)
    for name, note in read_entries(store, FOLDER, reader, most=_NOTES_MAX, max_bytes=_BYTES_MAX):
        if isinstance(note, WithdrawNote):
            withdrawn.add(note.note)
        else:
            found[name] = note
    return Notes(held={name: note for name, note in found.items() if name not in withdrawn})


def add_note(store: Store, note: HeldNote | WithdrawNote) -> str:
    """Add a note to an archive; returns its name. Raises InfrastructureError."""
    return add_entry(store, FOLDER, note.at, note.model_dump_json(exclude_none=True, indent=1).encode() + b"\n")


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
    told: Sequence[str] = [f"{name} {text}" for name in names if (text := getattr(note, name)) is not None]
    return ", ".join(told) or "all"
