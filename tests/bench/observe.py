"""What observing costs the programs that are observed: a pair with and without probes in turn, by its own stamps.

`make bench` runs it; it is no test. The programs stamp their messages by the clock of the trace: each message is of a
time with probes, or of one without. Prints a table for docs/observe.md: what a message takes longer, and of CPU time.
"""

import os
import platform
import subprocess
import time
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest

from ports import free_domain
from ros2 import wheels
from rtgen import suites as builder
from rtrun.cli import main
from rtrun.commands._link import linked
from rtrun.probes import session
from rtrun.probes.libraries.description import events
from rtrun.probes.placement import place
from rtrun.probes.programs import find_programs
from rtrun.targets import deploy
from rtrun.targets.config import parse_target
from rtrun.targets.inspection import facts as inspection
from suites.test_ros2 import set_up

pytestmark = [pytest.mark.ros, pytest.mark.timeout(0)]
FREQUENCY_HZ = 1000
TURNS, TURN_S, BETWEEN_S = 8, 8.0, 1.5
PROBES = {
    "none": (),
    "publish and take": ("publish", "take"),
    "all": events(),
}


def cpu_s(processes):
    """CPU time of processes so far, of all of their threads; in seconds, to a nanosecond where the kernel tells it."""
    total = 0.0
    for process in processes:
        for path in Path(f"/proc/{process.pid}/task").glob("*/schedstat"):
            total += int(path.read_text().split()[0]) / 1e9
    return total


def passes(seconds, stream):
    """Wait, and take meanwhile what is seen, about once a second."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        if stream is None:
            time.sleep(0.1)
        else:
            next(stream)


def measured_turns(processes, link):
    """(probes, begin, end, CPU time) of each turn; times of CLOCK_MONOTONIC in ns."""
    inspection.inspect(link)
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    pids = {process.pid for process in processes}
    found = tuple(each for each in find_programs(link, scripts) if each.program.pid in pids)
    assert len(found) == len(processes)
    for _ in range(TURNS):
        for name, wanted in PROBES.items():
            with ExitStack() as stack:
                stream = None
                if wanted:
                    placement = place(link, found, events=wanted)
                    stream = session.observe(link, scripts, placement, found, for_s=TURN_S + 30)
                    stack.enter_context(closing(stream))
                    assert isinstance(next(stream), session.Began)
                passes(BETWEEN_S, stream)
                begin_ns, begin_s = time.monotonic_ns(), cpu_s(processes)
                passes(TURN_S, stream)
                yield name, begin_ns, time.monotonic_ns(), cpu_s(processes) - begin_s
            time.sleep(BETWEEN_S)


def table(own, turns):
    """Rows of the table: of each set of probes the figures of its messages; `own` has (published, received) in ns."""
    rows = []
    for name in PROBES:
        latency, cpu, messages = [], 0.0, 0
        for turn, begin_ns, end_ns, cpu_time_s in turns:
            if turn == name:
                here = own[(own[:, 0] >= begin_ns) & (own[:, 0] < end_ns)]
                latency.append(here[:, 1] - here[:, 0])
                cpu, messages = cpu + cpu_time_s, messages + len(here)
        values = np.concatenate(latency) / 1000
        rows.append((name, messages, np.median(values), np.percentile(values, 99.9), 1e6 * cpu / messages))
    return rows


@pytest.fixture(params=["roscpp", "rcl"])
def programs(request, tmp_path):
    """Starts a subscriber and a publisher that measure themselves for some seconds; yields how, and the middleware."""
    if request.param == "roscpp":
        folder = builder.build("host", tmp_path / "suites") / "lib" / "communication_tests"
        port = request.getfixturevalue("ros_master")
        environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
        ending, waiting = "", ["-d", "3"]
    else:
        prefix = wheels.installed("kilted")
        built = builder.build("host", tmp_path / "suites", ros2=prefix)
        folder = next(built.glob("lib/*/communication_tests_publisher_rcl")).parent
        environment = os.environ | set_up(prefix) | {"ROS_DOMAIN_ID": str(free_domain()), "ROS_LOG_DIR": str(tmp_path)}
        ending, waiting = "_rcl", ["--subscribers", "1"]
    with ExitStack() as stack:

        def start(seconds):
            options = ["-r", str(int(seconds * FREQUENCY_HZ)), "-f", str(FREQUENCY_HZ), "--clock", "monotonic"]
            options += ["--out-dir", str(tmp_path)]
            started = []
            for role, more in (("subscriber", ["--idle-timeout", "20"]), ("publisher", waiting)):
                argv = [folder / f"communication_tests_{role}{ending}", *options, *more]
                process = subprocess.Popen(argv, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                stack.callback(process.wait, 60)
                stack.callback(process.kill)
                started.append(process)
            time.sleep(8)
            return started

        yield request.param, start


def own_stamps(processes, folder):
    """What the subscriber wrote when the publisher was ended: (published, received) in ns, a row a message."""
    processes[1].terminate()
    processes[0].wait(60)
    return np.load(next(folder.glob("ct_gnuplot*.npy")))


def test_cost(programs, tmp_path):
    middleware, start = programs
    processes = start(TURNS * len(PROBES) * (TURN_S + 2 * BETWEEN_S + 4) + 20)
    config = parse_target({"schema": 1, "name": "here", "kind": "local", "work_dir": str(tmp_path / "target")}, "bench")
    with linked(config, tmp_path) as link:
        turns = list(measured_turns(processes, link))
    rows = table(own_stamps(processes, tmp_path), turns)
    print(f"\n{middleware}, {FREQUENCY_HZ} Hz, {TURNS} turns of {TURN_S:g} s each, {platform.machine()}")
    print("| probes | messages | median us | p99.9 us | CPU us a message of both |\n|---|---|---|---|---|")
    for name, messages, median, high, cpu_us in rows:
        print(f"| {name} | {messages} | {median:.1f} | {high:.1f} | {cpu_us:.1f} |")


def test_agreement(programs, tmp_path):
    """By how much the programs' own latency is longer than the observed one, message by message."""
    middleware, start = programs
    processes = start(60)
    here = tmp_path / "here.yml"
    here.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/target\n")
    assert main(["observe", "--target", str(here), "--for", "30s", "--results", str(tmp_path / "results")]) == 0
    own = own_stamps(processes, tmp_path)
    (folder,) = tmp_path.glob("results/*-messages-*communication_tests*")
    observed = np.load(folder / f"{folder.name}.npy")
    # The last one whose own stamp is before the observed publication is the same message.
    place = np.searchsorted(own[:, 0], observed[:, 0], side="right") - 1
    longer = ((own[place, 1] - own[place, 0]) - (observed[:, 1] - observed[:, 0])) / 1000
    assert (own[place, 1] >= observed[:, 1]).all()
    print(f"\n{middleware}, {len(longer)} messages: own latency less the observed one, us")
    names = ("least", "1 %", "median", "99 %", "99.9 %", "most")
    print(
        ", ".join(f"{n} {v:.1f}" for n, v in zip(names, np.percentile(longer, (0, 1, 50, 99, 99.9, 100)), strict=True))
    )
