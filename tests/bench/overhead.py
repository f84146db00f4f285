"""What the runner adds to a run beyond the suite's own time, on a target behind the real sshd on loopback.

`make bench` runs it; it is no test. Side by side: each run through the runner, and the same program, started by hand.
"""

import os
import statistics
import subprocess
import time
from pathlib import Path, PurePosixPath

import pytest

import rtgen.cli
from rtrun.execution import campaign_runner
from rtrun.plan.campaign import Campaign, plan
from rtrun.target.config import Target
from rtrun.target.connection import Connection

TOP = Path(__file__).parents[2]
RUNS = 8
LIMIT_S = 0.4
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
# What is measured and what a load needs to settle, as `plan` lists them, are not counted; that the programs start ROS
# and end it is.
MIXED_LIMIT_S = 1.0


class Clock:
    """An observer that takes the time of every run and counts the commands in it."""

    def __init__(self):
        self.elapsed_s: list[float] = []
        self.commands = 0

    def began(self, number, run):
        self.start = time.monotonic()

    def ended(self, number, run, status, reason):
        assert status == "ok", reason
        self.elapsed_s.append(time.monotonic() - self.start)

    def note(self, text):
        print(text)


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
    clock = Clock()
    real = Connection.run

    def counted(*words, **options):
        clock.commands += 1
        return real(*words, **options)

    monkeypatch.setattr(Connection, "run", counted)
    entry = {"suite": "cyclic_timer_tests", "frequency_hz": 100, "repetitions": 200}
    runs = plan(Campaign(schema=1, name="bench", runs=[entry | {"repeats": RUNS + 1}]), "bench")
    campaign_runner.run_campaign(target, "bench", runs, tmp_path / "results", clock)
    with_runner_s = clock.elapsed_s[1:]  # the first one deploys

    program = suites / "lib" / "cyclic_timer_tests" / "cyclic_timer_tests"
    environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}", "ROS_IP": "127.0.0.1"}
    by_hand_s = []
    for _ in range(RUNS):
        start = time.monotonic()
        argv = [program, "-f", "100", "-r", "200", "-s", "0"]
        subprocess.run(argv, cwd=tmp_path, env=environment, check=True, capture_output=True)
        by_hand_s.append(time.monotonic() - start)

    overhead_s = statistics.median(with_runner_s) - statistics.median(by_hand_s)
    print(
        f"\nthe runner adds {overhead_s:.2f} s a run (limit {LIMIT_S} s; "
        f"{statistics.median(with_runner_s):.2f} s with it, {statistics.median(by_hand_s):.2f} s by hand, "
        f"medians of {RUNS}; {clock.commands / len(runs):.1f} commands a run; "
        f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} CPUs)"
    )
    entry |= {"repetitions": 100 * LONG_RUN_S, "repeats": LONG_RUNS}
    start = time.monotonic()
    runs = plan(Campaign(schema=1, name="long", runs=[entry]), "long")
    campaign_runner.run_campaign(target, "long", runs, tmp_path / "long", clock)
    measuring_share = LONG_RUNS * LONG_RUN_S / (time.monotonic() - start)
    print(
        f"measuring: {measuring_share:.1%} of the wall time of a campaign of {LONG_RUNS} runs of {LONG_RUN_S} s, "
        "set-up included"
    )
    runs = plan(Campaign(schema=1, name="mixed", runs=[entry | {"repeats": 2} for entry in MIXED]), "mixed")
    mixed = Clock()
    campaign_runner.run_campaign(target, "mixed", runs, tmp_path / "mixed", mixed)
    added_s = [elapsed_s - run.expected_s - run.settle_s for elapsed_s, run in zip(mixed.elapsed_s, runs, strict=True)]
    for run, each_s in sorted(zip(runs, added_s, strict=True), key=lambda pair: -pair[1])[:5]:
        print(f"  {each_s:.2f} s  {run.name}")
    mixed_s = statistics.mean(added_s)
    print(
        f"a mixed campaign of {len(runs)} runs: {mixed_s:.2f} s a run beyond what plan lists (limit {MIXED_LIMIT_S} s)"
    )
    if mixed_s > MIXED_LIMIT_S:
        pytest.fail(f"a mixed campaign takes {mixed_s:.2f} s a run more, at most {MIXED_LIMIT_S} s were promised")
    if overhead_s > LIMIT_S:
        pytest.fail(f"the runner adds {overhead_s:.2f} s a run, at most {LIMIT_S} s were promised")
    if measuring_share < MEASURING_SHARE:
        pytest.fail(
            f"{measuring_share:.1%} of the campaign was measuring, at least {MEASURING_SHARE:.0%} were promised"
        )
