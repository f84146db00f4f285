"""`make test-archive`: polars and a Dask cluster of two processes say of an archive what `rtrun history` says."""

import json

import pytest
from archive.examples import answer_of, write_days

from rtrun.cli import main


@pytest.mark.parametrize("program", ["duckdb", "polars", "dask.dataframe"])
def test_the_same_numbers(capsys, tmp_path, program):
    archive = tmp_path / "archive"
    assert main(["archive", "add", str(write_days(tmp_path / "results", 4)), "--to", str(archive)]) == 0
    capsys.readouterr()
    assert main(["history", str(archive), "--json"]) == 0
    points = json.loads(capsys.readouterr().out)["points"]
    expected = [(*(point[name] for name in ("scenario", "machine", "label", "n")), point["percentiles_ns"]["p99"],
                 point["misses"]) for point in points]  # fmt: skip
    assert len(expected) == 4
    assert answer_of(program, archive) == expected
