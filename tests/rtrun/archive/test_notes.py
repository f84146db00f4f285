"""What people say of runs: ignored ones, accepted levels, how long rows are kept; in files of their own."""

import json
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from archive.archived import write_build, write_course
from archive.test_compacting import NOW, files

from rtrun.archive.compacting import Compaction, compact
from rtrun.archive.runs import read_archive
from rtrun.archive.store import open_archive
from rtrun.cli import main

HOT = range(22, 26)  # days
CHANGED = 18
DAYS = 30
WHO = ("--who", "E. Noether")


@pytest.fixture
def archive(tmp_path):
    """The last four days with bad cooling; on another board nothing."""
    write_course(tmp_path / "archive", [100.0] * 8, machine="other", seed=2)
    return write_course(tmp_path / "archive", [100.0 + 20 * (day in HOT) for day in range(26)])


def rtrun(capsys, *words, status=0):
    assert main([*map(str, words)]) == status
    printed = capsys.readouterr()
    return printed.out + printed.err


def trends(capsys, archive):
    assert main(["trends", str(archive), "--json"]) == 0
    return json.loads(capsys.readouterr().out)["changes"]


def tables(archive):
    return {path: path.read_bytes() for table in ("runs", "histograms") for path in (archive / table).iterdir()}


def test_ignored_runs_count_nowhere_until_that_is_withdrawn(capsys, archive, tmp_path):
    before = tables(archive)
    assert {change["index_boot"] for change in trends(capsys, archive)} == {22}
    ignore = ("archive", "annotate", archive, "--ignore", "--reason", "bad cooling", *WHO)
    words = ("--machine", "boa*", "--from", "2026-01-23", "--to", "2026-02-01")
    out = rtrun(capsys, *ignore, *words)
    assert out.startswith("8 runs of 68: ") and "machine boa*" in out and "bad cooling (E. Noether, 20" in out
    assert trends(capsys, archive) == []
    out = rtrun(capsys, "history", archive, "--by", "board")
    assert "rtrun: 8 runs ignored: bad cooling (E. Noether, " in out and " 44     22  " in out
    assert rtrun(capsys, "history", archive, "--by", "day", "--json").count('"label": "2026-01-24"') == 0
    rtrun(capsys, "site", archive, "--output", tmp_path / "site")
    assert not any("2026-01-24 10:00" in page.read_text() for page in (tmp_path / "site").glob("*.html"))
    (line,) = rtrun(capsys, "archive", "annotate", archive).splitlines()
    name = line.partition(" ")[0]
    rtrun(capsys, "archive", "annotate", archive, "--withdraw", name, "--reason", "it was the clock", *WHO)
    assert rtrun(capsys, "archive", "annotate", archive) == ""
    assert {change["index_boot"] for change in trends(capsys, archive)} == {22}
    assert tables(archive) == before and len(list((archive / "notes").iterdir())) == 2


def test_an_accepted_level_is_what_a_build_is_held_against(capsys, tmp_path):
    levels = [100.0] * CHANGED + [110.0] * (DAYS - CHANGED)
    archive = write_course(tmp_path / "archive", levels)
    build = write_build(tmp_path / "build", 110.0, 110.0)
    gate = ("gate", build, "--against", archive, "--margin", "3us")
    assert "  WORSE  " in rtrun(capsys, *gate, status=1)
    accept = ("archive", "annotate", archive, "--accept", "--reason", "mitigations on", *WHO, "--machine", "board")
    assert "accepted from 2026-01-19 00:00 on: machine board" in rtrun(capsys, *accept, "--from", "2026-01-19")
    out = rtrun(capsys, *gate)
    assert "NOT WORSE" in out and "since its level was accepted from 2026-01-19 on: mitigations on (E. No" in out
    assert "WORSE" in rtrun(capsys, "gate", write_build(tmp_path / "b", 140.0, 140.0), "--against", archive, status=1)
    for change in trends(capsys, archive):
        assert not change["worse"] and change["accepted"].startswith("mitigations on")
    out = rtrun(capsys, "trends", archive)
    assert "accepted  oneshot_timer RR 1000 us on board: p50" in out and "WORSE" not in out
    rtrun(capsys, "site", archive, "--output", tmp_path / "site")
    page = (tmp_path / "site" / "index.html").read_text()
    assert "Of 1 scenario 1 got worse, which was accepted." in page and "✓&nbsp;ACCEPTED: p50, p99" in page
    # What was accepted before it got worse is no excuse.
    (name,) = (path.stem for path in (archive / "notes").iterdir())
    rtrun(capsys, "archive", "annotate", archive, "--withdraw", name, "--reason", "too late", *WHO)
    rtrun(capsys, *accept, "--from", "2026-01-10")
    assert all(change["worse"] for change in trends(capsys, archive))
    assert "  WORSE  " in rtrun(capsys, *gate, status=1)


def test_a_level_accepted_lately_has_no_history_yet(capsys, tmp_path):
    archive = write_course(tmp_path / "archive", [100.0] * 8)
    accept = ("--accept", "--reason", "new", "--from", "2026-01-07T00:00+02:00", *WHO)
    rtrun(capsys, "archive", "annotate", archive, *accept)
    out = rtrun(capsys, "gate", write_build(tmp_path / "build", 100.0), "--against", archive, status=1)
    assert "NO HISTORY" in out and "2 boots of it are in the archive, 5 are needed since its level was accepted" in out


def test_rows_are_kept_as_long_as_was_said(capsys, tmp_path):
    """Samples for 20 days, measurements for 40: what compact packs anew and removes, and what answers see."""
    archive = write_course(tmp_path / "archive", [100.0] * 60)
    store = open_archive(str(archive))
    day, now = timedelta(days=1), NOW.replace(year=2026, month=3, day=2)
    assert compact(store, grace=day, now=now).packs == 2
    assert compact(store, grace=day, now=now + day).removed == 240
    assert "histograms are kept for 40 days: full" in rtrun(
        capsys, "archive", "retain", archive, "histograms", "40d", "--reason", "full", *WHO
    )
    (path,) = (archive / "notes").iterdir()
    path.write_text(json.dumps({**json.loads(path.read_text()), "at": "2026-03-02T00:00:00"}))
    assert len(read_archive(store, datetime(2026, 3, 1, 23)).histograms) == 120
    known = read_archive(store, datetime(2026, 3, 2))
    assert (len(known.runs), len(known.histograms)) == (120, 2 * 40)  # begun from 21 January on
    # Fewer than half of the rows of the pack are over: it stays. A month later more are.
    assert compact(store, grace=day, now=now + 2 * day) == Compaction()
    later = now + 20 * day
    assert compact(store, grace=day, now=later) == Compaction(packed=1, packs=1, waiting=1)
    assert compact(store, grace=day, now=later + day).removed == 1
    known = read_archive(store, later.replace(tzinfo=None))
    assert (len(known.runs), len(known.histograms)) == (120, 2 * 20)
    assert (len(files(archive, "histograms")), len(files(archive))) == (1, 1)
    # Runs that are gone as a whole, and finally all files.
    rtrun(capsys, "archive", "retain", archive, "runs", "50d", "--reason", "full", *WHO)
    assert compact(store, grace=day, now=now.replace(year=2027)).removed == 2
    assert files(archive) == files(archive, "histograms") == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("annotate", "--machine", "board", "--reason", "x"), "say what of these runs: --ignore, --accept or --known"),
        (("annotate", "--ignore", "--reason", "x"), "--ignore: say which runs"),
        (("annotate", "--ignore", "--machine", "board"), "--reason: say why"),
        (("annotate", "--ignore", "--machine", "none", "--reason", "x"), "these are no runs of it"),
        (("annotate", "--accept", "--reason", "x"), "--accept takes --from TIME"),
        (("annotate", "--accept", "--from", "2026-01-01", "--kernel", "6", "--reason", "x"), "--accept takes --from"),
        (
            ("annotate", "--accept", "--from", "2026-01-01", "--machine", "x", "--reason", "x"),
            "no run is of these boards",
        ),
        (("annotate", "--accept", "--from", "yesterday", "--reason", "x"), "'yesterday' is no time"),
        (("annotate", "--withdraw", "none", "--reason", "x"), "no note 'none'"),
        (("retain", "samples", "36h", "--reason", "x"), "'36h' is not a whole number of days, as 90d, 12w or"),
        (
            ("retain", "samples", "soon", "--reason", "x"),
            "(ns, us, ms, s, min, m, h, d, w), as 400us or 8h, nor 'forever'",
        ),
    ],
)
def test_what_makes_no_note(capsys, archive, words, message):
    action, *rest = words
    assert message in rtrun(capsys, "archive", action, archive, *rest, status=2)
    assert not (archive / "notes").exists()


@pytest.mark.parametrize(
    "text", ["", "[]", '{"kind": "drop"}', '{"kind": "retain", "table": "x", "days": 1}', "[" * 3000, "x" * 70_000]
)
def test_a_file_that_is_no_note_is_named(capsys, archive, text):
    (archive / "notes").mkdir()
    Path(archive / "notes" / "n.json").write_text(text)
    assert "notes" in rtrun(capsys, "history", archive, status=2)
