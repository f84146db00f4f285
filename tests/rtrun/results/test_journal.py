"""The journal of a campaign, whatever its file holds."""

import sqlite3
from contextlib import closing
from datetime import UTC, datetime

import pytest

from rtfiles.errors import UsageError
from rtrun.results.journal import NAME, open_journal


def open_in(folder):
    log = open_journal(folder, "test", "1:plan", "board")
    log.close()
    return log


def test_it_is_known_again(tmp_path):
    first = open_in(tmp_path)
    again = open_journal(tmp_path, "other", "1:other", "elsewhere")
    assert (again.uid, again.plan, again.targets) == (first.uid, "1:plan", ("board",))
    again.note("now", "001-run", "closed", "half of a character \ud800")
    again.close()
    with sqlite3.connect(tmp_path / NAME) as database:
        assert database.execute("SELECT what, reason FROM event").fetchall() == [
            ("closed", "half of a character \\ud800")
        ]


@pytest.mark.parametrize("data", [b"", b"garbage" * 1000, b"SQLite format 3\0" + b"\xff" * 4096])
def test_a_damaged_file_is_an_error_with_a_remedy(tmp_path, data):
    (tmp_path / NAME).write_bytes(data)
    if not data:
        assert open_in(tmp_path).targets == ("board",), "a file that was only just made"
        return
    with pytest.raises(UsageError, match="the journal is damaged: give another folder with --results, or --fresh"):
        open_in(tmp_path)


def test_a_damaged_page_is_found_when_it_is_read(tmp_path):
    with closing(open_journal(tmp_path, "test", "1:plan", "board")) as log:
        for _ in range(200):
            log.note("2026-11-21T10:00:00+00:00", "001-run", "measuring", "a reason")
        log.database.execute("PRAGMA journal_mode=DELETE")
        start = log.database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'event'").fetchone()[0] - 1
    with (tmp_path / NAME).open("r+b") as file:
        file.seek(start * 4096)
        file.write(b"\xff" * 4096)
    with (
        closing(open_journal(tmp_path, "test", "1:plan", "board")) as log,
        pytest.raises(UsageError, match=r"malformed: the journal is damaged: .*--fresh"),
    ):
        log.spent_s(datetime.now(UTC))


@pytest.mark.parametrize(
    "uid", ["../../precious-dir", "..", "", "a/b-01234567", "test-0123456", "x\n-01234567", 5, b"x"]
)
def test_a_uid_that_is_no_name_of_ours_is_refused(tmp_path, uid):
    """It names a folder that is removed on the target."""
    open_in(tmp_path)
    with sqlite3.connect(tmp_path / NAME) as database:
        database.execute("UPDATE campaign SET uid = ?", (uid,))
    with pytest.raises(UsageError, match=r"no uid of a campaign: .*--fresh"):
        open_in(tmp_path)
