"""``rtrun verify``: a finished run is one whose checksums hold."""

import shutil

import pytest
from written import write_cyclic, write_record

from rtrun.cli import main


@pytest.fixture
def results(tmp_path):
    folder = tmp_path / "results"
    for name in ("001-a", "002-b"):
        (folder / name).mkdir(parents=True)
        write_record(folder / name, "cyclic_timer_tests", [write_cyclic(folder / name).stem], {})
    return folder


def test_results_that_are_whole(results, capsys):
    assert main(["verify", str(results)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "all 2 runs are whole",
        "whole    001-a: ok, 2 files",
        "whole    002-b: ok, 2 files",
    ]
    assert main(["verify", str(results / "001-a")]) == 0


def test_an_attempt_that_was_repeated_is_no_damage(results, capsys):
    (results / "001-a.incomplete-1").mkdir()
    assert main(["verify", str(results)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("repeated 001-a.incomplete-1: cut off")


@pytest.mark.parametrize("damage", ["removed", "altered", "schema", "no record"])
def test_results_that_are_not(results, capsys, damage):
    (npy,) = (results / "001-a").glob("*.npy")
    record = results / "001-a" / "run.json"
    if damage == "removed":
        npy.unlink()
    elif damage == "altered":
        npy.write_bytes(npy.read_bytes()[:-1] + b"x")
    elif damage == "schema":
        record.write_text(record.read_text().replace('"schema": 2', '"schema": 3'))
    else:
        record.unlink()
    assert main(["verify", str(results)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "1 of 2 runs are damaged or incomplete"
    assert lines[1].startswith("damaged  ") and "001-a" in lines[1]
    assert lines[2] == "whole    002-b: ok, 2 files"


def test_what_is_no_results_folder(results, capsys):
    (npy,) = (results / "001-a").glob("*.npy")
    assert main(["verify", str(npy)]) == 2
    shutil.rmtree(results)
    assert main(["verify", str(results)]) == 2
