"""The journal of a campaign, a SQLite file beside its results: what makes a campaign the same one after a crash."""

import secrets
import sqlite3
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import InfrastructureError

NAME = "journal.sqlite"

_TABLES = """
CREATE TABLE IF NOT EXISTS campaign (uid TEXT NOT NULL, name TEXT NOT NULL, plan TEXT NOT NULL, target TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS event (time TEXT NOT NULL, run TEXT NOT NULL, what TEXT NOT NULL, reason TEXT);
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Journal:
    """An open journal. `uid` names this campaign on the target; `plan` is the hash of its runs."""

    path: Path
    database: sqlite3.Connection
    uid: str
    plan: str
    target: str

    def note(self, time: str, run: str, what: str, reason: str | None = None) -> None:
        """Record what happened to a run: started, ok, failed, incomplete, interrupted."""
        try:
            with self.database:
                self.database.execute("INSERT INTO event VALUES (?, ?, ?, ?)", (time, run, what, reason))
        except sqlite3.Error as error:
            raise InfrastructureError(f"{self.path}: cannot keep the results: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self.database.close()


def open_journal(folder: Path, name: str, plan: str, target: str) -> Journal:
    """Open the journal in a results folder, made anew when there is none; what it says of an older one is returned.

    Raises InfrastructureError when the file cannot be used.
    """
    path = folder / NAME
    try:
        database = sqlite3.connect(path, timeout=10.0)
        database.execute("PRAGMA journal_mode=WAL")
        with database:
            database.executescript(_TABLES)
            row = database.execute("SELECT uid, plan, target FROM campaign").fetchone()
            if row is None:
                row = (f"{name}-{secrets.token_hex(4)}", plan, target)
                database.execute("INSERT INTO campaign VALUES (?, ?, ?, ?)", (row[0], name, plan, target))
    except sqlite3.Error as error:
        raise InfrastructureError(f"{path}: {error}") from error
    return Journal(path=path, database=database, uid=row[0], plan=row[1], target=row[2])
