"""The CPU time that observing costs, of the program of the suites and of the script, here and on the emulated board.

`make bench` runs it; it is no test. The time is what the kernel accounts to the sampler and all that it started. What
other programs take from QEMU meanwhile, the board accounts to what runs there: the host must be idle.
"""

import os
import re
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import pytest

import rtgen.cli
from rtrun.execution.preparation import SAMPLER
from rtrun.plan import suites
from rtrun.targets import deploy
from rtrun.targets.config import connect, read_target
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.link import Link

TOP = Path(__file__).parents[2]
LASTS_S = 60
# Of one core, for the program.
LIMIT_PERCENT = 1.0
# The last line of `times` is of all children that were waited for: user and system time.
COMMAND = f'mkdir -p "$1" && {{ timeout {LASTS_S} "$2" "$1" 95 "" >"$1/out"; grep -c "^at " "$1/out"; times; }}'

# Runs of each suite with the sampler beside it, and as many without, in turn.
PAIRS = 7
RUNS = {
    "oneshot_timer_tests": {"policy": "RR", "repetitions": 5000, "timeout_us": 1000},
    "cyclic_timer_tests": {"policy": "RR", "repetitions": 5000, "frequency_hz": 1000},
    "communication_tests": {"policy": "RR", "repetitions": 2500, "frequency_hz": 500},
}

pytestmark = [pytest.mark.qemu, pytest.mark.timeout(0)]


def cost_percent(run: Callable[[list[str]], str], sampler: str, folder: str) -> float:
    """Of one core."""
    observed, *_, children = run(["sh", "-c", COMMAND, "sh", folder, sampler]).splitlines()
    assert int(observed) > LASTS_S / 4, f"{sampler} observed {observed} times in {LASTS_S} s"  # each 2 s
    spent = re.findall(r"(\d+)m([\d.]+)s", children)
    return 100 * sum(60 * int(minutes) + float(seconds) for minutes, seconds in spent) / LASTS_S


def here(argv: list[str]) -> str:
    return subprocess.run(argv, capture_output=True, text=True, check=True).stdout


def test_cost(tmp_path, monkeypatch):
    monkeypatch.chdir(TOP)
    for machine in ("host", "qemu-armv7"):
        assert rtgen.cli.main(["suites", "build", "--machine", machine]) == 0
    assert rtgen.cli.main(["board", "build", "--machine", "qemu-armv7"]) == 0
    costs = {
        "this machine, program": cost_percent(here, f"build/suites/host/lib/{SAMPLER}/{SAMPLER}", str(tmp_path)),
        "this machine, script": cost_percent(here, str(deploy.ON_TARGET / "sample.sh"), str(tmp_path)),
    }
    target_file = TOP / "targets" / "qemu.yml"
    with (
        connect(read_target(target_file), target_file.parent, tmp_path / "console.log") as board,
        Link(board, print) as link,
    ):
        inspection.inspect(link)  # makes the folders
        suites = deploy.deploy(link, TOP / "build" / "suites" / "qemu-armv7", "suites")
        scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")

        def there(argv: list[str]) -> str:
            return link.check(argv, deadline_s=2 * LASTS_S)

        folder = str(board.work_dir / "bench")
        costs["emulated board, program"] = cost_percent(there, str(suites / "lib" / SAMPLER / SAMPLER), folder)
        costs["emulated board, script"] = cost_percent(there, str(scripts / "sample.sh"), folder)
        threads = len(link.check(["sh", "-c", "ls -d /proc/[0-9]*/task/[0-9]*"]).split())
    for name, percent in costs.items():
        print(f"\n{name}: {percent:.2f} % of a core", end="")
    print(f"\nemulated board: {threads} threads")
    assert costs["emulated board, program"] <= LIMIT_PERCENT


def test_the_suites_beside_it(ros_master, tmp_path, monkeypatch):
    """What observing costs the programs that are observed."""
    monkeypatch.chdir(TOP)
    assert rtgen.cli.main(["suites", "build", "--machine", "host"]) == 0
    built = TOP / "build" / "suites" / "host" / "lib"
    environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}", "ROS_IP": "127.0.0.1"}

    def start(argv: list[str]) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(argv, cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL)

    def cpu_s(suite: str) -> float:
        """Of all programs of a run of a suite."""
        # A subscriber stands behind its publisher, and starts first.
        programs = [
            start([str(built / suite / program), *suites.argv(suite, program, RUNS[suite])[1:]])
            for program in reversed(suites.suite(suite).programs)
        ]
        used_s = 0.0
        for program in programs:
            _, status, used = os.wait4(program.pid, 0)
            assert status == 0
            used_s += used.ru_utime + used.ru_stime
        return used_s

    for suite in RUNS:
        taken: dict[bool, list[float]] = {True: [], False: []}
        for number in range(2 * PAIRS):
            observed = number % 2 == 0
            with (
                start([str(built / SAMPLER / SAMPLER), str(tmp_path), "95", ""])
                if observed
                else nullcontext() as beside
            ):
                taken[observed].append(cpu_s(suite))
                if beside:
                    assert beside.poll() is None, "the sampler ended before the suite"
                    beside.terminate()
        # Whatever else runs makes CPU time longer.
        without_s, with_s = (min(taken[observed]) for observed in (False, True))
        print(f"\n{suite}: {without_s:.3f} s of CPU time, beside the sampler {with_s / without_s - 1:+.1%}", end="")
