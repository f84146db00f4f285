"""The journal of a campaign, a SQLite file in its results folder: with it a campaign is resumed after a crash."""

import contextlib
import fcntl
import itertools
import os
import re
import secrets
import sqlite3
import threading
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from time import sleep
from typing import IO, Any
from urllib.parse import quote

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.results.record import RunStatus
from rtrun.results.run_state import GivenUp, RunState

NAME = "journal.sqlite"
SESSION = "session"
GIVEN = "given to"
KEPT = "kept as "
"""Begins the reason of an attempt that a restart of the target cut off; the name of its folder follows."""
_AT = "at place"
_LOCK = ".lock"
# A reader holds the lock only for a moment.
_LOOKS, _LOOK_S = 5, 0.05
_MEASURES = (RunState.LAUNCHING, RunState.MEASURING, RunState.OBSERVING, RunState.ENDED)
_END = dict.fromkeys(_MEASURES, "begun and never closed") | {RunState.CUT_OFF: "cut off by a restart of the target"}
# The last two are what older versions wrote for the first.
_UNRELATED = (GivenUp.INTERRUPTED, GivenUp.NOT_MEASURED, "KeyboardInterrupt", "rtrun was interrupted")

_TABLES = """
CREATE TABLE IF NOT EXISTS campaign (uid TEXT NOT NULL, name TEXT NOT NULL, plan TEXT NOT NULL, target TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS event (time TEXT NOT NULL, run TEXT NOT NULL, what TEXT NOT NULL, reason TEXT);
"""
# It becomes the name of a folder that is removed on the target, so it must be a plain name.
_UID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,200}-[0-9a-f]{8}", re.ASCII)
# A run's name also becomes such a folder: one line that a file system takes and that leads out of no folder.
_RUN = re.compile(r"(?![.])[^/\0\n]{1,255}")
_REMEDY = (
    "the journal is damaged: give another folder with --results, or --fresh; the runs that are there stay readable"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Journal:
    """An open journal, for any thread. `uid` names this campaign on its targets; `plan` is the digest of its runs."""

    path: Path
    database: sqlite3.Connection
    uid: str
    plan: str
    targets: tuple[str, ...]
    """The names of the targets that the campaign was measured on."""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def note(self, time: str, run: str, what: str, reason: str | None = None) -> None:
        """Record the new state of a run (`RunState`), and the reason for it. Raises InfrastructureError."""
        # SQLite does not store lone surrogates.
        reason = None if reason is None else reason.encode("utf-8", "backslashreplace").decode("utf-8")
        self._write("INSERT INTO event VALUES (?, ?, ?, ?)", (time, run, what, reason))

    def begin_session(self, time: str) -> None:
        """Record that a runner takes up the campaign. Raises InfrastructureError."""
        self._write("INSERT INTO event VALUES (?, ?, ?, ?)", (time, "", SESSION, None))

    def give(self, time: str, run: str, target: str) -> None:
        """Record which of several targets will measure a run. Raises InfrastructureError."""
        self.note(time, run, GIVEN, target)

    def note_place(self, time: str, target: str, place: str) -> None:
        """Record which place of a farm a target uses now. Raises InfrastructureError."""
        self.note(time, "", _AT, f"{target} {place}")

    def owners(self) -> dict[str, str]:
        """The targets of the runs that are begun or given out and not closed since, by the name of the run.

        Raises UsageError when the journal is damaged.
        """
        # A campaign on a single target records no owners.
        sole = self.targets[0] if len(self.targets) == 1 else ""
        given: dict[str, str] = {}
        owners: dict[str, str] = {}
        for run, what, reason in self._read("SELECT run, what, reason FROM event WHERE run != '' ORDER BY rowid"):
            if what == GIVEN:
                given[run] = reason
            if what == RunState.CLOSED:
                owners.pop(run, None)
            elif owner := given.get(run, sole):
                owners[run] = owner
        return owners

    def begun(self) -> set[str]:
        """The names of the runs that the journal mentions, on any target. Raises UsageError when it is damaged."""
        names = {str(name) for (name,) in self._read("SELECT DISTINCT run FROM event WHERE run != ''")}
        if wrong := next((name for name in names if not _RUN.fullmatch(name)), None):
            raise UsageError(f"{self.path}: {wrong[:80]!r} is no name of a run: {_REMEDY}")
        return names

    def add_targets(self, names: Collection[str]) -> "Journal":
        """Record that these targets take part; return the journal that includes them. Raises InfrastructureError."""
        if set(names) <= set(self.targets):
            return self
        targets = tuple(dict.fromkeys((*self.targets, *names)))
        self._write("UPDATE campaign SET target = ?", (" ".join(targets),))
        return replace(self, targets=targets)

    def spent_s(self, now: datetime | None) -> float:
        """How long runners have worked on the campaign until `now`, in seconds, without the pauses between them.

        `now` is None when no runner is at work. Raises UsageError when the journal is damaged.
        """
        spent_s = 0.0
        before: datetime | None = None
        try:
            rows = self._read("SELECT time, what FROM event ORDER BY rowid")
            for text, what in itertools.chain(rows, [(now.isoformat(), "")] if now else []):
                time = datetime.fromisoformat(text)
                if before is not None and what != SESSION:
                    # The clock may have been set back in between.
                    spent_s += max(0.0, (time - before).total_seconds())
                before = time
        except (TypeError, ValueError) as error:
            raise UsageError(f"{self.path}: {error}: {_REMEDY}") from error
        return spent_s

    def _read(self, query: str) -> list[tuple[Any, ...]]:
        try:
            with self.lock:
                return self.database.execute(query).fetchall()
        except sqlite3.Error as error:
            raise UsageError(f"{self.path}: {error}: {_REMEDY}") from error

    def _write(self, statement: str, values: tuple[str | None, ...]) -> None:
        try:
            with self.lock, self.database:
                self.database.execute(statement, values)
        except sqlite3.Error as error:
            raise InfrastructureError(f"{self.path}: cannot keep the results: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self.database.close()


def _events(folder: Path) -> list[tuple[Any, Any, Any]] | None:
    """Run, state and reason of all events, read without a lock; None without a readable journal."""
    path = folder / NAME
    if not path.is_file():
        return None
    try:
        with contextlib.closing(sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro", uri=True)) as database:
            return database.execute("SELECT run, what, reason FROM event ORDER BY rowid").fetchall()
    except sqlite3.Error:
        return None  # opening it to resume the campaign reports what is wrong


def place_of_begun(folder: Path, target: str) -> str | None:
    """The last place of a target in a farm, if a run was begun there and not closed; None where it is not known."""
    rows = _events(folder)
    place: str | None = None
    begun: set[str] = set()
    for run, what, reason in rows or ():
        if what == _AT and isinstance(reason, str) and reason.startswith(f"{target} "):
            place, begun = reason.partition(" ")[2], set()
        elif what == RunState.CLOSED:
            begun.discard(run)
        elif run:
            begun.add(run)
    return place if begun else None


@dataclass(slots=True, kw_only=True)
class RunAttempts:
    """What the journal records about the attempts at one run that began to measure."""

    closed: int = 0
    kept: int = 0
    """Attempts that a restart of the target cut off, kept as incomplete."""
    given_up: list[str] = field(default_factory=list)
    """The reasons of attempts that were ended because they took too long."""
    _open: RunState | None = None
    """The state of the last attempt, if it was begun and is not closed."""
    _is_given_up: bool = False
    """Whether the last attempt is in `given_up`."""
    _never_closed: list[str] = field(default_factory=list)

    def never_closed(self, *, goes_on: bool) -> list[str]:
        """A reason for each attempt with an unknown outcome, without the last one if it may still go on."""
        return self._never_closed if goes_on or self._open is None else [*self._never_closed, _END[self._open]]

    def follow(self, what: str, reason: str) -> None:
        """Take the next event of the run."""
        if what == RunState.STARTING:
            self._end()
            self._is_given_up = False
        elif what in _MEASURES:
            if self._is_given_up and what == RunState.MEASURING:
                # It had not been stopped, and is resumed.
                del self.given_up[-1]
            self._is_given_up = False
            self._open = RunState(what)
        elif what == RunState.CUT_OFF:
            self._open = self._open and RunState.CUT_OFF
        elif what == RunState.CLOSED and reason.startswith(tuple(RunStatus)):
            # Any other reason is a later restart of the target, which leaves the closed run as it is.
            self.closed, self._open = self.closed + 1, None
        elif what == RunState.PLANNED and reason.startswith(KEPT):
            self.kept, self._open = self.kept + 1, None
        elif what == RunState.PLANNED:
            self._give_up(reason)

    def _give_up(self, reason: str) -> None:
        if reason.startswith(GivenUp.LEFT) or self._open == RunState.CUT_OFF:
            self._end()
        # An observation that ends with an error has seen nothing: otherwise it would have been closed.
        if self._open not in (None, RunState.OBSERVING) and not reason.startswith(_UNRELATED):
            self.given_up.append(reason)
            self._is_given_up = True
        self._open = None

    def _end(self) -> None:
        self._never_closed, self._open = self.never_closed(goes_on=False), None


def attempts(folder: Path) -> dict[str, RunAttempts] | None:
    """The attempts at each run, from the journal in a results folder; None without a readable journal."""
    rows = _events(folder)
    if rows is None:
        return None
    found: dict[str, RunAttempts] = {}
    for run, what, reason in rows:
        if isinstance(run, str) and _RUN.fullmatch(run) and isinstance(what, str):
            found.setdefault(run, RunAttempts()).follow(what, reason if isinstance(reason, str) else "")
    return found


@contextlib.contextmanager
def at_work(folder: Path) -> Iterator[None]:
    """Keep a second runner away from these results; the lock ends with the process, however that ends.

    Raises UsageError where another runner is at work, or the lock file cannot be used.
    """
    path = folder / _LOCK
    try:
        # Do not follow a link, and write nothing: the file may belong to somebody else.
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise UsageError(f"{path}: cannot be locked, remove it: {error.strerror}") from error
    with os.fdopen(handle, "rb", buffering=0) as lock:
        looks = 1
        while not _take(lock, fcntl.LOCK_EX):
            if looks == _LOOKS:
                raise UsageError(f"{folder}: another rtrun is at work there: wait for it, or give --results")
            looks += 1
            sleep(_LOOK_S)
        yield


def is_at_work(folder: Path) -> bool:
    """Whether a runner measures into these results now."""
    try:
        handle = os.open(folder / _LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return False
    with os.fdopen(handle, "rb", buffering=0) as lock:
        return not _take(lock, fcntl.LOCK_SH)


def _take(lock: IO[bytes], how: int) -> bool:
    try:
        fcntl.flock(lock, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def open_journal(folder: Path, name: str, plan: str, *targets: str) -> Journal:
    """Open the journal in a results folder, or make one; an existing one is returned as it is, whatever its campaign.

    Raises UsageError when it is damaged, InfrastructureError when the file cannot be used.
    """
    path = folder / NAME
    try:
        database = sqlite3.connect(path, timeout=10.0, check_same_thread=False)
        try:
            return _read(path, database, name, plan, " ".join(targets))
        except BaseException:
            database.close()
            raise
    except sqlite3.OperationalError as error:
        raise InfrastructureError(f"{path}: cannot keep the results: {error}") from error
    except (sqlite3.Error, ValueError) as error:
        raise UsageError(f"{path}: {error}: {_REMEDY}") from error


def _read(path: Path, database: sqlite3.Connection, name: str, plan: str, target: str) -> Journal:
    database.execute("PRAGMA journal_mode=WAL")
    # What is recorded must survive a power cut: a forgotten attempt would not be counted.
    database.execute("PRAGMA synchronous=FULL")
    with database:
        database.executescript(_TABLES)
        row = database.execute("SELECT uid, plan, target FROM campaign").fetchone()
        if row is None:
            row = (f"{name}-{secrets.token_hex(4)}", plan, target)
            database.execute("INSERT INTO campaign VALUES (?, ?, ?, ?)", (row[0], name, plan, target))
    if not all(isinstance(word, str) for word in row) or not _UID.fullmatch(row[0]):
        raise ValueError(f"no uid of a campaign: {str(row[0])[:80]!r}")
    return Journal(path=path, database=database, uid=row[0], plan=row[1], targets=tuple(row[2].split()))
