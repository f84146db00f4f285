"""Files on a target, or here, that are not what the runner wrote there: no traceback, and the campaign goes on."""

import json
import os
import re
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path, PurePosixPath

import faulty
import pytest
from faulty import record, runs_of

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.execution import campaign_runner, download, run_execution
from rtrun.results import run_directory
from rtrun.targets.errors import TargetError
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros]


class Stop(Exception):
    """The runner ends here, as kill -9 would end it."""


@pytest.fixture
def results(tmp_path):
    return tmp_path / "results"


@pytest.fixture
def measure(ready_target, results):
    return lambda runs, target=ready_target: faulty.measure(target, runs, results)


def deep(key, value):
    return f'{{"{key}": {"[" * 50_000}{value}{"]" * 50_000}}}'


FORGERIES = {
    "deep": lambda data: deep("argv", 1),
    "no argv": lambda data: json.dumps(data | {"argv": {}}),
    "argv of another type": lambda data: json.dumps(data | {"argv": {"cyclic_timer_tests": 5}}),
    "surrogate": lambda data: json.dumps(data | {"start_time": "\ud800"}),
    "digits": lambda data: json.dumps(data).replace(data["service"], "9" * 6000, 1),
    "cut off": lambda data: json.dumps(data)[:-3],
    "a list": lambda data: "[]",
}


def test_an_attempt_that_is_nonsense_is_given_up_and_begun_anew(ready_target, results, wishes, measure, monkeypatch):
    wishes.will(*["sleep 60"] * len(FORGERIES))
    runs, begun = runs_of(2), 0

    def stop(*_, **__):
        wishes.await_calls(begun)
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(run_execution.processes, "wait", stop)
        for begun, forge in enumerate(FORGERIES.values(), 1):
            with pytest.raises(Stop):
                measure(runs)
            assert len(wishes.calls()) == begun
            (attempt,) = Path(ready_target.work_dir).glob("runs/*/*/attempt.json")
            attempt.write_text(forge(json.loads(attempt.read_text())))
    assert measure(runs) == ["ok", "ok"]
    assert len(wishes.calls()) == len(FORGERIES) + 2
    events = sqlite3.connect(results / "journal.sqlite").execute("SELECT what, reason FROM event").fetchall()
    given_up = [reason for what, reason in events if what == "planned" and reason]
    assert len(given_up) == len(FORGERIES) and all("attempt.json" in reason for reason in given_up)


def test_a_sampler_that_prints_nonsense_makes_its_run_invalid(results, wishes, measure, monkeypatch):
    real = download.pull

    def pull(link, source, present, destination, limits):
        refused = real(link, source, present, destination, limits)
        (destination / "sampler.stdout").write_text("at inf 0.1 - - cpu 1 2 3 4 5 6 7 8\n")
        return refused

    monkeypatch.setattr(run_execution.download, "pull", pull)
    runs = runs_of(1)
    assert measure(runs) == ["invalid"]
    assert record(results, runs[0])["reason"].startswith("sampler.stdout:1: not what sample.sh writes: 'at inf")


def test_traces_that_nobody_asked_for_stay_where_they_are(results, wishes, measure):
    wishes.will("untold trace")
    runs = runs_of(1)
    assert measure(runs) == ["ok"]
    assert not [name for name in record(results, runs[0])["files"] if "trace" in name]


def test_a_folder_full_of_foreign_files_is_removed_and_told_of(ready_target, results, wishes):
    wishes.will("flood")
    runs, watching = runs_of(2), Watching()
    assert faulty.measure(ready_target, runs, results, watching) == ["ok", "ok"]
    (note,) = watching.notes
    assert re.search(rf"{runs[0].name}: has 100\d\d files; those that are not of the run are removed with it$", note)
    assert not list(Path(ready_target.work_dir).glob("runs/*"))


DAMAGES = {
    "npy removed": lambda npy, closing: npy.unlink(),
    "npy altered": lambda npy, closing: npy.write_bytes(npy.read_bytes()[:-1] + b"x"),
    "schema": lambda npy, closing: closing.write_text(closing.read_text().replace('"schema": 2', '"schema": 3')),
    "deep": lambda npy, closing: closing.write_text(deep("schema", 1)),
}


def test_a_damaged_run_is_measured_again(results, wishes, measure):
    runs = runs_of(2)
    measure(runs)
    folder = results / runs[0].name
    for number, (what, damage) in enumerate(DAMAGES.items(), 1):
        damage(next(folder.glob("*.npy")), folder / "run.json")
        assert campaign_runner.count_finished(results, runs) == 1, what
        assert measure(runs) == ["ok", "ok"]
        assert len(wishes.calls()) == 2 + number
        assert (results / f"{runs[0].name}.old-{number}").is_dir(), "the damaged one is kept beside it"


def test_a_results_folder_of_another_target_is_refused_even_when_finished(results, ready_target, wishes, measure):
    runs = runs_of(1)
    measure(runs)
    with pytest.raises(UsageError, match="holds runs on the target loopback, not other: give another folder"):
        measure(runs, replace(ready_target, name="other"))
    with pytest.raises(UsageError, match="holds runs on the target loopback, not other"):
        campaign_runner.find_unfinished(results, "test", runs, "other")
    assert campaign_runner.find_unfinished(results, "test", runs, "loopback") == []


def test_the_journal_tells_the_life_of_each_run(results, wishes, measure):
    wishes.will("fail")
    runs = runs_of(1)
    measure(runs)
    events = sqlite3.connect(results / "journal.sqlite").execute("SELECT run, what, reason FROM event").fetchall()
    assert [what for _, what, _ in events] == ["session", "starting", "launching", "measuring", "ended", "closed"]
    assert events[-1][2].startswith("failed: cyclic_timer_tests ended with exit status 1")


def test_nothing_outside_is_removed_for_a_forged_uid(results, ready_target, wishes, measure):
    runs = runs_of(1)
    measure(runs)
    precious = Path(ready_target.work_dir).parent / "precious"
    precious.mkdir()
    with sqlite3.connect(results / "journal.sqlite") as database:
        database.execute("UPDATE campaign SET uid = '../../precious'")
    shutil.rmtree(results / runs[0].name)
    with pytest.raises(UsageError, match="no uid of a campaign"):
        measure(runs)
    assert precious.is_dir()


@pytest.mark.parametrize("what", ["file", "link"])
def test_a_work_dir_that_is_not_ours_is_left_alone(tmp_path, ready_target, wishes, measure, what):
    folder = tmp_path / "somebody"
    folder.mkdir()
    if what == "file":
        (folder / "thesis.txt").write_text("x")
    else:
        (tmp_path / "elsewhere").mkdir()
        (folder / "runs").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(
        TargetError, match=f"{folder} holds what rtrun did not make.*name an empty or a new folder as work_dir"
    ):
        measure(runs_of(1), replace(ready_target, work_dir=PurePosixPath(folder)))
    assert sorted(path.name for path in folder.iterdir()) == ["thesis.txt" if what == "file" else "runs"]
    assert wishes.calls() == []


def test_a_work_dir_of_an_earlier_version_is_known_by_what_is_in_it(tmp_path, ready_target, wishes, measure):
    folder = tmp_path / "earlier"
    for name in ("objects", "suites", "runs", "master", "scripts"):
        (folder / name).mkdir(parents=True)
    target = replace(ready_target, work_dir=PurePosixPath(folder))
    assert measure(runs_of(1), target) == ["ok"]
    (folder / "thesis.txt").write_text("somebody put this in later")
    assert measure(runs_of(1), target) == ["ok"], "the mark stays"


def test_a_lock_that_is_a_link_is_not_followed(results, tmp_path, measure):
    precious = tmp_path / "precious"
    precious.write_text("x")
    run_directory.make_results(results)
    (results / ".lock").symlink_to(precious)
    with pytest.raises(UsageError, match=r"\.lock: cannot be locked, remove it"):
        measure(runs_of(1))
    assert precious.read_text() == "x"
    (results / ".lock").unlink()
    os.mkfifo(results / ".lock")
    assert campaign_runner.count_finished(results, runs_of(1)) == 0


def test_a_full_disk_here_is_not_blamed_on_the_target(link, tmp_path):
    (tmp_path / "passwd").symlink_to("/dev/full")
    size_bytes = Path("/etc/passwd").stat().st_size
    with pytest.raises(InfrastructureError) as caught:
        link.do(lambda connection: connection.download(PurePosixPath("/etc"), {"passwd": size_bytes}, tmp_path))
    assert str(caught.value) == f"{tmp_path}/passwd: No space left on device"
    assert not isinstance(caught.value, TargetError)
