"""Files of single runs put together: the same answers from fewer files, whoever reads and writes meanwhile."""

import json
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import fsspec
import pyarrow.parquet
import pytest
from archive.archived import write_course
from archive.examples import write_days
from archive.test_adding import FailingStore
from hypothesis import given, strategies
from report.campaigns import cyclic_run, latencies, oneshot_run

from rtfiles.errors import InfrastructureError
from rtrun.archive import compacting, tables
from rtrun.archive.compacting import Compaction, compact
from rtrun.archive.files import numbers_of
from rtrun.archive.runs import LATER
from rtrun.archive.store import make_archive, open_archive
from rtrun.cli import main

NOW = datetime(2026, 11, 24, tzinfo=UTC)
DAY = timedelta(days=1)
ASKED = (["--by", "day"], ["--by", "run"], ["--by", "kernel", "--of", "jitter"], ["--by", "month"])


def answers(capsys, archive, asked=ASKED):
    points = []
    for words in asked:
        assert main(["history", str(archive), "--json", *words]) == 0
        points.append(json.loads(capsys.readouterr().out)["points"])
    assert points[0]
    return points


def files(archive, table="runs"):
    return sorted(path.name for path in (archive / table).rglob("*.parquet"))


@pytest.fixture
def archive(capsys, tmp_path):
    """Two scenarios, two boards, two kernels, one run that failed."""
    results = write_days(tmp_path / "results", 6)
    for day in range(4):
        cyclic_run(results, f"{day:03d}-cyclic", latencies(300, day), hz=1000)
    oneshot_run(results, "900-oneshot", latencies(50, 1), status="failed", reason="it ended with status 1")
    assert main(["archive", "add", str(results), "--to", str(tmp_path / "archive"), "--samples"]) == 0
    capsys.readouterr()
    return tmp_path / "archive"


def compacted(archive, now=NOW, grace=DAY):
    return compact(open_archive(str(archive)), grace=grace, now=now)


def test_answers_stay_the_same_and_old_files_go_after_the_grace(capsys, archive):
    before, runs = answers(capsys, archive), len(files(archive))
    assert (runs, len(files(archive, "histograms")), len(files(archive, "samples"))) == (11, 10, 10)
    assert compacted(archive) == Compaction(packed=31, packs=3, removed=0, waiting=31)
    assert len(files(archive)) == runs + 1 and answers(capsys, archive) == before
    assert compacted(archive, NOW + DAY / 2) == Compaction(waiting=31)
    assert compacted(archive, NOW + DAY) == Compaction(removed=31)
    assert len(files(archive)) == len(files(archive, "samples")) == 1 and answers(capsys, archive) == before
    assert compacted(archive, NOW + 2 * DAY) == Compaction()


@pytest.mark.parametrize("rows", [7, 100])
def test_a_run_is_read_across_row_groups(capsys, archive, monkeypatch, rows):
    before = answers(capsys, archive)
    monkeypatch.setattr(tables, "ROW_GROUP", rows)
    compacted(archive)
    (pack,) = (archive / "histograms").glob("pack-*")
    assert pyarrow.parquet.ParquetFile(pack).num_row_groups > 20
    assert answers(capsys, archive) == before


@given(strategies.lists(strategies.none() | strategies.integers(0, 9)), strategies.integers(0, 4))
def test_numbers_of_a_column_from_any_row_on(values, first):
    column = pyarrow.array(values, pyarrow.int64())[first:]
    assert numbers_of(column, -1).tolist() == [-1 if value is None else value for value in values[first:]]


def test_an_archive_to_which_every_night_adds_stays_small(capsys, tmp_path):
    """The pack of each night is superseded by that of the next one, before its grace is over."""
    later, archive = write_course(tmp_path / "later", [100.0] * 8), tmp_path / "archive"
    make_archive(str(archive))
    before = answers(capsys, later)
    for night in range(8):
        for path in later.glob(f"*/01{night:060d}??.parquet"):
            (archive / path.parent.name).mkdir(exist_ok=True)
            path.rename(archive / path.parent.name / path.name)
        compacted(archive, NOW + night * DAY)
        assert len(files(archive)) <= 4, "two packs, and the two runs of this night"
    assert answers(capsys, archive) == before


def test_runs_in_packs_are_there_and_new_ones_come_to_them(capsys, archive, tmp_path):
    compacted(archive)
    compacted(archive, NOW + DAY)
    add = ["archive", "add", str(tmp_path / "results"), "--to", str(archive), "--samples"]
    assert main(add) == 0
    assert "0 runs added, 11 were there before" in capsys.readouterr().out
    oneshot_run(tmp_path / "results", "950-oneshot", latencies(400, 5))
    assert main(add) == 0
    assert "1 runs added, 11 were there before" in capsys.readouterr().out
    before = answers(capsys, archive)
    assert compacted(archive, NOW + 2 * DAY) == Compaction(packed=6, packs=3, waiting=6)
    assert answers(capsys, archive) == before
    assert compacted(archive, NOW + 3 * DAY) == Compaction(removed=6)
    assert len(files(archive)) == 1 and answers(capsys, archive) == before


def test_packs_have_a_highest_number_of_rows(capsys, archive, monkeypatch):
    before = answers(capsys, archive)
    monkeypatch.setitem(compacting._ROWS, "runs", 4)
    monkeypatch.setitem(compacting._ROWS, "histograms", 1500)
    compacted(archive)
    packs = {table: [n for n in files(archive, table) if n.startswith("pack-")] for table in ("runs", "histograms")}
    assert len(packs["runs"]) == 3 and len(packs["histograms"]) >= 2
    for table, most in (("runs", 4), ("histograms", 1500)):
        assert all(pyarrow.parquet.read_metadata(archive / table / name).num_rows <= most for name in packs[table])
    assert compacted(archive, NOW + DAY).removed == 31
    assert answers(capsys, archive) == before
    # What is full stays.
    assert compacted(archive, NOW + 2 * DAY).packed == 0


def test_two_calls_of_one_time_are_one(capsys, archive):
    """What the second one made is a pack of the same runs, by the same name or by a later one."""
    before = answers(capsys, archive)
    listed = compacting.places
    others = [NOW + timedelta(seconds=1)]

    def look(store, table):
        seen = listed(store, table)
        if others:
            compacted(archive, others.pop())
        return seen

    compacting.places = look
    try:
        done = compacted(archive)
    finally:
        compacting.places = listed
    assert done.packs == 1  # of histograms; of the other tables nothing was left
    assert answers(capsys, archive) == before
    assert compacted(archive, NOW + 2 * DAY).removed == 32
    assert len(files(archive, "histograms")) == 1 and answers(capsys, archive) == before


def test_readers_and_writers_beside_it(capsys, archive, tmp_path):
    """Every answer in between has all of the runs that were there, and at the end each run counts once."""
    more = tmp_path / "more"
    for k in range(30):
        oneshot_run(more, f"{k:03d}-oneshot", latencies(200, 100 + k))
    rtrun = [sys.executable, "-m", "rtrun.cli"]
    writers = [subprocess.Popen([*rtrun, "archive", "add", str(more), "--to", str(archive)], stdout=subprocess.DEVNULL)]
    writers += [
        subprocess.Popen([*rtrun, "archive", "compact", str(archive)], stdout=subprocess.DEVNULL) for _ in range(2)
    ]
    seen = []
    while any(writer.poll() is None for writer in writers):
        (points,) = answers(capsys, archive, [["--by", "run"]])
        seen.append(sum(len(point["run_keys"]) for point in points))
    assert [writer.returncode for writer in writers] == [0, 0, 0]
    assert seen == sorted(seen) and seen[0] >= 10
    for words in ([], ["--grace", "1ns"]):
        assert main(["archive", "compact", str(archive), *words]) == 0
    assert len(files(archive)) == 1
    capsys.readouterr()
    (points,) = answers(capsys, archive, [["--by", "run"]])
    keys = [key for point in points for key in point["run_keys"]]
    assert len(keys) == len({*keys}) == 40


@pytest.mark.parametrize("fails_at", [1, 2])
def test_an_object_store_that_fails_in_the_middle_loses_nothing(capsys, tmp_path, fails_at):
    fsspec.register_implementation("failing", FailingStore, clobber=True)
    FailingStore.store, FailingStore.pseudo_dirs = {}, [""]
    FailingStore.writes = FailingStore.fails_at = 0
    address = "failing://bucket/archive"
    assert main(["archive", "add", str(write_days(tmp_path / "results", 4)), "--to", address]) == 0
    capsys.readouterr()
    before = answers(capsys, address)
    FailingStore.writes, FailingStore.fails_at = 0, fails_at
    with pytest.raises(InfrastructureError):
        compacted(address)
    assert answers(capsys, address) == before
    again, later = (compacted(address, now) for now in (NOW + DAY, NOW + 2 * DAY))
    assert again.packs == 3 - fails_at and again.removed + later.removed == 8
    assert len([name for name in FailingStore.store if name.endswith(".parquet")]) == 2
    assert answers(capsys, address) == before


def test_an_archive_of_schema_1_is_read_and_becomes_one_of_this(capsys, tmp_path):
    """Machine and suite stood in its folders alone, and there were partitions."""
    archive = write_course(tmp_path / "archive", [100.0] * 3)
    before = answers(capsys, archive)
    for table in ("runs", "histograms"):
        old = archive / table / "machine=board" / "suite=oneshot_timer_tests" / "month=2026-01"
        old.mkdir(parents=True)
        for path in (archive / table).glob("*.parquet"):
            rows = pyarrow.parquet.read_table(path)
            lacking = ["machine", "suite", *LATER] if table == "runs" else []
            pyarrow.parquet.write_table(rows.drop_columns(lacking), path)
            path.rename(old / path.name)
    (archive / "archive.json").write_text('{"kind": "rtrun archive", "schema": 1}')
    assert answers(capsys, archive) == before
    assert main(["archive", "compact", str(archive)]) == 0
    assert main(["archive", "compact", str(archive), "--grace", "1ns"]) == 0
    assert len(files(archive)) == len(files(archive, "histograms")) == 1
    assert json.loads((archive / "archive.json").read_text())["schema"] == 2
    capsys.readouterr()
    assert answers(capsys, archive) == before


def test_a_damaged_pack_is_named(capsys, archive):
    compacted(archive)
    (pack,) = (archive / "histograms").glob("pack-*")
    whole = pack.read_bytes()
    pack.write_bytes(whole[: len(whole) // 2])
    for command in (["history", str(archive)], ["archive", "compact", str(archive)]):
        assert main(command) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert str(pack) in line and "a pack that was cut off while it was written can be removed" in line
    pack.unlink()
    assert main(["history", str(archive)]) == 0


def test_rows_of_a_run_that_lie_apart_are_refused(capsys, archive):
    """Whoever may write a file may write anything into it."""
    compacted(archive)
    (pack,) = (archive / "histograms").glob("pack-*")
    rows = pyarrow.parquet.read_table(pack)
    pyarrow.parquet.write_table(pyarrow.concat_tables([rows.slice(5), rows.slice(0, 5)]), pack)
    assert main(["history", str(archive)]) == 2
    assert "the rows of a run lie apart" in capsys.readouterr().err


def test_an_archive_is_not_made(capsys, tmp_path):
    assert main(["archive", "compact", str(tmp_path / "none")]) == 2
    assert not Path(tmp_path / "none").exists()
    make_archive(str(tmp_path / "empty"))
    assert main(["archive", "compact", str(tmp_path / "empty")]) == 0
    assert "0 files put into 0, 0 removed" in capsys.readouterr().out
