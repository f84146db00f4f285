"""What the runner itself needs for a farm: one campaign on 1, 8 and 64 boards, and on 64 of which a third fails.

`make bench` runs it; it is no test. A board is a real SSH server on loopback. All that the runner does on a target is
done there, but the suite: in its place a script copies what the real one wrote in a run that is recorded at the start.
So the CPU time is counted of the runner's process alone, and its memory.
"""

import contextlib
import itertools
import os
import shutil
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

import rtgen.cli
from conftest import Sshd, serve
from measured import measured
from rtrun.results.record import RunStatus, read_record, verify

TOP = Path(__file__).parents[2]
FARMS = (1, 8, 64)
# Of each board, on average.
RUNS = 6
RECORDINGS = 5
CPU_MS_MAX = 50.0
# Of the runner's process alone. 2026-11-26, x86-64 with 2 CPUs, Python 3.11: 82 MiB at 1 board, 92 to 96 at 8, 125 at
# 64, 126 where a third of those is injured.
MEMORY_MIB_MAX = 160.0
# What a run needs at 64 boards, in that at 8; and what a board adds to the memory from 8 to 64, in that from 1 to 8.
GROWTH_MAX = 1.5
# Of a board that is there: with 64 of them on two CPUs a handshake takes seconds.
RECONNECT_S = 30
CAMPAIGN = """schema: 1
name: farm
runs: [{{suite: cyclic_timer_tests, frequency_hz: 1000, repetitions: 1000, repeats: {repeats}}}]
"""
REPLAY = """#!/bin/sh
basename "$PWD" >>{calls}
sleep 1
cp {recorded}/* .
"""

pytestmark = pytest.mark.timeout(0)


@dataclass(frozen=True, kw_only=True)
class Board:
    """A simulated board: its SSH server, its target file, and a line for each run that its suite was started for."""

    name: str
    sshd: Sshd
    file: Path
    calls: Path

    def break_connections(self) -> None:
        """End the server's sessions; the board answers again at once."""
        pid = self.sshd.process.pid
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(child), signal.SIGKILL)

    def go_away(self, seconds: float) -> None:
        """Answer to nobody for a time."""
        self.sshd.process.send_signal(signal.SIGSTOP)
        self.break_connections()
        time.sleep(seconds)
        self.sshd.process.send_signal(signal.SIGCONT)

    def vanish(self) -> None:
        """Never answer again."""
        self.sshd.process.send_signal(signal.SIGSTOP)
        self.break_connections()
        self.sshd.process.kill()

    def end_programs(self) -> None:
        """End what goes on there when nobody can end it any more."""
        for pid in self.sshd.folder.glob("target/runs/*/*/*.pid"):
            with contextlib.suppress(ProcessLookupError, ValueError):
                os.killpg(int(pid.read_text()), signal.SIGKILL)


@contextlib.contextmanager
def boards(folder: Path, count: int, recorded: Path, ros_master: int) -> Iterator[list[Board]]:
    """So many boards that replay a recorded run."""
    with contextlib.ExitStack() as stack:
        boards_of_farm = []
        for number in range(count):
            own = folder / f"board-{number:02}"
            program = own / "suites" / "lib" / "cyclic_timer_tests" / "cyclic_timer_tests"
            program.parent.mkdir(parents=True)
            program.write_text(REPLAY.format(calls=own / "calls", recorded=recorded))
            program.chmod(0o755)
            (own / "suites" / "build.json").write_text("{}")
            sshd = stack.enter_context(serve(own))
            boards_of_farm.append(Board(name=own.name, sshd=sshd, file=own / "target.yml", calls=own / "calls"))
            stack.callback(boards_of_farm[-1].end_programs)
            write_target(boards_of_farm[-1].file, own.name, sshd, "suites", own / "target", ros_master)
        yield boards_of_farm


def write_target(file: Path, name: str, sshd: Sshd, suites: object, work_dir: Path, ros_master: int) -> None:
    file.write_text(
        f"schema: 1\nname: {name}\nkind: ssh\nhost: 127.0.0.1\nport: {sshd.port}\nuser: {sshd.user}\n"
        f"key: {sshd.key}\nhost_key: {sshd.host_key}\nsuites: {suites}\nwork_dir: {work_dir}\n"
        f"ros_master_port: {ros_master}\nreconnect_s: {RECONNECT_S}\n"
    )


def measure(folder: Path, repeats: int, targets: Sequence[Path]) -> tuple[float, float]:
    """`rtrun run` of a campaign into `folder`/results; CPU time in s and highest memory in MiB of its process."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "campaign.yml").write_text(CAMPAIGN.format(repeats=repeats))
    words = [word for target in targets for word in ("--target", str(target))]
    command = [sys.executable, "-m", "rtrun.cli", "run", "campaign.yml", *words, "--results", "results"]
    with (folder / "log").open("wb") as log:
        used = measured(command, cwd=folder, output=log, check=False)
    assert used.status == 0, (folder / "log").read_text()[-2000:]
    return used.cpu_s, used.peak_mib


def record_a_run(folder: Path, sshd: Sshd, ros_master: int) -> Path:
    """What the real suite writes in a run of the campaign: the smallest of some.

    A log has a line for each microsecond up to the highest value: one late wake-up of a busy machine makes it ten times
    as long.
    """
    assert rtgen.cli.main(["suites", "build", "--machine", "host"]) == 0
    suites = TOP / "build" / "suites" / "host"
    folder.mkdir()
    write_target(folder / "target.yml", "recorder", sshd, suites, folder / "target", ros_master)
    measure(folder, RECORDINGS, [folder / "target.yml"])
    runs = (folder / "results").glob("0*")
    run = min(runs, key=lambda run: sum(path.stat().st_size for path in run.glob("cyclic_timer_tests_*")))
    recorded = folder / "recorded"
    recorded.mkdir()
    for path in run.glob("cyclic_timer_tests_*"):
        shutil.copy(path, recorded)
    return recorded


def injure(farm: Sequence[Board]) -> threading.Thread:
    """Break links again and again, hang or vanish forever, each on a third of some boards once they measure."""

    def cut(board: Board) -> None:
        for _ in range(4):
            board.break_connections()
            time.sleep(2)

    faults = itertools.cycle((cut, lambda board: board.go_away(RECONNECT_S / 2), Board.vanish))

    def act() -> None:
        acting = []
        for board, fault in zip(farm, faults, strict=False):
            while not board.calls.exists():
                time.sleep(0.1)
            acting.append(threading.Thread(target=fault, args=(board,)))
            acting[-1].start()
        for acting_thread in acting:
            acting_thread.join()

    thread = threading.Thread(target=act)
    thread.start()
    return thread


def check(folder: Path, farm: Sequence[Board], repeats: int) -> None:
    """Every run is closed, whole and ok, and was measured once: but for what a board had begun when it vanished."""
    records = {path.parent.name: verify(path.parent) for path in (folder / "results").glob("[0-9]*/run.json")}
    assert len(records) == repeats and {record.status for record in records.values()} == {RunStatus.OK}
    calls = {board.name: Counter(board.calls.read_text().split()) for board in farm}
    gone = {board.name for board in farm if board.sshd.process.poll() is not None}
    for run in records:
        there = [name for name in calls if calls[name][run] and name not in gone]
        closed_by = read_record(folder / "results" / run).target.name
        assert all(calls[name][run] <= 1 for name in calls), run
        assert calls[closed_by][run] == 1 and (not there or there == [closed_by]), (run, there, closed_by)
    assert sum(map(Counter.total, calls.values())) <= repeats + len(gone)


def cpu_s_of_runs(folder: Path, repeats: int, targets: Sequence[Path]) -> tuple[float, float]:
    """`measure`, without what the command needs where nothing is left to do: to start and to read all runs."""
    cpu_s, memory_mib = measure(folder, repeats, targets)
    return cpu_s - measure(folder, repeats, targets)[0], memory_mib


def test_farm(sshd, ros_master, tmp_path):
    """What a board needs, whatever it measures, is told apart by a campaign of one run each."""
    recorded = record_a_run(tmp_path / "recording", sshd, ros_master)
    per_run_ms, memory_mib = {}, {}
    for count in FARMS:
        folder = tmp_path / str(count)
        repeats = count * RUNS
        with boards(folder, count, recorded, ros_master) as farm:
            files = [board.file for board in farm]
            measure(folder / "deploying", count, files)
            boards_s, _ = cpu_s_of_runs(folder / "one each", count, files)
            for board in farm:
                board.calls.unlink(missing_ok=True)
            start = time.monotonic()
            cpu_s, memory_mib[count] = cpu_s_of_runs(folder, repeats, files)
            wall_s = time.monotonic() - start
            check(folder, farm, repeats)
        per_run_ms[count] = 1000 * (cpu_s - boards_s) / (repeats - count)
        print(
            f"\n{count} boards, {repeats} runs in {wall_s:.0f} s: {per_run_ms[count]:.0f} ms of CPU time a run "
            f"(limit {CPU_MS_MAX:g} ms), {1000 * boards_s / count - per_run_ms[count]:.0f} ms a board, "
            f"{memory_mib[count]:.0f} MiB (limit {MEMORY_MIB_MAX:g} MiB)"
        )
    added = [(memory_mib[many] - memory_mib[few]) / (many - few) for few, many in itertools.pairwise(FARMS)]
    print(f"a board adds {added[0]:.1f} MiB from 1 to 8, {added[1]:.1f} MiB from 8 to 64")
    assert per_run_ms[64] <= CPU_MS_MAX
    assert memory_mib[64] <= MEMORY_MIB_MAX
    assert added[1] <= GROWTH_MAX * max(added[0], 1.0)
    assert per_run_ms[64] <= GROWTH_MAX * per_run_ms[8]


def test_a_third_of_a_farm_is_injured(sshd, ros_master, tmp_path):
    recorded = record_a_run(tmp_path / "recording", sshd, ros_master)
    repeats = FARMS[-1] * RUNS
    with boards(tmp_path / "farm", FARMS[-1], recorded, ros_master) as farm:
        faults = injure(farm[::3])
        cpu_s, memory_mib = cpu_s_of_runs(tmp_path, repeats, [board.file for board in farm])
        faults.join()
        check(tmp_path, farm, repeats)
    print(f"\n{FARMS[-1]} boards, a third injured: {1000 * cpu_s / repeats:.0f} ms a run, {memory_mib:.0f} MiB")
    assert memory_mib <= MEMORY_MIB_MAX
