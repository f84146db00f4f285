"""A run directory that was copied does not count: not for the verdict, the gate or the archive."""

import json
import shutil

from report.campaigns import latencies, oneshot_run

from rtrun.cli import main

QUESTION = ["--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]


def write(root, name, seed, **record):
    return oneshot_run(root, name, latencies(5000, seed), **record)


def test_a_copy_passes_no_gate_and_enters_no_archive(tmp_path, capsys):
    results = tmp_path / "results"
    for k in range(2):
        write(results, f"00{k}", k, attempt=f"a{k}")
    assert main(["gate", str(results), *QUESTION]) == 0
    shutil.copytree(results / "000", results / "000-copy")
    capsys.readouterr()
    assert main(["gate", str(results), *QUESTION]) == 1
    printed = capsys.readouterr().out
    assert "000-copy" in printed and "are of the same attempt, and neither counts: remove the copy" in printed
    assert main(["archive", "add", str(results), "--to", str(tmp_path / "archive")]) == 1
    printed = "".join(capsys.readouterr())
    assert "000: a copy? it and 000-copy are of the same attempt" in printed


def test_samples_tell_a_copy_whose_record_was_changed(tmp_path, capsys):
    write(tmp_path, "a", 1, attempt="one")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    record = tmp_path / "b" / "run.json"
    record.write_text(record.read_text().replace('"one"', '"two"'))
    assert main(["verdict", str(tmp_path), *QUESTION]) == 0
    assert "a: a copy? it and b hold the same samples" in capsys.readouterr().out


def test_nothing_received_is_no_copy(tmp_path, capsys):
    for name in "ab":
        folder = write(tmp_path, name, ord(name), attempt=name)
        record = json.loads((folder / "run.json").read_text())
        record["files"]["1empty.npy"] = {"size_bytes": 128, "sha256": "0" * 64}
        (folder / "run.json").write_text(json.dumps(record))
    assert main(["verdict", str(tmp_path), *QUESTION]) == 0
    assert "copy" not in capsys.readouterr().out


def test_two_streams_of_one_run_with_the_same_times_are_no_copies(tmp_path, capsys):
    """As two paths of a topology that begin and end alike; the same path twice is one."""
    write(tmp_path, "a", 1, parameters={"path": "/x"}, subject="attached")
    for name, path in (("b", "/y"), ("c", "/y")):
        shutil.copytree(tmp_path / "a", tmp_path / name)
        record = tmp_path / name / "run.json"
        record.write_text(record.read_text().replace('"/x"', f'"{path}"'))
    assert main(["verdict", str(tmp_path), *QUESTION]) == 0
    printed = capsys.readouterr().out
    assert "b: a copy? it and c hold the same samples" in printed and "a: a copy?" not in printed


def test_a_log_that_was_appended_to_does_not_count_twice(tmp_path, capsys):
    """As by `tee -a` into one file for all runs: the second holds the first, too."""
    values = latencies(9000, 1)
    oneshot_run(tmp_path, "a", values[:4000], attempt="one")
    oneshot_run(tmp_path, "b", values, attempt="two")
    assert main(["gate", str(tmp_path), *QUESTION]) == 1
    printed = capsys.readouterr().out
    assert "a: a copy? a part of it and of b is the same, and neither counts" in printed
