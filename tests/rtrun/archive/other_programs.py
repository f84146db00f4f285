"""`make test-archive`: polars and a Dask cluster of two processes say of an archive what `rtrun history` says."""

import json

import pytest
from archive.examples import answer_of, expected_answer, write_mixture

from rtrun.cli import main


@pytest.mark.parametrize("program", ["duckdb", "polars", "dask.dataframe"])
@pytest.mark.parametrize("is_packed", [False, True])
def test_the_same_numbers(capsys, tmp_path, program, is_packed):
    archive = str(tmp_path / "archive")
    assert main(["archive", "add", str(write_mixture(tmp_path / "results")), "--to", archive]) == 0
    if is_packed:  # and the files of single runs are there, too
        assert main(["archive", "compact", archive]) == 0
    capsys.readouterr()
    points = []
    for words in ([], ["--of", "jitter"]):
        assert main(["history", archive, "--json", *words]) == 0
        points += json.loads(capsys.readouterr().out)["points"]
    assert len(points) == 4 + 2 + 2 * 2 and len({(point["machine"], point["label"]) for point in points}) == 4
    assert answer_of(program, archive) == expected_answer(points)
