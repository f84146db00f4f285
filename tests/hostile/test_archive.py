"""Archives that others wrote: whatever is in a file, a command ends with an error of ours and within MEMORY_MIB."""

import os
import shutil
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest
from archive.archived import write_course

from rtrun.cli import main

MEMORY_MIB = 600
COMMAND = """
import re, sys
from pathlib import Path
from rtrun.cli import main
status = main(sys.argv[1:])
print(status, re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])
"""


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
        main(["site", str(archive), "--out", str(tmp_path / "site")]),
    ]
    # What only some commands ask for is an error of those.
    assert set(statuses) <= {0, 2} and 2 in statuses, capsys.readouterr().err
    assert str(archive) in capsys.readouterr().err


@pytest.mark.parametrize("place", ["archive", "partition"])
def test_paths_that_are_no_utf_8(archive, tmp_path, capsys, place):
    odd = os.fsdecode(b"\xff")
    if place == "partition":
        runs = next((archive / "runs").glob("machine=*"))
        runs.rename(runs.with_name(f"machine={odd}"))
    else:
        archive = archive.rename(tmp_path / odd)
    assert main(["history", str(archive)]) == 2
    assert main(["site", str(archive), "--out", str(tmp_path / "site")]) == 2
    assert "not UTF-8" in capsys.readouterr().err


def test_pages_and_metrics_take_no_commands(archive, tmp_path, capsys):
    for path in sorted((archive / "runs").rglob("*.parquet")):
        rewrite(path, kernel_release="\x1b]0;owned\x07<script>")
    assert main(["site", str(archive), "--out", str(tmp_path / "site")]) == 0, capsys.readouterr().err
    metrics = (tmp_path / "site/metrics.txt").read_text()
    assert 'kernel="?]0;owned?<script>"' in metrics and "\x1b" not in metrics
    for page in (tmp_path / "site").glob("*.html"):
        assert "Content-Security-Policy" in page.read_text() and "owned\x07<script>" not in page.read_text()


@pytest.mark.parametrize(("table", "blocks", "what"), [("runs", 1, "1000 rows, "), ("histograms", 40_000, "bins, ")])
def test_more_rows_than_a_run_has_in_few_bytes(archive, table, blocks, what):
    path = sorted((archive / table).rglob("*.parquet"))[0]
    first = pyarrow.parquet.ParquetFile(path).read().slice(0, 1)
    block = pyarrow.concat_tables([first] * 1000).combine_chunks()
    with pyarrow.parquet.ParquetWriter(path, block.schema, compression="zstd") as writer:
        for _ in range(0, blocks, 1000):
            writer.write_table(pyarrow.concat_tables([block] * min(blocks, 1000)))
    assert path.stat().st_size < 4_000_000
    argv = [sys.executable, "-c", COMMAND, "history", str(archive), "--json"]
    done = subprocess.run(argv, capture_output=True, text=True, check=True)
    status, peak_kib = done.stdout.split()[-2:]
    assert status == "2" and what in done.stderr, done.stderr
    assert int(peak_kib) / 1024 < MEMORY_MIB
