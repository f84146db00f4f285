"""Campaigns that survive: a runner killed at random, a link cut or frozen, two runners at once."""

import hashlib
import json
import random
import shutil
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faulty import lost, measure, runs_of, write_files
from proxy import proxy_to
from written import write_npy

from rtfiles.errors import UsageError
from rtrun.execution import campaign_runner, run_execution
from rtrun.results import run_directory
from rtrun.targets.errors import ConnectionLost
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros]
KILLS = 20


def finished(results):
    """What stands in the end: run name to what it measured, whenever that was."""
    return {
        folder.name: {path.name: np.diff(np.load(path), axis=0).tolist() for path in folder.glob("*.npy")}
        for folder in sorted(results.iterdir())
        if (closed := run_directory.closing_record(folder)) and closed.status == "ok" and ".old-" not in folder.name
    }


def test_a_runner_killed_at_twenty_random_moments(ready_target, tmp_path, wishes):
    words = [sys.executable, "-m", "rtrun.cli", *write_files(tmp_path, ready_target, 6)]
    undisturbed = [*words, "--results", "undisturbed"]
    assert subprocess.run(undisturbed, cwd=tmp_path, capture_output=True, timeout=120).returncode == 0
    calls = len(wishes.calls())
    seed = random.randrange(2**32)
    moments = random.Random(seed)
    for _ in range(KILLS):
        wishes.will("sleep 0.5")
        runner = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            runner.wait(moments.uniform(0.2, 3.0))
        except subprocess.TimeoutExpired:
            runner.send_signal(signal.SIGKILL)
            runner.wait()
    last = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert last.returncode == 0, f"seed {seed}: {last.stderr}"
    results = tmp_path / "results" / "test"
    assert finished(results) == finished(tmp_path / "undisturbed"), f"seed {seed}"
    assert len(wishes.calls()) - calls == 6, f"seed {seed}: a run that is going on is picked up, never started twice"
    assert not list(results.glob(".*.partial")), f"seed {seed}"
    assert lost(results) == [], f"seed {seed}: all that was begun was closed"
    for folder in results.iterdir():
        if folder.is_dir():
            record = json.loads((folder / "run.json").read_text())
            for name, file in record["files"].items():
                assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == file["sha256"]


@pytest.fixture
def proxied(ready_target, sshd):
    with proxy_to(sshd.port) as proxy:
        yield proxy, replace(ready_target, address=replace(ready_target.address, port=proxy.port))


def break_and_mend(break_link, proxy, mended_after_s):
    """An observer under which the link breaks during the first run; the times are those from the begin of that run."""

    def act(number):
        if number == 0:
            threading.Timer(1.5, break_link).start()
            threading.Timer(mended_after_s, proxy.mend).start()

    return Watching(act)


def test_a_cut_link_that_comes_back(proxied, tmp_path, wishes):
    proxy, target = proxied
    wishes.will("sleep 3")
    observer = break_and_mend(proxy.cut, proxy, 4.0)
    statuses = measure(target, runs_of(2), tmp_path / "results", observer)
    assert statuses == ["ok", "ok"]
    assert len(wishes.calls()) == 2
    assert any("connecting again" in note for note in observer.notes)


def test_a_frozen_link_is_noticed_and_left(proxied, tmp_path, wishes, monkeypatch):
    monkeypatch.setattr(run_execution.processes, "WAIT_S", 2.0)
    proxy, target = proxied
    wishes.will("sleep 4")
    observer = break_and_mend(proxy.freeze, proxy, 10.0)
    statuses = measure(target, runs_of(2), tmp_path / "results", observer)
    assert statuses == ["ok", "ok"]
    assert len(wishes.calls()) == 2


def test_a_link_that_stays_cut_is_an_error_and_the_run_is_picked_up_later(proxied, tmp_path, wishes):
    proxy, target = proxied
    target = replace(target, reconnect_s=1)
    watching = Watching()
    wishes.will("ok", "sleep 2")
    watching.at_start = lambda number: threading.Timer(1.0, proxy.cut).start() if number == 1 else None
    runs = runs_of(3)
    with pytest.raises(ConnectionLost, match="tried for 1 s"):
        measure(target, runs, tmp_path / "results", watching)
    assert campaign_runner.count_finished(tmp_path / "results", runs) == 1
    proxy.mend()
    watching.at_start = lambda number: None
    statuses = measure(target, runs, tmp_path / "results", watching)
    assert statuses == ["ok", "ok", "ok"]
    assert len(wishes.calls()) == 3, "the run went on without us and is not measured again"
    assert lost(tmp_path / "results") == []


def test_two_runners_do_not_mix(proxied, tmp_path, wishes):
    _, target = proxied

    def act(number):
        with pytest.raises(UsageError, match="another rtrun is at work there"):
            measure(target, runs_of(1), tmp_path / "results")

    statuses = measure(target, runs_of(1), tmp_path / "results", Watching(act))
    assert statuses == ["ok"]


def test_a_reboot_while_nobody_looked(ready_target, tmp_path, wishes):
    """A run folder that another boot left is kept as incomplete, and the run is repeated."""
    target, results, (run,) = ready_target, tmp_path / "results", runs_of(1)

    def stop(number):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure(target, [run], results, Watching(stop))
    log = campaign_runner.journal.open_journal(results, "test", "", "")
    leftover = Path(target.work_dir) / "runs" / log.uid / run.name
    log.close()
    leftover.mkdir(parents=True)
    (leftover / "cyclic_timer_tests.boot_id").write_text("11111111-2222-3333-4444-555555555555\n")
    (leftover / "cyclic_timer_tests.stdout").write_text("\tINFO: as far as it came\n")
    write_npy(leftover / "cyclic_timer_tests_l10_fq100.npy.part", [(n,) for n in range(1, 7)], announced=11)
    assert measure(target, [run], results) == ["ok"]
    kept = results / f"{run.name}.incomplete-1"
    assert np.load(kept / "cyclic_timer_tests_l10_fq100.npy").tolist() == [[n] for n in range(1, 7)]
    assert (kept / "cyclic_timer_tests.stdout").read_text() == "\tINFO: as far as it came\n"
    assert not (kept / "run.json").exists()
    assert lost(results) == [f"{kept.name}: cut off by a restart of the target"]
    shutil.rmtree(kept)
    assert lost(results) == [f"{run.name}: cut off by a restart of the target, and what was kept of it is not here"]
