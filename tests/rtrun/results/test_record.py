"""run.json: one type, written and read."""

import contextlib
import hashlib
import json
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from faulty import runs_of
from written import write_cyclic, write_record

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.cli import main
from rtrun.execution import campaign_runner
from rtrun.results import run_directory
from rtrun.results.reading import read_runs
from rtrun.results.record import RunRecord, RunStatus, TargetFacts, read_record, verify
from rtrun.targets.inspection.platform import Platform


def record_of(**changed):
    raw = {
        "schema": 2,
        "run": "001-run",
        "campaign": "demo",
        "suite": "cyclic_timer_tests",
        "parameters": {"policy": "RR", "cpu": "", "break_trace_us": None},
        "platform": Platform.HARDWARE,
        "platform_evidence": "no sign of a virtual machine",
        "status": RunStatus.OK,
        "reason": None,
        "start_time": "unknown",
        "end_time": "unknown",
        "programs": [],
        "outputs": [],
        "target": TargetFacts(name="board", governor=["performance", "performance"]),
        "files": {},
    }
    return RunRecord(**raw | changed)


def test_what_is_written_is_what_is_read(tmp_path):
    folder = tmp_path / "001-run"
    with run_directory.filling(folder) as partial:
        (partial / "a.txt").write_text("a")
        run_directory.close(partial, folder, record_of(reason="\u00e4"))
    written = read_record(folder)
    assert written.model_copy(update={"files": {}}) == record_of(reason="\u00e4")
    assert written.files["a.txt"].size_bytes == 1
    assert verify(folder) == written


def test_results_are_hashed_once_however_many_ask_for_them(tmp_path, monkeypatch):
    monkeypatch.setattr("rtrun.results.record.SETTLED_NS", 0)
    (run,) = runs_of(1)
    folder = tmp_path / run.name
    folder.mkdir()
    write_record(folder, "cyclic_timer_tests", [write_cyclic(folder).stem], {}, run=run.name)
    hashed, real = [], hashlib.file_digest
    monkeypatch.setattr("hashlib.file_digest", lambda stream, kind: hashed.append(stream.name) or real(stream, kind))
    for _ in range(2):
        assert campaign_runner.count_finished(tmp_path, [run]) == 1
        assert read_runs(tmp_path).runs[0].results
        assert main(["report", str(tmp_path), "--output", "-", "--format", "markdown"]) == 0
    assert sorted(hashed) == sorted(str(folder / name) for name in read_record(folder).files)
    npy = next(folder.glob("*.npy"))
    npy.write_bytes(npy.read_bytes()[:-1] + b"x")
    assert campaign_runner.count_finished(tmp_path, [run]) == 0


def test_the_file_holds_what_was_set_and_null_where_nothing_is(tmp_path):
    data = json.loads(record_of().to_json())
    assert data["schema"] == 2 and data["status"] == "ok" and data["reason"] is None
    assert data["target"] == {"name": "board", "governor": ["performance", "performance"]}
    assert "requested" not in data, "an imported file was asked for nothing"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": 1}, "schema: takes 2, got 1"),
        ({"platform": "cloud"}, "platform: takes 'hardware', 'virtual' or 'emulated'"),
        ({"status": "good"}, "status: takes 'ok', 'failed', 'incomplete' or 'invalid'"),
        ({"target": {"cpus": 2}}, "target.name: is missing"),
        ({"target": {"name": "board", "cpus": -1}}, "target.cpus"),
        ({"programs": [{"name": "x"}]}, "programs.0.argv"),
    ],
)
def test_what_is_no_record(tmp_path, change, message):
    write_record(tmp_path, "cyclic_timer_tests", [], {}, **change)
    with pytest.raises(UsageError, match=message):
        read_record(tmp_path)
    assert run_directory.closing_record(tmp_path) is None


@pytest.mark.parametrize("damage", ["removed", "altered", "link", "schema"])
def test_a_damaged_run_is_not_verified(tmp_path, damage):
    path = write_cyclic(tmp_path)
    record = write_record(tmp_path, "cyclic_timer_tests", [path.stem], {})
    assert verify(tmp_path).status is RunStatus.OK
    npy = path.with_suffix(".npy")
    if damage == "schema":
        record.write_text(record.read_text().replace('"schema": 2', '"schema": 3'))
    elif damage == "altered":
        npy.write_bytes(npy.read_bytes()[:-1] + b"x")
    else:
        data = npy.read_bytes()
        npy.unlink()
        if damage == "link":
            (tmp_path.parent / "elsewhere.npy").write_bytes(data)
            npy.symlink_to(tmp_path.parent / "elsewhere.npy")
    with pytest.raises(UsageError, match=f"{tmp_path}"):
        verify(tmp_path)


def test_a_run_that_is_measured_again_keeps_what_was_there(tmp_path):
    folder = tmp_path / "001-run"
    for number in range(3):
        with run_directory.filling(folder) as partial:
            (partial / "a.txt").write_text(str(number))
            run_directory.close(partial, folder, record_of())
    kept = {path.name: (path / "a.txt").read_text() for path in tmp_path.iterdir()}
    assert kept == {"001-run": "2", "001-run.old-1": "0", "001-run.old-2": "1"}


def test_nothing_stays_of_a_run_that_is_not_closed(tmp_path):
    with pytest.raises(KeyboardInterrupt), run_directory.filling(tmp_path / "001-run") as partial:
        (partial / "a.txt").write_text("a")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


@pytest.mark.root
def test_run_directories_that_belong_together_are_all_there_or_none_is(tmp_path):
    """The disk is full when the second one is written, and has room for all the next time."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k,mode=755", "tmpfs", tmp_path], check=True)
    try:
        for size, kept in ((200_000, []), (50_000, ["001", "001-a", "001-b"])):
            full = pytest.raises(InfrastructureError, match=r"the disk took no more \(.*\); nothing of 001 is kept")
            with contextlib.nullcontext() if kept else full, run_directory.all_or_none(tmp_path, "001") as staged:
                for name in ("001-a", "001-b", "001"):
                    with run_directory.filling(staged / name) as partial:
                        np.save(partial / "a.npy", np.zeros(size, np.int8))
                        run_directory.close(partial, staged / name, record_of())
            assert sorted(path.name for path in tmp_path.iterdir()) == kept
    finally:
        subprocess.run(["umount", tmp_path], check=True)


def in_parallel(work, times):
    """What calls at the same time return; each opens the folder anew, as a process of its own would."""
    barrier = threading.Barrier(times)

    def call(number):
        barrier.wait()
        return work(number)

    with ThreadPoolExecutor(times) as pool:
        return list(pool.map(call, range(times)))


def test_nobody_gets_the_number_of_another(tmp_path):
    """Neither at the same time, nor while one of them is filled, nor when it stands there."""
    (tmp_path / "004-messages-a").mkdir()
    together = threading.Barrier(16, timeout=20)

    def take(_):
        with run_directory.numbered(tmp_path) as folder:
            together.wait()
            with run_directory.filling(folder) as partial:
                run_directory.close(partial, folder, record_of())
            return folder.name

    assert sorted(in_parallel(take, 16)) == [f"{number:03}" for number in range(5, 21)]
    with run_directory.numbered(tmp_path) as folder:
        assert folder.name == "021"
    with run_directory.numbered(tmp_path) as folder:
        assert folder.name == "021", "nothing was kept of it"


def test_what_is_put_aside_at_the_same_time_is_kept_each(tmp_path):
    folder = tmp_path / "001"

    def close(number):
        partial = tmp_path / f".{number}"
        partial.mkdir()
        (partial / "a.txt").write_text(str(number))
        run_directory.close(partial, folder, record_of())

    in_parallel(close, 16)
    kept = {path.name: (path / "a.txt").read_text() for path in tmp_path.iterdir()}
    assert set(kept) == {"001", *(f"001.old-{number}" for number in range(1, 16))}
    assert sorted(kept.values(), key=int) == [str(number) for number in range(16)]


def test_nobody_gets_the_new_folder_of_another(tmp_path):
    names = in_parallel(lambda _: run_directory.make_new_results(tmp_path / "a" / "quick").name, 16)
    assert sorted(names) == sorted(["quick", *(f"quick-{number}" for number in range(2, 18))][:16])


@pytest.mark.parametrize("has_begun", [False, True])
def test_numbers_of_the_dead_are_free_unless_they_had_begun_and_those_of_the_living_are_not(tmp_path, has_begun):
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom rtrun.results import run_directory\n"
        "with run_directory.numbered(Path(sys.argv[1])) as folder:\n"
        "    folder.with_name(f'.{folder.name}.partial').mkdir()\n"
        "    folder.with_name(f'.{folder.name}.room').touch()\n"
        f"    if {has_begun}: run_directory.mark_begun(folder)\n"
        "    print('taken', flush=True)\n    sys.stdin.read()"
    )
    argv, pipe = [sys.executable, "-c", code, str(tmp_path)], subprocess.PIPE
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "taken\n"
        with run_directory.numbered(tmp_path) as folder:
            assert folder.name == "002"
        assert run_directory.numbers_begun(tmp_path) == dict.fromkeys(["001"] * has_begun, True)
        process.kill()
    dead = dict.fromkeys(["001"] * has_begun, False)
    assert run_directory.numbers_begun(tmp_path) == dead
    with run_directory.numbered(tmp_path) as folder:
        assert folder.name == ("002" if has_begun else "001")
        kept = [*dead, folder.name]
        run_directory.mark_begun(folder)
        assert sorted(path.name for path in tmp_path.iterdir()) == [f".{number}.taken" for number in kept]
        assert run_directory.numbers_begun(tmp_path) == {**dead, folder.name: True}
    assert [path.name for path in tmp_path.iterdir()] == [f".{number}.taken" for number in dead]
