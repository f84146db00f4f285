"""What the runner adds to a run beyond the suite's own time, on a target behind the real sshd on loopback.

`make bench` runs it; it is no test. Side by side: each run through the runner, the same programs started by hand, and
commands that do nothing over the same kind of connection. What the runner adds is counted in such commands, because
their time tells how fast the machine is at that moment; at 7 ms a command, 150 of them are 1 s.
"""

import os
import signal
import statistics
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path, PurePosixPath

import pytest

import rtgen.cli
from rtrun.execution import campaign_runner
from rtrun.plan import conditions
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import SET_UP_S, Run
from rtrun.results.record import read_record
from rtrun.targets.address import Address
from rtrun.targets.connection import Connection
from rtrun.targets.ssh.ssh_shell import SshShell

TOP = Path(__file__).parents[2]
RUNS = 8
# Empty commands after each run.
COMMANDS = 10
# What the runner adds to a run, in empty commands.
LIMIT = 80
LONG_RUNS, LONG_RUN_S = 2, 60
MEASURING_SHARE = 0.98
# A campaign as people run it: every suite, subscribers, a baseline, loads.
MIXED = (
    {"suite": "cyclic_timer_tests", "frequency_hz": 100, "repetitions": 500},
    {"suite": "oneshot_timer_tests", "timeout_us": 1000, "repetitions": 5000, "policy": ["0", "RR"]},
    {"suite": "communication_tests", "frequency_hz": 100, "repetitions": 500, "subscribers": [1, 2]},
    {"suite": "cyclictest", "repetitions": 5000, "policy": "RR"},
    {"suite": "cyclic_timer_tests", "frequency_hz": 100, "repetitions": 500, "condition": ["cpu80", "memory"]},
)
# In such a campaign, beyond the programs by hand and the time that a load needs to settle.
MIXED_LIMIT = 150
# The time that it takes may differ by so much from what `plan` lists for it, as a share of that.
PLAN_LIMIT = 0.1


pytestmark = pytest.mark.timeout(0)  # about ten minutes of measuring on an idle machine


class Clock:
    """An observer that takes the time of every run, then those of the programs by hand and of empty commands."""

    def __init__(self, address: Address, by_hand: Callable[[Run], float] | None):
        self.elapsed_s: list[float] = []
        self.by_hand_s: list[float] = []
        self.command_s: list[float] = []
        self.beside_s = 0.0
        self.commands = 0
        self.is_running = False
        self.by_hand = by_hand
        self.connection = Connection(address)

    def began(self, number, run):
        self.start, self.is_running = time.monotonic(), True

    def ended(self, number, run, status, reason):
        assert status == "ok", reason
        end, self.is_running = time.monotonic(), False
        self.elapsed_s.append(end - self.start)
        if self.by_hand:
            self.by_hand_s.append(self.by_hand(run))
            for _ in range(COMMANDS):
                start = time.monotonic()
                self.connection.run(["true"])
                self.command_s.append(time.monotonic() - start)
        self.beside_s += time.monotonic() - end

    def note(self, text):
        print(text)

    on_figures = None

    def in_commands(self, seconds: float) -> str:
        """A time in empty commands."""
        return f"{seconds:.2f} s, {self.ratio(seconds):.0f} empty commands of {1000 * self.empty_s():.1f} ms"

    def ratio(self, seconds: float) -> float:
        return seconds / self.empty_s()

    def empty_s(self) -> float:
        return statistics.median(self.command_s)


def time_by_hand(results: Path, run: Run, folder: Path, port: int) -> float:
    """Start the programs of a closed run as its record has them, beside the same load; return how long they take."""
    folder.mkdir(exist_ok=True)
    environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
    loads = conditions.background(
        run.condition,
        run.settings,
        cpus=os.cpu_count() or 1,
        programs={},
        scripts=PurePosixPath(),
        environment=(),
        expected_s=run.expected_s,
        deadline_s=run.total_s,
    )
    with (folder / "output").open("wb") as output, ExitStack() as stack:

        def start(argv: list[str]) -> subprocess.Popen[bytes]:
            return subprocess.Popen(
                argv, cwd=folder, env=environment, stdout=output, stderr=output, start_new_session=True
            )

        for entry in loads:
            load = start(list(entry.program.argv))
            stack.callback(load.wait)
            stack.callback(os.killpg, load.pid, signal.SIGKILL)
        time.sleep(run.settle_s)
        began = time.monotonic()
        # Subscribers stand last in the record, and start first.
        programs = [start(program.argv) for program in reversed(read_record(results / run.name).programs)]
        assert [program.wait(600) for program in programs] == [0] * len(programs), (folder / "output").read_text()
        return time.monotonic() - began


def test_overhead(sshd, ros_master, tmp_path, monkeypatch):
    monkeypatch.chdir(TOP)
    assert rtgen.cli.main(["suites", "build", "--machine", "host"]) == 0
    suites = TOP / "build" / "suites" / "host"
    target = sshd.target(tmp_path / "target", suites=suites, master_port=ros_master)

    def measure(name, entries, by_hand=True):
        """Run a campaign; return its runs, their times and how long it took without what was done beside it."""
        results = tmp_path / name
        beside = by_hand and (lambda run: time_by_hand(results, run, tmp_path / "by-hand", ros_master))
        clock = Clock(sshd.address, beside)
        real = SshShell.execute

        def counted(*words, **options):
            clock.commands += clock.is_running
            return real(*words, **options)

        with monkeypatch.context() as patched, closing(clock.connection):
            patched.setattr(SshShell, "execute", counted)
            start = time.monotonic()
            runs = plan(Campaign(schema=1, name=name, runs=entries), name)
            campaign_runner.run_campaign(target, name, runs, results, clock)
            return runs, clock, time.monotonic() - start - clock.beside_s

    entry = {"suite": "cyclic_timer_tests", "frequency_hz": 100, "repetitions": 200}
    runs, clock, _ = measure("plain", [entry | {"repeats": RUNS}])
    added_s = statistics.median(clock.elapsed_s) - statistics.median(clock.by_hand_s)
    added = clock.ratio(added_s)
    print(
        f"\nthe runner adds to a run {clock.in_commands(added_s)} (limit {LIMIT}; medians of {RUNS} runs; "
        f"{clock.commands / len(runs):.1f} commands a run; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} CPUs)"
    )

    _, _, elapsed_s = measure("long", [entry | {"repetitions": 100 * LONG_RUN_S, "repeats": LONG_RUNS}], by_hand=False)
    measuring_share = LONG_RUNS * LONG_RUN_S / elapsed_s
    print(
        f"measuring: {measuring_share:.1%} of the wall time of a campaign of {LONG_RUNS} runs of {LONG_RUN_S} s, "
        f"set-up included (limit {MEASURING_SHARE:.0%})"
    )

    runs, clock, elapsed_s = measure("mixed", [entry | {"repeats": 2} for entry in MIXED])
    rows = [
        (run_s - by_hand_s - run.settle_s, run_s, by_hand_s, run)
        for run, run_s, by_hand_s in zip(runs, clock.elapsed_s, clock.by_hand_s, strict=True)
    ]
    for own_s, run_s, by_hand_s, run in sorted(rows, key=lambda row: -row[0])[:5]:
        print(f"  {own_s:.2f} s: {run_s:.2f} s, by hand {by_hand_s:.2f} s, planned {run.total_s:.2f} s  {run.name}")
    mixed_s = statistics.mean(row[0] for row in rows)
    mixed = clock.ratio(mixed_s)
    of_plan = elapsed_s / (SET_UP_S + sum(run.total_s for run in runs))
    print(
        f"a mixed campaign of {len(runs)} runs: the runner adds to a run {clock.in_commands(mixed_s)} "
        f"(limit {MIXED_LIMIT}); it takes {of_plan:.2f} of the time that plan lists (limit: 1 +- {PLAN_LIMIT})"
    )
    assert added <= LIMIT
    assert mixed <= MIXED_LIMIT
    assert abs(of_plan - 1) <= PLAN_LIMIT
    assert measuring_share >= MEASURING_SHARE
