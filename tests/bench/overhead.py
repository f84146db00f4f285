"""What the runner adds to a run beyond the suite's own time, on a target behind the real sshd on loopback.

`make bench` runs it; it is no test. Side by side: each run through the runner, and the same programs, started by hand.
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
from rtrun.plan.run import Run
from rtrun.results.record import read_record
from rtrun.target.config import Target
from rtrun.target.connection import Connection
from rtrun.target.ssh import SshShell

TOP = Path(__file__).parents[2]
RUNS = 8
# What the runner adds to a run, in commands that do nothing over the same connection.
COMMANDS_LIMIT = 80
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
MIXED_LIMIT_S = 1.0
# Of the time that `plan` lists for it, the time that it may take.
PLAN_LIMIT = 1.1


class Clock:
    """An observer that takes the time of every run, with the runner and then by hand, and counts the commands."""

    def __init__(self, by_hand: Callable[[Run], float] | None):
        self.elapsed_s: list[float] = []
        self.by_hand_s: list[float] = []
        self.commands = 0
        self.by_hand = by_hand

    def began(self, number, run):
        self.start = time.monotonic()

    def ended(self, number, run, status, reason):
        assert status == "ok", reason
        self.elapsed_s.append(time.monotonic() - self.start)
        if self.by_hand:
            self.by_hand_s.append(self.by_hand(run))

    def note(self, text):
        print(text)


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

        for each in loads:
            load = start(list(each.program.argv))
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
    target = Target(
        name="loopback",
        address=sshd.address,
        suites=suites,
        work_dir=PurePosixPath(tmp_path / "target"),
        ros_setup=None,
        ros_master_port=ros_master,
        reconnect_s=20,
        boot_s=0,
        console=None,
        failure=lambda: None,
    )

    def measure(name, entries, by_hand=True):
        """Run a campaign; return its runs, their times and how long all of it took without what was run by hand."""
        results = tmp_path / name
        clock = Clock(by_hand and (lambda run: time_by_hand(results, run, tmp_path / "by-hand", ros_master)))
        real = SshShell.execute

        def counted(*words, **options):
            clock.commands += 1
            return real(*words, **options)

        with monkeypatch.context() as patched:
            patched.setattr(SshShell, "execute", counted)
            start = time.monotonic()
            runs = plan(Campaign(schema=1, name=name, runs=entries), name)
            campaign_runner.run_campaign(target, name, runs, results, clock)
        return runs, clock, time.monotonic() - start - sum(clock.by_hand_s)

    entry = {"suite": "cyclic_timer_tests", "frequency_hz": 100, "repetitions": 200}
    runs, clock, _ = measure("plain", [entry | {"repeats": RUNS + 1}])
    added_s = statistics.median(clock.elapsed_s[1:]) - statistics.median(clock.by_hand_s[1:])  # the first one deploys
    command_s = []
    with closing(Connection(sshd.address)) as connection:
        for _ in range(50):
            start = time.monotonic()
            connection.run(["true"])
            command_s.append(time.monotonic() - start)
    added_commands = added_s / statistics.median(command_s)
    print(
        f"\nthe runner adds {added_s:.2f} s a run, as much as {added_commands:.0f} empty commands of "
        f"{statistics.median(command_s) * 1000:.1f} ms (limit {COMMANDS_LIMIT}; medians of {RUNS} runs; "
        f"{clock.commands / len(runs):.1f} commands a run; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} CPUs)"
    )

    _, _, elapsed_s = measure("long", [entry | {"repetitions": 100 * LONG_RUN_S, "repeats": LONG_RUNS}], by_hand=False)
    measuring_share = LONG_RUNS * LONG_RUN_S / elapsed_s
    print(
        f"measuring: {measuring_share:.1%} of the wall time of a campaign of {LONG_RUNS} runs of {LONG_RUN_S} s, "
        "set-up included"
    )

    runs, clock, elapsed_s = measure("mixed", [entry | {"repeats": 2} for entry in MIXED])
    rows = [
        (elapsed_s - by_hand_s - run.settle_s, elapsed_s, by_hand_s, run)
        for run, elapsed_s, by_hand_s in zip(runs, clock.elapsed_s, clock.by_hand_s, strict=True)
    ]
    for own_s, run_s, by_hand_s, run in sorted(rows, key=lambda row: -row[0])[:5]:
        print(f"  {own_s:.2f} s: {run_s:.2f} s, by hand {by_hand_s:.2f} s, planned {run.total_s:.2f} s  {run.name}")
    mixed_s = statistics.mean(row[0] for row in rows)
    of_plan = elapsed_s / sum(run.total_s for run in runs)
    print(
        f"a mixed campaign of {len(runs)} runs: the runner adds {mixed_s:.2f} s a run (limit {MIXED_LIMIT_S} s); "
        f"it takes {of_plan:.2f} of the time that plan lists (limit {PLAN_LIMIT})"
    )
    if mixed_s > MIXED_LIMIT_S:
        pytest.fail(f"a mixed campaign takes {mixed_s:.2f} s a run more, at most {MIXED_LIMIT_S} s were promised")
    if of_plan > PLAN_LIMIT:
        pytest.fail(f"a mixed campaign takes {of_plan:.2f} of the time that plan lists, at most {PLAN_LIMIT}")
    if added_commands > COMMANDS_LIMIT:
        pytest.fail(f"the runner adds as much as {added_commands:.0f} commands a run, at most {COMMANDS_LIMIT}")
    if measuring_share < MEASURING_SHARE:
        pytest.fail(
            f"{measuring_share:.1%} of the campaign was measuring, at least {MEASURING_SHARE:.0%} were promised"
        )
