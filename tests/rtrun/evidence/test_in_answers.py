"""Copies of histograms and threads that are late together, as the commands answer for them."""

import json
import shutil
from pathlib import Path

import pytest

from rtrun.cli import main

FILES = Path(__file__).parents[2] / "data" / "importers"


def imported(tmp_path, *files):
    for number, file in enumerate(files):
        path = tmp_path / f"{number}{file.suffix}"
        shutil.copy(file, path)
        command = [
            "import",
            str(path),
            "--results",
            str(tmp_path / "results"),
            "--platform",
            "hardware",
            "--board",
            "a",
        ]
        assert main([*command, "--boot", f"boot {number}"]) == 0
    return tmp_path / "results"


def test_one_histogram_that_is_imported_three_times_counts_not_at_all(tmp_path, capsys):
    results = imported(tmp_path, *[FILES / "cyclictest-json-fifo-200us.json"] * 3)
    capsys.readouterr()
    assert main(["gate", str(results), "--deadline", "1ms", "--probability", "1e-2", "--assume-independent"]) == 1
    assert capsys.readouterr().out.count("FAIL  NOT ANALYSED") == 3


@pytest.mark.parametrize(("file", "threads"), [("histofall-2threads-rt-tests-2.x.txt", 2)])
def test_threads_of_one_program_count_as_one(tmp_path, file, threads, capsys):
    results = imported(tmp_path, FILES / file)
    capsys.readouterr()
    assert main(["verdict", str(results), "--deadline", "1ms", "--probability", "1e-2", "--json"]) == 0
    (group,) = json.loads(capsys.readouterr().out)["groups"]
    assert group["verdict"]["n_effective"] == pytest.approx(group["verdict"]["n"] / threads)
