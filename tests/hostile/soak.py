"""A campaign through a hundred faults: every run is finished once.

`rtrun run` measures on a real sshd on loopback while the runner is killed, stopped and hung up, the link is cut and
frozen, the disks of both sides fill up, and files are damaged. In the end every run is whole, the attempt that it was
closed with was executed exactly once, and it was closed as ok once, and once more for each time that its files were
damaged afterwards. Once the program of the suites observes the runs; once the script does, on a target that hides the
threads of its kernel, as a container.

Run: make soak [SEED=7] [RUNS=50] [FAULTS=100]. The disks that fill up are mounts: without root those faults are left
out.
"""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml
from faulty import write_faulty_suites
from proxy import Proxy, proxy_to

from conftest import kernel_threads_hidden, serve
from rtrun.results.record import RunStatus, verify

pytestmark = [pytest.mark.sshd, pytest.mark.ros, pytest.mark.timeout(0)]

SEED = int(os.environ.get("SEED") or 1)
RUNS = int(os.environ.get("RUNS") or 50)
FAULTS = int(os.environ.get("FAULTS") or 100)
DISK_MIB = 64
# A runner that nobody disturbs any more closes every run in this time, however slow the machine is.
END_S = 3600.0

# Stands before the program of a suite, and writes down which attempt is executed.
WRAPPER = """#!/bin/sh
sed -n 's/.*"uid": "\\([0-9a-f]*\\)".*/\\1/p' attempt.json >>{executed}
echo >>{executed} # the file ends without a line's end
# Long enough for faults to meet runs that measure.
sleep 0.7
exec {program} "$@"
"""


@dataclass(kw_only=True)
class Soak:
    """The campaign under way, and what was done to it."""

    random: random.Random
    argv: list[str]
    results: Path
    work_dir: Path
    log: Path
    proxy: Proxy
    disks: bool
    runner: subprocess.Popen[bytes] | None = None
    done: Counter[str] = field(default_factory=Counter)
    damaged: Counter[str] = field(default_factory=Counter)
    """How often each run was damaged after it had been closed as ok."""

    def start(self) -> subprocess.Popen[bytes]:
        """Return the runner; one that has ended is started again."""
        if self.runner is None or self.runner.poll() is not None:
            with self.log.open("ab") as log:
                self.runner = subprocess.Popen(self.argv, stdout=log, stderr=log)
        return self.runner

    def kill(self) -> None:
        """End the runner as a power cut would."""
        runner = self.start()
        runner.kill()
        runner.wait()

    def stop(self) -> None:
        runner = self.start()
        runner.send_signal(signal.SIGSTOP)
        self._pause()
        runner.send_signal(signal.SIGCONT)

    def hang_up(self) -> None:
        runner = self.start()
        runner.send_signal(signal.SIGHUP)
        runner.wait(300)

    def cut(self) -> None:
        self.proxy.cut()
        self._pause()
        self.proxy.mend()

    def freeze(self) -> None:
        self.proxy.freeze()
        self._pause()
        self.proxy.mend()

    def fill_results(self) -> None:
        self._fill(self.results.parent)

    def fill_target(self) -> None:
        self._fill(self.work_dir.parent)

    def damage_results(self) -> None:
        """Damage a file of a run that is closed, while no runner is at work."""
        self.kill()
        folders = [folder for folder in sorted(self.results.glob("[0-9]*")) if _is_whole(folder)]
        if not folders:
            return
        folder = self.random.choice(folders)
        self._damage(self.random.choice(sorted(path for path in folder.iterdir() if path.stat().st_size)))
        self.damaged[folder.name] += 1

    def damage_target(self) -> None:
        """Damage an attempt file on the target, while no runner is at work."""
        self.kill()
        for path in self.work_dir.glob("runs/*/*/attempt.json"):
            self._damage(path)

    def _damage(self, path: Path) -> None:
        match self.random.choice(["remove", "cut", "overwrite"]):
            case "remove":
                path.unlink()
            case "cut":
                os.truncate(path, path.stat().st_size // 2)
            case "overwrite":
                path.write_bytes(self.random.randbytes(100))

    def _fill(self, disk: Path) -> None:
        ballast = disk / "ballast"
        with contextlib.suppress(OSError), ballast.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(1 << 16))
        self._pause()
        ballast.unlink()

    def _pause(self) -> None:
        time.sleep(self.random.uniform(0.2, 3))

    def faults(self) -> list[Callable[[], None]]:
        faults = [self.kill, self.kill, self.stop, self.hang_up, self.cut, self.freeze]
        faults += [self.damage_results, self.damage_target]
        return faults + [self.fill_results, self.fill_target] * self.disks


def _is_whole(folder: Path) -> bool:
    try:
        return verify(folder).status is RunStatus.OK
    except Exception:
        return False


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """Mount a small disk on a folder; yields whether that is allowed."""
    folder.mkdir()
    argv = ["mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m,mode=755", "tmpfs", folder]
    is_mounted = subprocess.run(argv, capture_output=True, check=False).returncode == 0
    try:
        yield is_mounted
    finally:
        if is_mounted:
            subprocess.run(["umount", "--lazy", folder], check=False)


@pytest.fixture(params=["program", "script in a container"])
def soak(request, tmp_path, ros_master):
    write_faulty_suites(tmp_path / "suites")
    program = tmp_path / "suites/lib/cyclic_timer_tests/cyclic_timer_tests"
    kept = tmp_path / "cyclic_timer_tests"
    kept.write_text(program.read_text())
    kept.chmod(0o755)
    program.write_text(WRAPPER.format(executed=tmp_path / "executed", program=kept))
    is_hidden = request.param != "program"
    if not is_hidden:
        sampler = tmp_path / "suites/lib/rt_tests_sampler"
        sampler.mkdir()
        shutil.copy(request.getfixturevalue("sampler_program"), sampler)
    (tmp_path / "sshd").mkdir()
    campaign = {
        "schema": 1,
        "name": "soak",
        "runs": [
            {"suite": "cyclic_timer_tests", "repetitions": 10, "frequency_hz": [100 + number for number in range(RUNS)]}
        ],
    }
    (tmp_path / "campaign.yml").write_text(yaml.safe_dump(campaign))
    with (
        small_disk(tmp_path / "here") as has_disk_here,
        small_disk(tmp_path / "there") as has_disk_there,
        kernel_threads_hidden(tmp_path) if is_hidden else contextlib.nullcontext(()) as wrapper,
        serve(tmp_path / "sshd", wrapper) as sshd,
        proxy_to(sshd.port) as proxy,
    ):
        target = {
            "schema": 1, "name": "loopback", "kind": "ssh", "host": "127.0.0.1", "port": proxy.port,
            "user": sshd.user, "key": str(sshd.key), "host_key": sshd.host_key, "suites": str(tmp_path / "suites"),
            "work_dir": str(tmp_path / "there" / "rt-tests"), "ros_master_port": ros_master, "reconnect_s": 60,
        }  # fmt: skip
        (tmp_path / "target.yml").write_text(yaml.safe_dump(target))
        results = tmp_path / "here" / "results"
        argv = [sys.executable, "-m", "rtrun.cli", "run", str(tmp_path / "campaign.yml")]
        yield Soak(
            random=random.Random(SEED),
            argv=[*argv, "--target", str(tmp_path / "target.yml"), "--results", str(results)],
            results=results,
            work_dir=tmp_path / "there" / "rt-tests",
            log=tmp_path / "rtrun.log",
            proxy=proxy,
            disks=has_disk_here and has_disk_there,
        )


def test_every_run_is_finished_once(soak, tmp_path):
    began = time.monotonic()
    for number in range(FAULTS):
        soak.start()
        time.sleep(soak.random.uniform(0, 8))
        fault = soak.random.choice(soak.faults())
        print(f"{time.monotonic() - began:6.0f} s  {number + 1} of {FAULTS}: {fault.__name__}", flush=True)
        fault()
        soak.done[fault.__name__] += 1
    # A full disk or a cut link may have failed runs: the next call measures those again.
    deadline = time.monotonic() + END_S
    while (status := soak.start().wait(END_S)) != 0:
        assert status in (-signal.SIGKILL, 3, 130), soak.log.read_text()[-5000:]
        assert time.monotonic() < deadline, soak.log.read_text()[-5000:]
    print(f"seed {SEED}, {RUNS} runs, {sum(soak.done.values())} faults in {time.monotonic() - began:.0f} s:", soak.done)

    assert "Traceback" not in soak.log.read_text(), soak.log.read_text()
    executed = Counter((tmp_path / "executed").read_text().split())
    folders = [folder for folder in soak.results.glob("[0-9]*") if ".old-" not in folder.name]
    folders = [folder for folder in folders if ".incomplete-" not in folder.name]
    assert len(folders) == RUNS
    for folder in folders:
        record = verify(folder)
        assert record.status is RunStatus.OK
        assert executed[record.attempt] == 1, (folder.name, executed[record.attempt])
        earlier = [_status(old) for old in soak.results.glob(f"{folder.name}.old-*")]
        assert len([status for status in earlier if status in (None, "ok")]) == soak.damaged[folder.name], folder.name
    assert subprocess.run([*soak.argv[:3], "verify", str(soak.results)], check=False).returncode == 0
    assert not list(soak.work_dir.glob("runs/*/*")), "nothing of a run stays on the target"


def _status(folder: Path) -> str | None:
    """The status in a run.json; None for one that was damaged."""
    try:
        return str(json.loads((folder / "run.json").read_text())["status"])
    except (OSError, ValueError, TypeError, KeyError):
        return None
