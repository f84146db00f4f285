"""Campaigns on two kernels: a real sshd, in a mount namespace where boot id and `uname -v` are files of ours."""

import shutil
import subprocess
from dataclasses import replace

import pytest
from faulty import measure, record

from conftest import BOOT_ID, seeing, serve
from rtfiles.errors import UsageError
from rtrun.execution import preparation
from rtrun.execution.subjects import suite
from rtrun.plan.campaign import Campaign, plan
from rtrun.targets.address import ThisMachine
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link
from watching import Watching

pytestmark = [pytest.mark.sshd, pytest.mark.ros]

VERSIONS = {"standard": "#1 SMP PREEMPT_DYNAMIC", "rt": "#1 SMP PREEMPT_RT"}


class TwoKernels:
    """What a board with two kernels does, kept in files: a restart starts what was chosen."""

    def __init__(self, folder, started="standard"):
        self.boot_id, self.version = folder / "boot_id", folder / "version"
        self.chosen, self.boots = started, []
        self.start()

    def start(self):
        self.boots.append(self.chosen)
        self.version.write_text(VERSIONS[self.chosen] + "\n")
        self.boot_id.write_text(f"00000000-0000-0000-0000-{len(self.boots):012}\n")

    def choose(self, kernel):
        self.chosen = kernel


@pytest.fixture
def board(tmp_path):
    return TwoKernels(tmp_path)


@pytest.fixture
def target(ready_target, board, tmp_path):
    real = shutil.copy(shutil.which("uname"), tmp_path / "uname.real")
    uname = tmp_path / "uname"
    uname.write_text(f'#!/bin/sh\n[ "$1" = -v ] && exec cat {board.version}\nexec {real} "$@"\n')
    uname.chmod(0o755)
    wrapper = seeing({BOOT_ID: board.boot_id, shutil.which("uname"): uname})
    (tmp_path / "sshd").mkdir()
    with serve(tmp_path / "sshd", wrapper) as server:
        yield replace(
            ready_target,
            address=server.address,
            restart=lambda _: board.start(),
            boot_kernel={kernel: lambda _, kernel=kernel: board.choose(kernel) for kernel in VERSIONS},
        )


def runs_of(repeats=1, kernels=("standard", "rt")):
    entry = {"suite": "cyclic_timer_tests", "repetitions": 10, "frequency_hz": 100, "repeats": repeats}
    return plan(Campaign.model_validate({"schema": 1, "name": "test", "kernels": [*kernels], "runs": [entry]}), "test")


def measured_on(results, runs):
    """Of each run the kernel that it was planned for, that it ran on, and its boot."""
    records = [record(results, run) for run in runs]
    return [
        (
            measured["kernel"],
            "rt" if measured["target"]["preempt_rt"] else "standard",
            int(measured["target"]["boot_id"][-3:]),
        )
        for measured in records
    ]


def test_each_block_is_measured_on_its_kernel_and_on_a_boot_of_its_own(target, board, tmp_path, wishes):
    runs = runs_of(repeats=2)
    watching = Watching()
    assert set(measure(target, runs, tmp_path / "results", watching)) == {"ok"}
    assert measured_on(tmp_path / "results", runs) == [
        *[("standard", "standard", 1), ("rt", "rt", 2), ("rt", "rt", 3), ("standard", "standard", 4)],
    ]
    assert board.boots == ["standard", "rt", "rt", "standard"]
    assert sum("into the kernel" in note for note in watching.notes) == 3


@pytest.mark.parametrize("started", ["standard", "rt"])
def test_it_is_prepared_once_a_boot_that_is_measured_on(target, board, tmp_path, wishes, monkeypatch, started):
    """Not on the boot that it is found in, where that is to be restarted at once."""
    board.choose(started)
    board.start()
    prepared, prepare = [], preparation.prepared
    monkeypatch.setattr(preparation, "prepared", lambda *words: prepared.append(len(board.boots)) or prepare(*words))
    runs = runs_of()
    assert set(measure(target, runs, tmp_path / "results")) == {"ok"}
    assert prepared == [boot for _, _, boot in measured_on(tmp_path / "results", runs)]


def test_a_target_that_runs_the_kernel_is_not_restarted(target, board, tmp_path, wishes):
    runs = runs_of(repeats=2, kernels=["standard"])
    assert set(measure(replace(target, boot_kernel={}), runs, tmp_path / "results")) == {"ok"}
    assert board.boots == ["standard"]


def test_a_campaign_that_was_stopped_between_blocks_goes_on_with_the_next_kernel(target, board, tmp_path, wishes):
    runs = runs_of(repeats=2)

    def stop(number):
        if number == runs.index(runs[2]):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure(target, runs, tmp_path / "results", Watching(stop))
    board.choose("standard")
    board.start()  # and meanwhile somebody restarted the board into the other kernel
    assert set(measure(target, runs, tmp_path / "results")) == {"ok"}
    assert [kernels[:2] for kernels in measured_on(tmp_path / "results", runs)] == [
        *[("standard", "standard"), ("rt", "rt"), ("rt", "rt"), ("standard", "standard")],
    ]
    assert len({boot for _, _, boot in measured_on(tmp_path / "results", runs)}) == 4


def test_a_run_that_still_measures_is_picked_up_before_the_target_is_restarted(target, board, tmp_path, wishes):
    """The run before it failed, and is repeated only when the other kernel's run is closed."""
    runs = runs_of()
    wishes.will("fail", "sleep 3")

    class Killed(Exception):
        """Nothing is cleaned up, as when the runner is killed."""

    real = suite.wait

    def killed(work, *more):
        if work.run.kernel == "rt":
            raise Killed
        return real(work, *more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(suite, "wait", killed)
        with pytest.raises(Killed):
            measure(target, runs, tmp_path / "results")
    assert board.boots == ["standard", "rt"]
    assert set(measure(target, runs, tmp_path / "results")) == {"ok"}
    assert board.boots == ["standard", "rt", "standard"]
    assert measured_on(tmp_path / "results", runs) == [("standard", "standard", 3), ("rt", "rt", 2)]
    assert len(wishes.calls()) == 3, "what measured was not begun anew"


def test_a_run_of_another_campaign_keeps_the_target_from_being_restarted(target, board, tmp_path, wishes):
    lock = tmp_path / "target" / "runs" / "other" / "001-run" / "suite.lock"
    with Link(target, print) as link:
        link.check(["mkdir", "-p", str(lock.parent)])
    lock.touch()
    # As supervise.sh holds it: by its number 9.
    holder = subprocess.Popen(["sh", "-c", 'exec 9>"$1"; flock 9; exec sleep 60', "sh", lock])
    try:
        while subprocess.run(["flock", "-n", lock, "true"], check=False).returncode == 0:
            assert holder.poll() is None
        with pytest.raises(TargetError, match="another run is still going on"):
            measure(target, runs_of(kernels=["rt"]), tmp_path / "results")
    finally:
        holder.kill()
        holder.wait()
    assert board.boots == ["standard"]


def test_another_kernel_than_the_one_asked_for_is_an_error_and_nothing_is_measured(target, board, tmp_path, wishes):
    target = replace(target, boot_kernel=dict.fromkeys(VERSIONS, lambda _: board.choose("standard")))
    runs = runs_of()
    with pytest.raises(TargetError, match=r"restarted into the kernel rt, it runs standard .* boot_kernel\.rt"):
        measure(target, runs, tmp_path / "results")
    assert len(wishes.calls()) == 1
    assert not (tmp_path / "results" / runs[1].name).exists()


def test_a_board_that_restarts_by_itself_into_its_other_kernel_is_restarted_into_the_one_asked_for(
    target, board, tmp_path, wishes
):
    runs = runs_of()
    crashes = []

    def crash(number):
        if number == 1 and not crashes:
            crashes.append(number)
            link = links[0]
            board.choose("standard")
            board.start()
            link.drop()

    links = []
    enter = Link.__enter__
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Link, "__enter__", lambda link: links.append(link) or enter(link))
        assert set(measure(target, runs, tmp_path / "results", Watching(crash))) == {"ok"}
    assert [kernels[:2] for kernels in measured_on(tmp_path / "results", runs)] == [
        *[("standard", "standard"), ("rt", "rt")],
    ]


def test_targets_that_cannot_boot_both_are_refused_before_anything_is_measured(target, board, tmp_path, wishes):
    runs = runs_of()
    for lacking, reason in (
        ({"boot_kernel": {}}, "asks for the kernel standard and rt, but nobody said how .* add boot_kernel"),
        ({"boot_kernel": {"rt": board.choose}}, "asks for the kernel standard, but nobody"),
        ({"restart": None}, "does not say how to restart"),
        ({"address": ThisMachine()}, "cannot restart the machine that it runs on: ask for one boot and one kernel"),
    ):
        with pytest.raises(UsageError, match=reason):
            measure(replace(target, **lacking), runs, tmp_path / "results")
    with pytest.raises(UsageError, match="asks for the kernel rt, but nobody said"):
        measure(replace(target, boot_kernel={}), runs_of(kernels=["rt"]), tmp_path / "one")
    assert wishes.calls() == [] and board.boots == ["standard"]
