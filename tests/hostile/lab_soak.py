"""A lab of 64 boards, 500 campaigns, and 50 times a part of it is killed: nothing is lost or run twice.

Boards are real SSH servers on loopback, each with a folder of its own where the others have theirs; a real labgrid
coordinator lends them. Each campaign takes whichever board is free. Killed are runners, connections, SSH servers,
the exporter and the coordinator; what was killed is started again, and the same command goes on.

Run as root: make soak [SEED=7] [BOARDS=64] [CAMPAIGNS=500] [KILLS=50].
"""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import yaml
from faulty import write_faulty_suites
from labgrid_farm import farm_of

from conftest import SSHD, Sshd, serve
from hostile.soak import WRAPPER
from rtrun.results.record import RunStatus, verify

pytest.importorskip("labgrid", reason="the extra farm is not installed")
pytestmark = [pytest.mark.sshd, pytest.mark.ros, pytest.mark.timeout(0)]

SEED = int(os.environ.get("SEED") or 1)
BOARDS = int(os.environ.get("BOARDS") or 64)
CAMPAIGNS = int(os.environ.get("CAMPAIGNS") or 500)
KILLS = int(os.environ.get("KILLS") or 50)
AT_ONCE = 8
RUNS = 2
# Each board sees its own folder here.
_ALONE = ("unshare", "--mount", "sh", "-c", 'mount --bind "$1" "$2" && shift 2 && exec "$@"', "sh")


class Lab:
    """The farm, its boards, and the runners that are at work."""

    def __init__(self, farm, boards: dict[str, Sshd], folder: Path) -> None:
        self.farm, self.boards, self.folder = farm, boards, folder
        self.servers = {name: board.process for name, board in boards.items()}
        self.random = random.Random(SEED)
        self.runners: dict[int, subprocess.Popen[bytes]] = {}
        self.closed = 0
        self.done: Counter[str] = Counter()
        self._lock = threading.Lock()

    def measure(self, number: int) -> None:
        """Call `rtrun run` of a campaign until it is done."""
        words = ["run", "campaign.yml", "--target", "lab.yml", "--results", f"results/{number:03}"]
        command = [sys.executable, "-m", "rtrun.cli", *words]
        while True:
            with (self.folder / "rtrun.log").open("ab") as log:
                runner = subprocess.Popen(command, cwd=self.folder, stdout=log, stderr=log)
            with self._lock:
                self.runners[number] = runner
            status = runner.wait()
            with self._lock:
                del self.runners[number]
                self.closed += status == 0
            if status == 0:
                return
            assert status in (-signal.SIGKILL, 3), (self.folder / "rtrun.log").read_text()[-5000:]

    def kill_runner(self) -> None:
        with self._lock:
            if self.runners:
                self.random.choice(list(self.runners.values())).kill()

    def cut(self) -> None:
        """End the sessions of half of the boards."""
        for name in self.random.sample(list(self.boards), len(self.boards) // 2):
            self._end_sessions(name)

    def kill_servers(self) -> None:
        """End half of the SSH servers, which are there again after some seconds."""
        names = self.random.sample(list(self.boards), len(self.boards) // 2)
        for name in names:
            self._end_sessions(name)
            self.servers[name].kill()
        time.sleep(3)
        for name in names:
            self.servers[name].wait()
            config = self.boards[name].folder / "config"
            self.servers[name] = subprocess.Popen(
                [*_ALONE, config.parent, self.folder / "board", SSHD, "-D", "-e", "-f", config],
                stderr=subprocess.DEVNULL,
            )

    def kill_exporter(self) -> None:
        self.farm.end("exporter", signal.SIGKILL)
        time.sleep(self.random.uniform(0, 15))
        self.farm.start("exporter")

    def kill_coordinator(self) -> None:
        """It has written its places, as it does every 15 s, and the exporter follows it."""
        self.farm.end("coordinator", signal.SIGKILL)
        self.farm.end("exporter")
        self.farm.start("coordinator")
        self.farm.start("exporter")

    def end(self) -> None:
        """End the servers that were started again."""
        for server in self.servers.values():
            server.kill()

    def _end_sessions(self, name: str) -> None:
        with contextlib.suppress(OSError):
            pid = self.servers[name].pid
            for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(child), signal.SIGKILL)

    def kills(self):
        return [self.kill_runner] * 4 + [self.cut, self.kill_servers, self.kill_exporter, self.kill_coordinator]


@pytest.fixture
def lab(tmp_path, ros_master):
    (tmp_path / "board").mkdir()
    wishes = write_faulty_suites(tmp_path / "suites")
    program = tmp_path / "suites/lib/cyclic_timer_tests/cyclic_timer_tests"
    text = program.read_text()
    for path in (wishes.wishes, wishes.journal):  # those of each board are its own
        text = text.replace(repr(str(path)), repr(str(tmp_path / "board" / path.name)))
    (tmp_path / "program").write_text(text)
    (tmp_path / "program").chmod(0o755)
    program.write_text(WRAPPER.format(executed=tmp_path / "board/executed", program=tmp_path / "program"))
    program.chmod(0o755)
    campaign = {"suite": "cyclic_timer_tests", "repetitions": 10, "frequency_hz": [100 + k for k in range(RUNS)]}
    (tmp_path / "campaign.yml").write_text(yaml.safe_dump({"schema": 1, "name": "soak", "runs": [campaign]}))
    with contextlib.ExitStack() as stack:
        boards, resources = {}, {}
        for number in range(BOARDS):
            name = f"board-{number:02}"
            (folder := tmp_path / "boards" / name).mkdir(parents=True)
            shutil.copy(wishes.wishes, folder)
            boards[name] = stack.enter_context(serve(folder, (*_ALONE, str(folder), str(tmp_path / "board"))))
            service = {"address": "127.0.0.1", "port": boards[name].port, "username": boards[name].user}
            resources[name] = {"NetworkService": service}
        keys = "".join(f"[127.0.0.1]:{board.port} {board.host_key}\n" for board in boards.values())
        (tmp_path / "known_hosts").write_text(keys)
        environment = {
            name: {
                "resources": {"RemotePlace": {"name": name}},
                "drivers": [{"SSHDriver": {"keyfile": str(board.key)}}],
            }
            for name, board in boards.items()
        }
        (tmp_path / "env.yaml").write_text(yaml.safe_dump({"targets": environment}))
        (farm_folder := tmp_path / "farm").mkdir()
        farm = stack.enter_context(farm_of(farm_folder, resources, {"pool": "lab"}))
        target = {
            "schema": 1, "name": "lab", "kind": "labgrid", "filter": {"pool": "lab"}, "coordinator": farm.coordinator,
            "environment": "env.yaml", "known_hosts": "known_hosts", "suites": "suites", "reconnect_s": 60,
            "work_dir": str(tmp_path / "board" / "rt-tests"), "ros_master_port": ros_master,
        }  # fmt: skip
        (tmp_path / "lab.yml").write_text(yaml.safe_dump(target))
        lab = Lab(farm, boards, tmp_path)
        stack.callback(lab.end)
        yield lab


def test_nothing_is_lost_or_run_twice(lab):
    began = time.monotonic()
    with ThreadPoolExecutor(AT_ONCE) as threads:
        waiting = [threads.submit(lab.measure, number) for number in range(CAMPAIGNS)]
        for number in range(KILLS):
            # Spread over the campaigns.
            while lab.closed < number * CAMPAIGNS // (KILLS + 1):
                assert not any(future.done() and future.exception() for future in waiting)
                time.sleep(0.1)
            time.sleep(lab.random.uniform(0, 5))
            kill = lab.random.choice(lab.kills())
            print(f"{time.monotonic() - began:6.0f} s  {number + 1} of {KILLS}: {kill.__name__}", flush=True)
            kill()
            lab.done[kill.__name__] += 1
        for future in waiting:
            future.result()
    print(f"seed {SEED}, {BOARDS} boards, {CAMPAIGNS} campaigns in {time.monotonic() - began:.0f} s:", lab.done)

    assert "Traceback" not in (lab.folder / "rtrun.log").read_text()
    executed: Counter[str] = Counter()
    used = 0
    for board in lab.boards.values():
        if (path := board.folder / "executed").exists():
            executed.update(path.read_text().split())
            used += 1
        assert not list(board.folder.glob("rt-tests/runs/*/*")), "nothing of a run stays on a board"
    closed = [verify(path.parent) for path in lab.folder.glob("results/*/0*/run.json")]
    records = [record for record in closed if record.status is RunStatus.OK]
    assert len(records) == CAMPAIGNS * RUNS, "each run is there, and none was measured again that was whole"
    assert {record.attempt for record in records} <= executed.keys()
    again = Counter(record.reason for record in closed if record.status is not RunStatus.OK)
    print(f"{used} boards measured; measured again: {again or 'nothing'}")
    assert executed.keys() <= {record.attempt for record in closed}, "no attempt is forgotten"
    assert set(executed.values()) == {1}
