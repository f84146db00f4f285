"""The journal of a campaign, whatever its file holds."""

import fcntl
import sqlite3
import threading
from contextlib import closing
from datetime import UTC, datetime

import pytest

from rtfiles.errors import UsageError
from rtrun.results.journal import NAME, at_work, attempts, is_at_work, open_journal
from rtrun.results.run_state import RunState


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


M, P, S, C = RunState.MEASURING, RunState.PLANNED, RunState.STARTING, RunState.CLOSED
LAUNCHING, OBSERVING, CUT_OFF, ENDED = RunState.LAUNCHING, RunState.OBSERVING, RunState.CUT_OFF, RunState.ENDED
NEVER, RESTARTED = "begun and never closed", "cut off by a restart of the target"
AGAIN = [(S, None), (LAUNCHING, None), (M, None), (ENDED, None), (C, "ok")]


@pytest.mark.parametrize(
    ("events", "closed", "kept", "given_up", "never_closed"),
    [
        ([(S, None)], 0, 0, [], []),
        ([(S, None), (P, "nothing was measured: no space")], 0, 0, [], []),
        ([(S, None), (LAUNCHING, None)], 0, 0, [], [NEVER]),
        ([(S, None), (LAUNCHING, None), (P, "nothing was measured"), *AGAIN], 1, 0, [], []),
        ([(S, None), (LAUNCHING, None), (M, None), *AGAIN], 1, 0, [], [NEVER]),
        ([(S, None), (LAUNCHING, None), (M, None), (M, None), (ENDED, None), (C, "ok")], 1, 0, [], []),
        ([(S, None), (M, None), (P, "left by an earlier call"), *AGAIN], 1, 0, [], [NEVER]),
        ([(S, None), (M, None), (P, "left by an earlier call: no uid"), *AGAIN], 1, 0, [], [NEVER]),
        ([(S, None), (M, None), (P, "interrupted"), *AGAIN], 1, 0, [], []),
        ([(S, None), (M, None), (P, "took longer than it may: x"), *AGAIN], 1, 0, ["took longer than it may: x"], []),
        ([(S, None), (M, None), (P, "took longer than it may: x"), (M, None), (C, "ok")], 1, 0, [], []),
        ([(S, None), (M, None), (CUT_OFF, "x"), (P, "kept as a.incomplete-1"), *AGAIN], 1, 1, [], []),
        ([(S, None), (M, None), (CUT_OFF, "x"), *AGAIN], 1, 0, [], [RESTARTED]),
        ([(S, None), (M, None), (CUT_OFF, "x"), (P, "left by an earlier call")], 0, 0, [], [RESTARTED]),
        ([(S, None), (M, None), (CUT_OFF, "x")], 0, 0, [], [RESTARTED]),
        ([(CUT_OFF, "before it began"), *AGAIN, (C, "board: was restarted")], 1, 0, [], []),
        ([(S, None), (OBSERVING, None), (P, "nothing was measured: no program runs there")], 0, 0, [], []),
        ([(S, None), (OBSERVING, None), *AGAIN], 1, 0, [], [NEVER]),
        ([*AGAIN, *AGAIN], 2, 0, [], []),
        # Of versions without the words of today.
        (
            [(S, None), (M, None), (P, "KeyboardInterrupt"), (S, None), (M, None), (ENDED, None), (C, "ok")],
            1,
            0,
            [],
            [],
        ),
        ([(S, None), (M, None), (P, "rtrun was interrupted")], 0, 0, [], []),
        ([(S, None), (M, None), (P, "board: sh took longer than 9 s")], 0, 0, ["board: sh took longer than 9 s"], []),
        ([(S, None), (OBSERVING, None), (P, "board: no program runs there")], 0, 0, [], []),
        ([("unknown", None), (M, 5)], 0, 0, [], [NEVER]),
    ],
)
def test_what_became_of_each_attempt(tmp_path, events, closed, kept, given_up, never_closed):
    with closing(open_journal(tmp_path, "test", "1:plan", "board")) as log:
        for what, reason in events:
            log.database.execute("INSERT INTO event VALUES ('now', '001-run', ?, ?)", (what, reason))
        log.database.commit()
    (found,) = attempts(tmp_path).values()
    assert (found.closed, found.kept, found.given_up) == (closed, kept, given_up)
    assert found.never_closed(goes_on=False) == never_closed


def test_what_goes_on_is_not_lost(tmp_path):
    with closing(open_journal(tmp_path, "test", "1:plan", "board")) as log:
        for what in (S, M, S, M):
            log.note("now", "001-run", what)
    (found,) = attempts(tmp_path).values()
    assert (len(found.never_closed(goes_on=True)), len(found.never_closed(goes_on=False))) == (1, 2)
    assert len(found.never_closed(goes_on=False)) == 2, "looking changes nothing"


def test_what_is_noted_is_there_after_a_power_cut(tmp_path):
    with closing(open_journal(tmp_path, "test", "1:plan", "board")) as log:
        assert log.database.execute("PRAGMA synchronous").fetchone() == (2,)


def test_who_looks_whether_a_runner_is_at_work_disturbs_none(tmp_path):
    assert not is_at_work(tmp_path)
    with at_work(tmp_path):
        assert is_at_work(tmp_path)
        with pytest.raises(UsageError, match="another rtrun is at work there"), at_work(tmp_path):
            pass
    assert not is_at_work(tmp_path)
    looks = (tmp_path / ".lock").open()
    fcntl.flock(looks, fcntl.LOCK_SH)
    threading.Timer(0.1, looks.close).start()
    with at_work(tmp_path):
        pass
