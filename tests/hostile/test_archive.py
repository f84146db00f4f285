"""Archives that others wrote: whatever is in a file, a command ends with an error of ours and within MEMORY_MIB."""

import os
import shutil
import sys
from datetime import datetime
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest
from archive.archived import write_course

from measured import measured
from rtrun.archive import queries
from rtrun.cli import main

MEMORY_MIB = 600


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write_course(tmp_path_factory.mktemp("archive") / "archive", [100.0])


@pytest.fixture
def archive(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "archive"))


def rewrite(path, **columns):
    """Give columns of a file other values, of whatever type."""
    changed = pyarrow.parquet.ParquetFile(path).read()
    for name, value in columns.items():
        column = pyarrow.array([value] * changed.num_rows)
        changed = changed.set_column(changed.column_names.index(name), name, column)
    pyarrow.parquet.write_table(changed, path)


@pytest.mark.parametrize(
    ("table", "columns"),
    [
        ("runs", {"platform": "mars"}),
        ("runs", {"platform": None}),
        ("runs", {"scenario": None}),
        ("runs", {"start_utc": "yesterday"}),
        ("runs", {"start_utc": datetime(1, 1, 1)}),
        ("runs", {"temperature_max_mc": float("nan")}),
        ("runs", {"temperature_max_mc": "hot"}),
        ("runs", {"load_1min_max": float("nan")}),
        ("runs", {"packages": "no json"}),
        ("runs", {"packages": "[" * 5000}),
        ("runs", {"packages": "[1]"}),
        ("runs", {"packages": 5}),
        ("runs", {"off_rate": None}),
        ("histograms", {"count": -5}),
        ("histograms", {"count": None}),
        ("histograms", {"count": 2**62}),
        ("histograms", {"count": "many"}),
        ("histograms", {"value_ns": 2**62}),
        ("histograms", {"value_ns": 0.5}),
        ("histograms", {"bin_ns": -1}),
    ],
    ids=lambda value: str(value)[:40],
)
def test_values_of_a_wrong_type_or_beyond_every_limit(archive, tmp_path, capsys, table, columns):
    rewrite(sorted((archive / table).rglob("*.parquet"))[0], **columns)
    statuses = [
        main(["history", str(archive)]),
        main(["history", str(archive), "--by", "run", "--json"]),
        main(["trends", str(archive)]),
        main(["site", str(archive), "--output", str(tmp_path / "site")]),
    ]
    # What only some commands ask for is an error of those.
    assert set(statuses) <= {0, 2} and 2 in statuses, capsys.readouterr().err
    assert str(archive) in capsys.readouterr().err


@pytest.mark.parametrize("place", ["archive", "file"])
def test_paths_that_are_no_utf_8(archive, tmp_path, capsys, place):
    odd = os.fsdecode(b"\xff")
    if place == "file":
        run = next((archive / "runs").iterdir())
        run.rename(run.with_name(f"{odd}.parquet"))
    else:
        archive = archive.rename(tmp_path / odd)
    assert main(["history", str(archive)]) == 2
    assert main(["site", str(archive), "--output", str(tmp_path / "site")]) == 2
    assert "not UTF-8" in capsys.readouterr().err


def test_pages_and_metrics_take_no_commands(archive, tmp_path, capsys):
    for path in sorted((archive / "runs").rglob("*.parquet")):
        rewrite(path, kernel_release="\x1b]0;owned\x07<script>")
    assert main(["site", str(archive), "--output", str(tmp_path / "site")]) == 0, capsys.readouterr().err
    metrics = (tmp_path / "site/metrics.txt").read_text()
    assert 'kernel="?]0;owned?<script>"' in metrics and "\x1b" not in metrics
    for page in (tmp_path / "site").glob("*.html"):
        assert "Content-Security-Policy" in page.read_text() and "owned\x07<script>" not in page.read_text()


def write_rows(path, number):
    """Put the first row into a file so many times."""
    first = pyarrow.parquet.ParquetFile(path).read().slice(0, 1)
    block = pyarrow.concat_tables([first] * 1000).combine_chunks()
    with pyarrow.parquet.ParquetWriter(path, block.schema, compression="zstd") as writer:
        for _ in range(0, number, 1_000_000):
            writer.write_table(pyarrow.concat_tables([block] * (min(number, 1_000_000) // 1000)))
    assert path.stat().st_size < 4_000_000


def history(archive, *words):
    return called("history", archive, *words)


def called(*words):
    """The status of a command, what it said, and its own highest memory in MiB."""
    done = measured([sys.executable, "-m", "rtrun.cli", *map(str, words)], check=False)
    return done.status, done.stderr, done.peak_mib


@pytest.mark.parametrize(
    ("table", "rows", "what"), [("runs", 1000, "1000 rows, "), ("histograms", 40_000_000, "40000000 rows, ")]
)
def test_more_rows_than_a_run_has_in_few_bytes(archive, table, rows, what):
    write_rows(sorted((archive / table).rglob("*.parquet"))[0], rows)
    status, printed, peak_mib = history(archive, "--json")
    assert status == 2 and what in printed, printed
    assert peak_mib < MEMORY_MIB


GROUPS_MEMORY_MIB = 200


@pytest.mark.parametrize("table", ["runs", "histograms"])
@pytest.mark.parametrize("groups", [1024, 1025, 20_000])
def test_many_row_groups_are_refused_before_their_list_is_read(archive, table, groups):
    """A footer of 20 000 row groups takes hundreds of MiB; the runs' file has one row more than one of a run."""
    path = sorted((archive / table).rglob("*.parquet"))[0]
    rows = pyarrow.concat_tables([pyarrow.parquet.ParquetFile(path).read()] * groups).combine_chunks().slice(0, groups)
    pyarrow.parquet.write_table(rows, path, row_group_size=1, store_schema=False)
    for command in (("history",), ("trends",), ("archive", "compact")):  # which may write, comes last
        status, printed, peak_mib = called(*command, archive)
        assert peak_mib < GROUPS_MEMORY_MIB, command
        if groups > 1024:
            refused = f"{path}: its footer is damaged, or lists more than 1024 row groups: "
            assert status == 2 and refused in printed, (command, printed)
        else:
            assert status == (2 if table == "runs" else 0), (command, printed)


def test_many_files_are_not_held_at_one_time(tmp_path):
    """Each has fewer rows than a run may have."""
    archive = write_course(tmp_path / "archive", [100.0] * 5)
    for path in (archive / "histograms").rglob("*.parquet"):
        write_rows(path, 4_000_000)
    status, printed, peak_mib = history(archive, "--by", "board")
    assert status == 0 and peak_mib < 3 * MEMORY_MIB, (printed, peak_mib)
    # However many processors there are, no more are added up at one time.
    status, printed, peak_mib = history(archive, "--by", "run")
    assert status == 0 and peak_mib < 3 * MEMORY_MIB, (printed, peak_mib)


def test_bins_that_differ_are_not_held_without_end(tmp_path, capsys, monkeypatch):
    archive = write_course(tmp_path / "archive", [100.0] * 5)
    argv = ["history", str(archive), "--by", "board", "--json"]
    assert main(argv) == 0
    whole = capsys.readouterr().out
    monkeypatch.setattr(queries, "ROWS_MAX", 3000)
    assert main(argv) == 0
    assert capsys.readouterr().out == whole
    monkeypatch.setattr(queries, "ROWS_MAX", 1000)
    assert main(argv) == 2
    err = capsys.readouterr().err
    assert f"{archive}: oneshot" in err and "the histograms of 10 runs have " in err, err
    assert "at most 1000 are held: ask for fewer runs together (--by month, day or run)" in err
