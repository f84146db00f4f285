"""What observing costs the programs that are observed, and how far what it says agrees with what they say themselves.

`make bench` runs it; it is no test. Prints the tables of docs/observe.md. Each pair of programs stamps its messages by
the clock of the trace. All probes are placed, and switched on and off set by set, second by second, so that each second
with probes has one without near it. CPU time is what the kernel has counted for the threads of both programs.
"""

import os
import platform
import re
import resource
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from probes.standin import TRACING, tell
from scipy import stats

from ports import free_domain
from ros2 import wheels
from rtgen import suites as builder
from rtrun.cli import main
from rtrun.commands._link import linked
from rtrun.execution.observation import OF_PATHS
from rtrun.probes import session
from rtrun.probes.libraries.description import events, libraries
from rtrun.probes.placement import line_of, place
from rtrun.probes.programs import find_programs
from rtrun.probes.symbols import read_symbols
from rtrun.targets import deploy
from rtrun.targets.config import parse_target
from rtrun.targets.inspection import facts as inspection
from suites.test_ros2 import set_up

pytestmark = [pytest.mark.ros, pytest.mark.timeout(0)]
# At the higher one a second has more messages to share what else is counted in it.
FREQUENCY_HZ = {"roscpp": 4000, "rcl": 4000, "rclpy": 1000}
TURNS, TURN_S = int(os.environ.get("RT_TESTS_OBSERVE_TURNS", "40")), 1.0
SETTLED_S = 0.1  # after probes were switched
AGREEMENT_S = 30
INSTANCES = TRACING / "instances"
HIT_TURNS = 15
# Each has those before it.
SETS = {
    "none": (),
    "publication, reception": ("publish", "take"),
    "all that are placed": tuple(event for event in events() if event not in OF_PATHS),
    "those for paths and causes, too": OF_PATHS,
}


def cpu_ns(processes):
    """CPU time of processes so far, of all of their threads."""
    return sum(
        int(path.read_text().split()[0])
        for process in processes
        for path in Path(f"/proc/{process.pid}/task").glob("*/schedstat")
    )


class Switch:
    """The probes of an observation, switched on and off at the kernel while the observation goes on."""

    def __init__(self, placement, before):
        (self._instance,) = set(INSTANCES.glob("rtrun-observe-*")) - before
        (self._group,) = (self._instance / "events").glob("rtrun_observe_*")
        self._names = {}
        for probe in placement.probes:
            self._names.setdefault(probe.event, []).append(probe.name)

    def off(self):
        (self._group / "enable").write_text("0")

    def on(self, wanted):
        for event in wanted:
            for name in self._names.get(event, ()):
                (self._group / name / "enable").write_text("1")


def measured_turns(processes, link, hits):
    """(set, begin, end, CPU time) of each turn, all in ns; what was seen of the processes is added to `hits`."""
    inspection.inspect(link)
    scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
    pids = {process.pid for process in processes}
    found = tuple(seen for seen in find_programs(link, scripts).found if seen.program.pid in pids)
    assert len(found) == len(processes)
    placement = place(link, found, events=events())
    before = set(INSTANCES.glob("rtrun-observe-*"))
    with closing(session.observe(link, scripts, placement, found, for_s=3600)) as stream:
        assert isinstance(next(stream), session.Began)
        is_over = threading.Event()

        def take():
            while not is_over.is_set():
                batch = next(stream)
                hits.extend((hit.at_ns, hit.event) for hit in batch.hits if hit.pid in pids)

        reader = threading.Thread(target=take)
        reader.start()
        try:
            switch = Switch(placement, before)
            for _ in range(TURNS):
                switch.off()
                for name, wanted in SETS.items():
                    switch.on(wanted)
                    time.sleep(SETTLED_S)
                    begin_ns, spent_ns = time.monotonic_ns(), cpu_ns(processes)
                    time.sleep(TURN_S)
                    yield name, begin_ns, time.monotonic_ns(), cpu_ns(processes) - spent_ns
        finally:
            time.sleep(2 * TURN_S)
            is_over.set()
            reader.join()


def table(own, turns, hits):
    """Rows of the table: of each set of probes the figures of its messages; `own` has (published, received) in ns."""
    seen_ns = np.sort(np.array([at_ns for at_ns, _ in hits], np.int64))
    figures = {name: ([], [], []) for name in SETS}
    for name, begin_ns, end_ns, spent_ns in turns:
        here = own[(own[:, 0] >= begin_ns) & (own[:, 0] < end_ns)]
        latency, cpu_us, seen = figures[name]
        latency.append((here[:, 1] - here[:, 0]) / 1000)
        cpu_us.append(spent_ns / 1000 / len(here))
        seen.append(np.diff(np.searchsorted(seen_ns, [begin_ns, end_ns]))[0] / len(here))
    rows = []
    for name, (latency, cpu_us, seen) in figures.items():
        if rows and np.mean(seen) < rows[-1][2] + 0.01:
            continue  # its probes are on functions that this pair does not call
        more_us = np.array(cpu_us) - np.array(figures["none"][1])
        sure_us = stats.t.ppf(0.975, len(more_us) - 1) * stats.sem(more_us)
        values = np.concatenate(latency)
        median, high = np.median(values), np.percentile(values, 99.9)
        assert len(values) and (name == "none") == (np.mean(seen) < 0.01), (name, len(values), np.mean(seen))
        rows.append((name, len(values), np.mean(seen), np.mean(cpu_us), more_us.mean(), sure_us, median, high))
    return rows


@pytest.fixture(params=["roscpp", "rcl", "rclpy"])
def programs(request, tmp_path):
    """Starts a listener and a talker that stamp their messages for some seconds; yields how, and the middleware."""
    if request.param == "roscpp":
        folder = builder.build("host", tmp_path / "suites") / "lib" / "communication_tests"
        port = request.getfixturevalue("ros_master")
        environment = os.environ | {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
        ending, waiting = "", ["-d", "3"]
    else:
        prefix = wheels.installed("kilted")
        environment = os.environ | set_up(prefix) | {"ROS_DOMAIN_ID": str(free_domain()), "ROS_LOG_DIR": str(tmp_path)}
        ending, waiting = "_rcl", ["--subscribers", "1"]
    if request.param == "rcl":
        built = builder.build("host", tmp_path / "suites", ros2=prefix)
        folder = next(built.glob("lib/*/communication_tests_publisher_rcl")).parent
    elif request.param == "rclpy":
        modules = next(prefix.glob("lib/python3*/site-packages"))
        environment |= {"PYTHONPATH": str(modules), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    with ExitStack() as stack:

        def calls(seconds):
            if request.param == "rclpy":
                script = Path(__file__).with_name("stamped.py")
                return [
                    [sys.executable, script, "listener", tmp_path / "ct_gnuplot.npy"],
                    [sys.executable, script, "talker"],
                ]
            hz = FREQUENCY_HZ[request.param]
            options = ["-r", str(int(seconds * hz)), "-f", str(hz), "--clock", "monotonic"]
            options += ["--out-dir", str(tmp_path)]
            return [
                [folder / f"communication_tests_subscriber{ending}", *options, "--idle-timeout", "20"],
                [folder / f"communication_tests_publisher{ending}", *options, *waiting],
            ]

        def start(seconds):
            started = []
            for argv in calls(seconds):
                process = subprocess.Popen(argv, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                stack.callback(process.wait, 60)
                stack.callback(process.kill)
                started.append(process)
            time.sleep(8)
            return started

        yield request.param, start


def own_stamps(processes, folder):
    """What the listener wrote when both were ended: (published, received) in ns, a row a message."""
    for process in reversed(processes):
        process.terminate()
        process.wait(60)
    return np.load(next(folder.glob("ct_gnuplot*.npy")))


def test_hit(tmp_path):
    """The CPU time of a hit of each probe: its arguments, at a function that is called over and over."""
    program, instance, group = tmp_path / "probed", INSTANCES / "bench-hit", "bench_hit"
    subprocess.run(["cc", "-O1", "-rdynamic", "-o", program, Path(__file__).with_name("probed.c")], check=True)
    found = read_symbols(program, ["probed"])
    instance.mkdir()
    rows = {}
    try:
        (instance / "trace_clock").write_text("mono")
        for name, library in libraries().items():
            for probe in library.probes:
                symbols = replace(found, offsets={probe.symbols[0]: found.offsets["probed"]})
                line = line_of(probe, symbols, probe.event, str(program), "")
                if (name, probe.event) not in rows:
                    rows[name, probe.event] = hit_ns(program, line, instance / "events" / group / probe.event, group)
    finally:
        instance.rmdir()
    print("\n| library | probe | CPU us a hit |\n|---|---|---|")
    for (name, event), ns in rows.items():
        print(f"| {name} | {event} | {ns / 1000:.2f} |")


def hits_of(name):
    """How often the kernel saw a probe hit so far."""
    counts = re.findall(rf"\s{name}\s+(\d+)", (TRACING / "uprobe_profile").read_text())
    return sum(map(int, counts))


def hit_ns(program, line, event, group):
    """The median of some turns with the probe, each less the one without before it."""
    word, rest = line.split(" ", 1)
    tell(f"{word}:{group}/{rest}")
    differences = []
    try:
        with subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            for _ in range(HIT_TURNS):
                taken = []
                for is_on in "01":
                    before = hits_of(event.name)
                    (event / "enable").write_text(is_on)
                    process.stdin.write("topic\n" if ":string" in line else "pointers\n")
                    process.stdin.flush()
                    taken.append(float(process.stdout.readline()))
                    assert (hits_of(event.name) > before) == (is_on == "1"), (event, is_on)
                differences.append(taken[1] - taken[0])
            (event / "enable").write_text("0")
            process.stdin.close()
    finally:
        tell(f"-:{group}/{rest.split()[0]}")
    return np.median(differences)


def test_cost(programs, tmp_path):
    middleware, start = programs
    processes, hits = start(30 + TURNS * len(SETS) * 4), []
    config = parse_target({"schema": 1, "name": "here", "kind": "local", "work_dir": str(tmp_path / "target")}, "bench")
    with linked(config, tmp_path) as link:
        turns = list(measured_turns(processes, link, hits))
    rows = table(own_stamps(processes, tmp_path), turns, hits)
    print(f"\n{middleware}, {FREQUENCY_HZ[middleware]} Hz, {TURNS} turns of {TURN_S:g} s each, {platform.machine()}")
    print("| probes | messages | hits each | CPU us each | more than without, us | median us | p99.9 us |")
    print("|---|---|---|---|---|---|---|")
    for name, messages, seen, cpu_us, more_us, sure_us, median, high in rows:
        more = f"{more_us:.2f} ± {sure_us:.2f}" if name != "none" else "-"
        print(f"| {name} | {messages} | {seen:.1f} | {cpu_us:.1f} | {more} | {median:.1f} | {high:.0f} |")


def test_agreement(programs, tmp_path):
    """By how much the programs' own latency is longer than the observed one, message by message."""
    middleware, start = programs
    processes = start(AGREEMENT_S + 120)
    here = tmp_path / "here.yml"
    here.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/target\n")
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    call = ["observe", "--target", str(here), "--for", f"{AGREEMENT_S}s", "--results", str(tmp_path / "results")]
    assert main(call) == 0
    for what, before, who in zip(
        ("rtrun", "target"), spent, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN), strict=True
    ):
        now = resource.getrusage(who)
        cpu_s = now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime
        print(f"\nCPU time of {what}: {100 * cpu_s / AGREEMENT_S:.1f} % of a CPU")
    own = own_stamps(processes, tmp_path)
    topic = "stamped" if middleware == "rclpy" else "communication_tests"
    (folder,) = tmp_path.glob(f"results/*-messages-{topic}-*")
    observed = np.load(folder / f"{folder.name}.npy")
    # The last one whose own stamp is before the observed publication is the same message.
    place = np.searchsorted(own[:, 0], observed[:, 0], side="right") - 1
    longer = ((own[place, 1] - own[place, 0]) - (observed[:, 1] - observed[:, 0])) / 1000
    assert (own[place, 1] >= observed[:, 1]).all()
    assert len(longer) > AGREEMENT_S * FREQUENCY_HZ[middleware] / 2
    print(f"\n{middleware}, {len(longer)} messages: own latency less the observed one, us")
    names = ("least", "1 %", "median", "99 %", "99.9 %", "most")
    print(
        ", ".join(f"{n} {v:.1f}" for n, v in zip(names, np.percentile(longer, (0, 1, 50, 99, 99.9, 100)), strict=True))
    )
