"""Runs added to an archive: what is there already, what must not come in, and what goes wrong on the way."""

import contextlib
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import duckdb
import fsspec
import pyarrow.parquet
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from report.campaigns import cyclic_run, latencies, oneshot_run

from rtrun.archive import store
from rtrun.cli import main


def write_results(root: Path, runs: int = 3, **record: object) -> Path:
    for k in range(runs):
        oneshot_run(root, f"{k:03d}-oneshot", latencies(400, k), **record)
    return root


def contents(archive: Path) -> dict[str, tuple[int, int, bytes]]:
    """Every file by its path, with what changes when it is written again."""
    return {
        str(path.relative_to(archive)): (path.stat().st_ino, path.stat().st_mtime_ns, path.read_bytes())
        for path in archive.rglob("*")
        if path.is_file()
    }


def rows(archive: Path, table: str) -> int:
    files = archive / table / "**" / "*.parquet"
    (count,) = duckdb.execute(f"SELECT count(*) FROM read_parquet('{files}')").fetchone() or (0,)
    return int(count)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write_results(tmp_path_factory.mktemp("written") / "results")


@pytest.fixture
def results(tmp_path, written):
    return shutil.copytree(written, tmp_path / "results")


@pytest.fixture
def archive(tmp_path):
    return tmp_path / "archive"


def test_the_same_runs_added_again_change_nothing(capsys, results, archive):
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0
    before = contents(archive)
    assert main(["archive", "add", str(results), "--to", str(archive), "--commit", "another"]) == 0
    assert contents(archive) == before
    assert "0 runs added, 3 were there before, 0 refused" in capsys.readouterr().out


def test_new_runs_rewrite_no_file(results, archive):
    main(["archive", "add", str(results), "--to", str(archive)])
    before = contents(archive)
    cyclic_run(results, "009-cyclic", latencies(300, 9), hz=1000)
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0
    after = contents(archive)
    assert {name: after[name] for name in before} == before
    assert len(after) == len(before) + 2


def test_the_circumstances_of_a_run(tmp_path, archive):
    write_results(
        tmp_path / "results",
        1,
        condition="cpu80",
        in_effect={"temperature_mc": [41_000, 47_500], "load_1min": [0.5, 2.0]},
        target={"name": "panda 3", "kernel_release": "6.1.0-rt", "boot_id": "b1", "middleware_version": "1.16.0"},
    )
    words = ["--commit", "abc", "--image", "i1", "--package", "roscpp=1.17", "--package", "a=2"]
    main(["archive", "add", str(tmp_path / "results"), "--to", str(archive), *words])
    (row,) = pyarrow.parquet.read_table(archive / "runs").to_pylist()
    facts = {"machine": "panda 3", "commit": "abc", "image": "i1", "kernel_release": "6.1.0-rt", "boot_id": "b1"}
    facts |= {"condition": "cpu80", "temperature_max_mc": 47_500, "load_1min_max": 2.0, "middleware_version": "1.16.0"}
    facts |= {"status": "ok", "platform": "hardware", "scenario": "oneshot_timer RR 1000 us condition=cpu80"}
    assert {name: row[name] for name in facts} == facts
    assert json.loads(row["packages"]) == {"roscpp": "1.17", "a": "2"}
    assert json.loads(row["record"])["run"] == "000-oneshot"
    assert f"{row['start_utc']:%F %T}" == "2026-11-21 10:00:00"


def test_a_run_that_does_not_count_keeps_its_status_and_has_no_measurements(tmp_path, archive):
    results = write_results(tmp_path / "results", 1, status="invalid", reason="the load ended")
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0
    (row,) = pyarrow.parquet.read_table(archive / "runs").to_pylist()
    assert (row["status"], row["reason"]) == ("invalid", "the load ended")
    assert not (archive / "histograms").exists()
    assert main(["history", str(archive)]) == 0


def test_damaged_and_open_runs_are_refused(capsys, results, archive):
    (npy,) = (results / "001-oneshot").glob("*.npy")
    npy.write_bytes(npy.read_bytes()[:-8] + b"\1" * 8)
    (results / "002-oneshot" / "run.json").unlink()
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 1
    output = capsys.readouterr().out
    assert "1 runs added, 0 were there before, 2 refused" in output
    assert "altered since the run was closed" in output
    assert "002-oneshot: incomplete" in output
    assert rows(archive, "runs") == 1


def test_samples_are_added_when_they_are_asked_for(results, archive):
    main(["archive", "add", str(results), "--to", str(archive)])
    before = contents(archive)
    assert main(["archive", "add", str(results), "--to", str(archive), "--samples"]) == 0
    assert rows(archive, "samples") == 3 * 400
    after = contents(archive)
    assert {name: after[name] for name in before} == before


def test_a_newer_archive_is_refused(capsys, results, archive):
    main(["archive", "add", str(results), "--to", str(archive)])
    (archive / "archive.json").write_text('{"kind": "rtrun archive", "schema": 3}')
    before = contents(archive)
    for command in (["archive", "add", str(results), "--to", str(archive)], ["history", str(archive)]):
        capsys.readouterr()
        assert main(command) == 2
        error = capsys.readouterr().err
        assert error == (
            f"rtrun: {archive}: written by a newer version, in schema 3; this one knows schema 2: update rtrun\n"
        )
    assert contents(archive) == before


def test_a_folder_of_something_else_is_refused(capsys, results, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letter.txt").write_text("")
    assert main(["archive", "add", str(results), "--to", str(tmp_path / "home")]) == 2
    assert "name an archive, or a new or empty folder" in capsys.readouterr().err
    assert main(["history", str(tmp_path / "home")]) == 2
    assert "no archive" in capsys.readouterr().err


@pytest.mark.parametrize("table", ["runs", "histograms"])
def test_half_a_parquet_file_is_told_and_written_anew(capsys, results, archive, table):
    main(["archive", "add", str(results), "--to", str(archive)])
    whole = contents(archive)
    half = next((archive / table).rglob("*.parquet"))
    half.write_bytes(half.read_bytes()[:100])
    capsys.readouterr()
    assert main(["history", str(archive)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(half) in line and "rtrun archive add writes the file of a run anew that is not whole" in line
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0
    assert {name: file[2] for name, file in contents(archive).items()} == {
        name: file[2] for name, file in whole.items()
    }


@contextlib.contextmanager
def largest_file(size_bytes: int) -> Iterator[None]:
    """Let every write beyond a size fail, as it does on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_loses_nothing(capsys, results, archive):
    command = ["archive", "add", str(results), "--to", str(archive)]
    # Enough for archive.json and the bins of a run, not for its row, which has many columns.
    with largest_file(6000):
        status = main(command)
    first, second = capsys.readouterr().err.splitlines()
    assert status == 3
    assert "cannot be written: File too large" in first
    assert second == "rtrun: 0 of 3 runs are in the archive: the same command adds the others"
    assert not list((archive / "runs").rglob("*.parquet"))
    assert not list(archive.rglob(".*"))
    assert main(command) == 0
    assert rows(archive, "runs") == 3


class FailingStore(MemoryFileSystem):
    """An object store that fails at the write with the number `fails_at`, after half of the object where `halves`."""

    protocol = "failing"
    store: dict = {}  # noqa: RUF012
    pseudo_dirs = [""]  # noqa: RUF012
    writes, fails_at, halves = 0, 0, False

    @classmethod
    def _strip_protocol(cls, path):
        return super()._strip_protocol(path.removeprefix("failing://"))

    def pipe_file(self, path, value, **kwargs):
        cls = type(self)
        cls.writes += 1
        if cls.writes == cls.fails_at:
            if cls.halves:
                super().pipe_file(path, value[: len(value) // 2], **kwargs)
            raise ConnectionError("503 slow down\n<Error>please</Error>")
        super().pipe_file(path, value, **kwargs)


@pytest.mark.parametrize("halves", [False, True])
@pytest.mark.parametrize("fails_at", [1, 2, 5])
def test_an_object_store_that_fails_in_the_middle_loses_nothing(capsys, results, fails_at, halves):
    fsspec.register_implementation("failing", FailingStore, clobber=True)
    FailingStore.store, FailingStore.pseudo_dirs = {}, [""]
    FailingStore.writes, FailingStore.fails_at, FailingStore.halves = 0, fails_at, halves
    command = ["archive", "add", str(results), "--to", "failing://bucket/archive"]
    status = main(command)
    lines = capsys.readouterr().err.splitlines()
    assert status == 3
    assert "cannot be written: 503 slow down <Error>please</Error>" in lines[0]
    if fails_at > 1:  # the first is archive.json
        assert lines[1].endswith("of 3 runs are in the archive: the same command adds the others")
    assert main(command) == 0
    tables = [name for name in FailingStore.store if name.endswith(".parquet")]
    assert len(tables) == 6
    reached = store.open_archive("failing://bucket/archive")
    assert all(store.is_whole(reached, name) for name in tables)
    capsys.readouterr()
    assert main(["history", "failing://bucket/archive"]) == 0
    assert "1 200" in capsys.readouterr().out


class UnreadableStore(MemoryFileSystem):
    """An object store that fails at each read of a table."""

    protocol = "unreadable"
    store: dict = {}  # noqa: RUF012
    pseudo_dirs = [""]  # noqa: RUF012

    @classmethod
    def _strip_protocol(cls, path):
        return super()._strip_protocol(path.removeprefix("unreadable://"))

    def _open(self, path, mode="rb", **kwargs):
        if path.endswith(".parquet") and "r" in mode:
            raise ConnectionError("503 slow down")
        return super()._open(path, mode, **kwargs)


@pytest.mark.parametrize("command", ["history", "trends"])
def test_an_object_store_that_fails_while_it_is_read_is_one_line(capsys, results, command):
    fsspec.register_implementation("unreadable", UnreadableStore, clobber=True)
    assert main(["archive", "add", str(results), "--to", "unreadable://bucket/archive"]) == 0
    capsys.readouterr()
    assert main([command, "unreadable://bucket/archive"]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "rtrun: unreadable://bucket/archive: cannot be read: 503 slow down"


def test_a_writer_that_comes_while_another_one_makes_the_archive(results, archive, monkeypatch):
    """It sees no marker, and then the files of the other one."""
    command = ["archive", "add", str(results), "--to", str(archive)]
    schema_of, others = store._schema_of, [command]

    def look(opened):
        seen = schema_of(opened)
        if others:
            assert main(others.pop()) == 0
        return seen

    monkeypatch.setattr(store, "_schema_of", look)
    assert main(command) == 0
    assert rows(archive, "runs") == 3


def test_a_marker_that_another_writer_has_not_renamed_yet_is_no_foreign_file(results, archive):
    archive.mkdir()
    (archive / ".archive.json.x7").touch()
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0


def test_several_writers_at_once(results, archive):
    command = [sys.executable, "-m", "rtrun.cli", "archive", "add", str(results), "--to", str(archive)]
    writers = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(2)]
    assert [writer.wait() for writer in writers] == [0, 0]
    assert rows(archive, "runs") == 3
    assert not list(archive.rglob(".*"))


def test_a_protocol_without_its_package_is_named(capsys, results):
    assert main(["archive", "add", str(results), "--to", "nosuch://bucket/archive"]) == 2
    assert "nosuch" in capsys.readouterr().err


def test_a_missing_extra_is_one_line(capsys, results, archive, monkeypatch):
    monkeypatch.setattr("rtrun.archive.extra.find_spec", lambda name: None if name == "fsspec" else name)
    for command in (["archive", "add", str(results), "--to", str(archive)], ["history", str(archive)]):
        assert main(command) == 2
        packages = "'fsspec>=2024.2' 'pyarrow>=16' 'ruptures>=1.1.9'"
        expected = f"rtrun: an archive needs fsspec: {sys.executable} -m pip install {packages}\n"
        assert capsys.readouterr().err == expected
