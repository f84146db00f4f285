"""Every reader of what comes from a file or a target, each with whole inputs for the fuzz to damage."""

import contextlib
import gzip
import hashlib
import io
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import xmlrpc.client
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import cast

import numpy as np

import rteval_report
import watched
from logs import LOGS_2014, SUITES
from rtfiles import config
from rtgen.kconfig import data as kconfig
from rtgen.kconfig import fragment, verify
from rtgen.profile import load_profile
from rtrun import cli
from rtrun.execution import resumption, ros_graph, topology_runs
from rtrun.execution.late_values import LateValueRecord
from rtrun.execution.middleware import roscpp
from rtrun.flows.accumulator import FlowAccumulator
from rtrun.flows.live import LiveFigures
from rtrun.flows.streams import streams
from rtrun.flows.topology.late import late_path
from rtrun.flows.topology.streams import topology_streams
from rtrun.flows.topology.tables import read_tables
from rtrun.plan.campaign import Campaign, plan, read_campaign
from rtrun.plan.goal import Goal
from rtrun.plan.topology.planning import TopologyPlan
from rtrun.plan.topology.topology import Executor, Topology, TopologyNode, TopologyTopic, Waits
from rtrun.probes import placement
from rtrun.probes.programs import find_programs
from rtrun.probes.stream import Batch, WatchReader
from rtrun.probes.symbols import read_symbols
from rtrun.report import causes
from rtrun.results import goal_file, journal, partial_samples, reading, run_directory, series
from rtrun.results.gnuplot_lines import check_commands
from rtrun.results.importers.adopt import adopt
from rtrun.results.importers.detect import read
from rtrun.results.importers.histogram_file import ENDING, histogram_text, read_histogram
from rtrun.results.importers.samples_file import ENDING as SAMPLES_ENDING
from rtrun.results.importers.samples_file import ImportedSamples, read_imported_samples, write_samples
from rtrun.results.observed import ObservedOutput, Provenance, TracedValue, write_stream
from rtrun.results.output import HostRecord, Thread, Uname
from rtrun.results.record import (
    Clock,
    Observed,
    ProgramRecord,
    Requested,
    Rival,
    RunRecord,
    RunStatus,
    TargetFacts,
)
from rtrun.results.record import verify as verify_run
from rtrun.results.texts import TextStore
from rtrun.results.topology_record import write_topology
from rtrun.targets import processes
from rtrun.targets.address import Address
from rtrun.targets.config import read_target
from rtrun.targets.connection import parse_listing
from rtrun.targets.inspection import architecture, control_groups, platform_signs, rt_readiness
from rtrun.targets.inspection import facts as inspection
from rtrun.targets.inspection.platform import Platform
from rtrun.targets.labgrid.environment import read_environment
from rtrun.targets.labgrid.resources import read_resources, ssh_service
from rtrun.targets.link import Link
from rtrun.targets.qemu import emulator as qemu
from rtrun.targets.ssh import host_keys, ssh_config
from rtrun.validity import baselines
from rtrun.validity.observations import observations_of, summarize

TOP = Path(__file__).parents[2]

Files = dict[str, bytes]
"""The files of one input, by name."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Reader:
    """What reads the files of a folder, and whole inputs for it. `seal` makes damaged files belong together again.

    `cost` is its time for an input in about 10 ms: a costly reader gets fewer inputs.
    """

    read: Callable[[Path], object]
    seeds: Sequence[Files]
    seal: Callable[[Path], None] = lambda folder: None
    cost: int = 1


def of_file(read: Callable[[Path], object], name: str, *seeds: bytes, cost: int = 1) -> Reader:
    """A reader of one file of this name."""
    return Reader(read=lambda folder: read(folder / name), seeds=[{name: seed} for seed in seeds], cost=cost)


def of_answer(read: Callable[[Link], object], *seeds: str) -> Reader:
    """A reader of what a command prints on the target, whatever the command is."""

    def answer(folder: Path) -> object:
        text = (folder / "answer").read_text(errors="replace")
        target = SimpleNamespace(
            address=Address(host="board"),
            work_dir=PurePosixPath("/var/rt-tests"),
            setup=None,
            known_platform=None,
        )
        link = SimpleNamespace(
            note=lambda _: None,
            target=target,
            boot_id="1-1",
            check=lambda *_, **__: text,
            address=target.address,
            shell=SimpleNamespace(execute=lambda _argv, _stdin, take, _s: (take(text.encode()), (0, ""))[1]),
            do=lambda step: step(link),
        )
        return read(cast(Link, link))

    return Reader(read=answer, seeds=[{"answer": seed.encode()} for seed in seeds])


def expecting_value_error(read: Callable[[bytes], object]) -> Callable[[Path], None]:
    """A reader whose callers take a ValueError for an answer."""

    def read_file(path: Path) -> None:
        with contextlib.suppress(ValueError):
            read(path.read_bytes())

    return read_file


def read_ssh_config(path: Path) -> None:
    """What the damaged file says about a host."""
    ssh_config.FILE = path
    ssh_config.address_of("board")


def _contents(folder: Path, *patterns: str) -> list[bytes]:
    return [path.read_bytes() for pattern in patterns for path in sorted(folder.glob(pattern))]


# What other programs and the target print.

KEY = b"ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIPJs62duJcZ1UDeiYfJh47Sob6aBR0zYBWGFxamj6gCK"
KNOWN_HOSTS = b"board,*.x " + KEY + b" me\n@revoked * " + KEY + b"\n|1|AAAA|AAAA " + KEY + b"\n"
STATE = f"""== boot_id
1-1
== uptime
900.10 1700.20
== cpus_online
0-1
== governor
performance
ondemand
== frequency_khz
800000
1000000
== temperature_mc
40000
== sched_rt_runtime_us
950000
== load
0.10 0.20 0.30 1/80 1234
== threads
12 (a) b) S {"0 " * 36}95 1 0
41
== machine
armv7l
"""
SSH_CONFIG = (
    b"Host *\n Port=22\n User %u\n IdentityFile ~/%h%%\n UserKnownHostsFile a b\nInclude x*\n"
    b"Match host a,b !user c\n ProxyJump d@e:1,f\nMatch all\n IdentityAgent none\n"
)
GROUPS = (
    b"group 1 /x\ncpu.rt_runtime_us 100000\ncpu.rt_period_us 1000000\ncpu.cfs_quota_us 2000\ncpu.cfs_period_us 10000\n"
    b"group 2 /x y\ncpu.max 20000 100000\ncpu.stat nr_periods 5\ncpu.stat nr_throttled 3\ncpu.stat throttled_usec 7\n"
)
FACTS = b"== kernel_version\n#1 SMP PREEMPT_RT\n== swap\n/dev/a x\n== threads\n99 program a\n" + GROUPS
REPLY = b"<methodResponse><params><param><value><array><data><value><int>1</int></value></data></array></value></param>"
MASTER = xmlrpc.client.dumps(
    ((1, "state", [[["/a", ["/talker"]]], [["/a", ["/listener", "/logger"]]], [["/get", ["/talker"]]]]),),
    methodresponse=True,
).encode()
PLATFORM = """cpuinfo flag: hypervisor
dmi: QEMU / Standard PC (Q35 + ICH9, 2009) /  / SeaBIOS
device-tree compatible: linux,dummy-virt
clocksource: kvm-clock tsc
"""
INSPECTED = """setup /opt/ros/noetic/setup.sh
master /opt/ros/noetic/bin/rosmaster
program /opt/ros/noetic/lib/cyclic_timer_tests/cyclic_timer_tests
elf 7f 45 4c 46 01 01 01 00 00 00 00 00 00 00 00 00 02 00 28 00
cpus 2
free_kib 100000
foreign /var/rt-tests/x
"""
OBSERVED = """at 10.00 0.50 40000,41000 800000 cpu 1 2 3 4 5 6 7 8 0 0
thread cyclic_timer_tests 12 1 95 0-1 cyclic_timer_te
load stress-ng 2 0,1
rival 5 1 99 migration/0
rival 7 6 1000000/10000000 a b
rival 8 6 - sugov:0
governor performance,performance
sched_rt_runtime_us 950000
end 11.50
at 12.00 0.50 - - cpu 11 12 13 14 15 16 17 18 0 0
"""
TIMERLAT = b"""# RTLA timerlat histogram
# Time unit is microseconds (us)
# Duration:   0 00:00:02
Index   IRQ-001   Thr-001   Usr-001
0             3         1         0
10            0         2         3
over:         0         1         0
count:        3         4         3
min:          0         3        12
avg:          1        60        13
max:          7       210        15
ALL:        IRQ       Thr       Usr
count:        3         4         3
min:          0         3        12
avg:          1        60        13
max:          7       210        15
"""
CYCLICTEST = b"""# /dev/cpu_dma_latency set to 0us
# Histogram
000014 000001\t000000
000015 000008\t000010
# Min Latencies: 00014 00015
# Avg Latencies: 01019 00015
# Max Latencies: 10062 00015
# Histogram Overflows: 00001 00000
# Histogram Overflow at cycle number:
# Thread 0: 00003
# Thread 1:
"""
_THREAD = {"histogram": {"3": 5, "12": 4}, "min": 3, "max": 1070, "avg": 113.3}
CYCLICTEST_JSON = json.dumps(
    {
        "cmdline:": "cyclictest -t1 -mqh64 -i 200 --policy=rr -p 80 -c 1",
        "start_time": "Thu, 26 Nov 2026 11:18:02 +0000",
        "end_time": "Thu, 26 Nov 2026 11:18:04 +0000",
        "return_code": 0,
        "sysinfo": {"nodename": "vm", "release": "6.18.44", "version": "#1 SMP PREEMPT_RT @0", "realtime": 0},
        "num_threads": 1,
        "resolution_in_ns": 0,
        "thread": {"0": {**_THREAD, "cycles": 10, "cpu": -1}},
    }
).encode()
JITTERDEBUGGER = json.dumps(
    {"version": 3, "sysinfo": {"resolution_in_ns": 1000, "cpus_online": 2}, "cpu": {"0": {**_THREAD, "count": 10}}}
).encode()
CYCLICTEST_V = b"Thread 0 Interval: 1000\n" + b"".join(
    b"%8d:%8d:%8d\n" % (thread, counter, value) for counter, value in enumerate((5, 7, 64, 9)) for thread in (0, 1)
)
CYCLICTEST_VH = (
    CYCLICTEST_V
    + b"""
# Histogram
000005 000001\t000001
000007 000001\t000001
000009 000001\t000001
# Min Latencies: 00005 00005
# Avg Latencies: 00021 00021
# Max Latencies: 00064 00064
# Histogram Overflows: 00001 00001
# Histogram Overflow at cycle number:
# Thread 0: 00002
# Thread 1: 00002
"""
)
RTEVAL = [
    rteval_report.report(version=version, profile=profile, stopped_above_us=10).encode()
    for version, profile in (("3.11", False), ("2.14", True))
]
BOARD = json.dumps(
    {
        "schema": 2, "machine": "qemu-armv7", "kernel": "vmlinuz", "initrd": "initrd", "dtb": None,
        "qemu": {"binary": "x", "arguments": ["-M", "virt"], "disk_device": "y", "network_device": "z"},
        "cmdline": "quiet", "disk": "disk.img", "disk_format": "raw", "kernel_release": "6.1", "packages": {"a": "1"},
        "ssh": {"user": "root", "key": "key", "host_key": "ssh-ed25519 AAAA"},
    }
).encode()  # fmt: skip
KERNEL_CONFIG = b"""#
# Automatically generated file; DO NOT EDIT.
# Linux/arm 6.1.0 Kernel Configuration
#
CONFIG_HZ=1000
CONFIG_PREEMPT_RT=y
# CONFIG_CPU_IDLE is not set
CONFIG_LOCALVERSION="-rt"
"""


PROGRAM = f"""program 70
argument listener
argument __ns:=/a
locked 4 kB
stat 70 (a) b) S{" 1" * 48}
stat 71 (dds.ev) S{" 1" * 48}
cpus 70 0-1,3
cpus 71\t0
maps 7f00-7f01 08:01 5 /opt/ros/lib/libtracetools.so
maps 7f02-7f03 08:01 6 /opt/ros/lib/libroscpp.so (deleted)
end 70
"""
LOOKED = "6.1.0-rt\n70 7f00-7f01 1000 " + "ab" * 32 + " /opt/ros/lib/libtracetools.so\n"
GRAPH = json.dumps(
    {"nodes": [{"name": "/a", "publishes": ["/x", "/rosout"], "takes": ["/y"], "serves": ["/a/get_parameters"]}]}
)


def _master(reply: bytes) -> list[ros_graph.GraphNode]:
    """A ROS master whose nodes are all there, and which answers alike whatever it is asked."""
    answer = b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\n\r\n" + reply
    channel = SimpleNamespace(sendall=lambda _: None, makefile=lambda *_, **__: io.BytesIO(answer), close=lambda: None)
    connection = SimpleNamespace(
        address="board", open_port=lambda *_, **__: contextlib.nullcontext(channel), check_promptly=lambda *_, **__: ""
    )
    link = SimpleNamespace(do=lambda step: step(connection))
    with contextlib.suppress(ConnectionRefusedError, TypeError, ValueError):
        return list(ros_graph._ask_master(cast(Link, link), "http://board:11311", {1, 70}, time.monotonic() + 1))
    return []


def _joined(link: Link) -> object:
    answer = SimpleNamespace(status=0, stdout=link.check([]), stderr="")
    return ros_graph._join(cast(Link, SimpleNamespace(run=lambda *_, **__: answer)), PurePosixPath("/x"), 70)


def _placed(link: Link) -> object:
    found = watched.parse_programs(PROGRAM.replace(" (deleted)", ""), "board").found
    return placement._look(link, [(program, mapped) for program in found for mapped in program.mapped])


def _watch(path: Path) -> None:
    """What an observation does with what a target prints, in pieces as they may come."""
    data = path.read_bytes()
    reader = WatchReader(watched.PROBES, "board", {7: 70, 8: 80})
    late = LateValueRecord("10us", {})
    flows = FlowAccumulator(begin_ns=1, paths=[("/a", "/a")], on_turn=late.turn)
    figures = LiveFigures(flows, on_values=late.look)
    pieces = (piece for start in range(0, len(data), 5000) for piece in reader.feed(data[start : start + 5000]))
    for batch in itertools.chain((piece for piece in pieces if isinstance(piece, Batch)), (reader.rest() for _ in "1")):
        flows.observe(begun.program for begun in batch.programs)
        flows.offset("system", batch.until_ns, next((clock.offset_ns for clock in batch.clocks), 0))
        late.record(batch)
        flows.feed([*batch.hits, *batch.gaps])
        figures.snapshot(batch.until_ns)
        late.cut(batch.until_ns)
    flows.finish()
    late.cut(flows.newest_ns + 10**9)
    for stream in streams(flows):
        assert all(column.dtype == np.int64 for column in stream.columns.values())


def _library() -> bytes:
    """A small library in C."""
    with tempfile.TemporaryDirectory() as folder:
        source, path = Path(folder) / "x.c", Path(folder) / "x.so"
        source.write_text("int probed(int x) { return x * 3; }\n")
        subprocess.run(
            ["cc", "-shared", "-fPIC", "-nostdlib", "-Wl,-z,noseparate-code", "-o", path, source], check=True
        )
        return path.read_bytes()


def _check_facts(path: Path) -> None:
    rt_readiness.judge(CHECKS, rt_readiness.parse(path.read_text(errors="replace")))


def _observe(path: Path) -> None:
    observations = observations_of(path.parent)
    summarize(
        observations,
        [state for observation in observations for states in observation.threads.values() for state in states],
    )


def _baseline(folder: Path) -> None:
    run = plan(Campaign(schema=1, name="x", runs=[{"suite": "cyclictest", "repetitions": 10, "threads": 2}]), "x")[0]
    text = (folder / "cyclictest.stdout").read_text(errors="replace")
    if baselines.check_baseline_output(run, text) is None:
        baselines.keep_histograms(folder, run, "cyclictest")


def _histogram() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.txt"
        path.write_bytes(CYCLICTEST)
        return histogram_text(read(path)[0]).encode()


def _samples() -> Files:
    values_ns = np.array([5000, 0, 64_000], dtype=np.int64)
    imported = ImportedSamples(
        source="x", name="x", values_ns=values_ns, period_ns=1e6, left_out=("the unit",), parameters={}
    )
    with tempfile.TemporaryDirectory() as folder:
        write_samples(Path(folder), imported)
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


# Files of ours.


def _journal(path: Path) -> None:
    with contextlib.closing(journal.open_journal(path.parent, "campaign", "1:abc", "board")) as log:
        log.begin_session("2026-11-21T10:00:00+00:00")
        log.spent_s(datetime.now(UTC))
        log.note("2026-11-21T10:00:00+00:00", "run", "planned")


def _new_journal() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        with contextlib.closing(journal.open_journal(Path(folder), "campaign", "1:abc", "board")) as log:
            for number in range(20):
                log.note(f"2026-11-21T10:00:{number:02}+00:00", "run", "measuring", "a reason")
            log.database.execute("PRAGMA journal_mode=DELETE")
        return (Path(folder) / journal.NAME).read_bytes()


def _goal() -> bytes:
    goal = Goal(deadline="400us", probability=1e-6, confidence=0.95, at_most="8h", boots=2)
    with tempfile.TemporaryDirectory() as folder:
        goal_file.write_goal(Path(folder), goal)
        return (Path(folder) / goal_file.FILE).read_bytes()


ATTEMPT = json.dumps(
    {
        "schema": 1,
        "uid": "0123456789abcdef",
        "start_time": "2026-11-21T10:00:00+00:00",
        "service": "12",
        "own_service": True,
        "argv": {"cyclic_timer_tests": ["cyclic_timer_tests", "-l", "10"]},
    }
)
LEFTOVERS = f"started cyclic_timer_tests 1-1\nstarted sampler 1-1\nattempt\n{ATTEMPT}\n{STATE}"


def _surroundings(samples: Path) -> Files:
    """What the sampler saw while these were measured, and the target's states around them."""
    rows = np.load(samples)
    begin_s, end_s = float(rows[:, 0].min()) / 1e9, float(rows[:, 0].max()) / 1e9
    step_s = (end_s - begin_s) / 120
    sampled = "".join(
        f"at {begin_s + number * step_s:.6f} 0.50 {40000 + number % 7},41000 800000 cpu 1 2 3 {number} 5 6 7 8 0 0\n"
        f"counts interrupts={number % 5}\n"
        for number in range(120)
    )
    before, after = (
        inspection.parse_state(STATE.replace("900.10", f"{at_s:.2f}")).model_dump() for at_s in (begin_s - 1, end_s + 1)
    )
    target = json.dumps({"schema": 1, "before": before, "after": after, "own_service": True})
    return {"sampler.stdout": sampled.encode(), "target.json": target.encode()}


def _runs() -> list[Files]:
    """Closed run directories with the samples and logs of tests/data."""
    outputs = {
        "cyclic_timer_tests": "cyclic_timer_tests_l100_fq700-tnRTFIFO",
        "oneshot_timer_tests": "oneshot_timer_tests_l100_tm1000-tnRTRR",
        "communication_tests": "1ct_gnuplot_l100_fq1000_pl0-tnRTRR",
    }
    runs = []
    for suite, output in outputs.items():
        with tempfile.TemporaryDirectory() as folder:
            partial = Path(folder) / "partial"
            partial.mkdir()
            for path in SUITES.glob(f"{output}*"):
                (partial / path.name).write_bytes(path.read_bytes())
            for name, content in _surroundings(partial / f"{output}.npy").items():
                (partial / name).write_bytes(content)
            record = RunRecord(
                schema=2, run="run", campaign="campaign", attempt="0123456789abcdef", suite=suite,
                parameters={"policy": "RR", "priority": 95, "repetitions": 100}, platform=Platform.HARDWARE,
                platform_evidence="no sign of a virtual machine", status=RunStatus.OK,
                reason=None, start_time="2026-11-21T10:00:00+00:00", end_time="2026-11-21T10:00:01+00:00",
                outputs=[output], files={},
                programs=[
                    ProgramRecord(
                        name=suite, argv=[suite], exit_status=0,
                        control_groups=control_groups.parse_around(f"{GROUPS.decode()}== after\n{GROUPS.decode()}"),
                    )
                ],
                requested=Requested(policy="RR", priority=95, cpus=[0], loads={"stress": 2}, busy_percent=60),
                in_effect=Observed(
                    policy=["RR"], priority=[95], cpus=[0, 1], loads={"stress": 2}, load_cpus=[0], busy_percent=84.2,
                    sched_rt_runtime_us=[950000], temperature_mc=[40000, 41000], frequency_khz=[800000, 800000],
                    load_1min=[0.5, 0.75], rivals=[Rival(name="migration/0", policy="FIFO", priority=99)],
                    observations=2,
                ),
                target=TargetFacts(
                    name="board", cpus=2, boot_id="1-1", clock=Clock(source="tsc", event="lapic", step_ns=16)
                ),
            )  # fmt: skip
            run_directory.close(partial, Path(folder) / "run", record)
            runs.append({path.name: path.read_bytes() for path in sorted((Path(folder) / "run").iterdir())})
    return runs


def _observed_runs() -> list[Files]:
    """Closed run directories of programs that ran already, one with a trace of a late message."""
    n = 200
    at_ns = 10**12 + 10**6 * np.arange(n, dtype=np.int64)
    ends = {"begin_ns": at_ns, "end_ns": at_ns + 1000}
    message = {
        "publication_ns": at_ns,
        "reception_ns": at_ns + 900,
        "seq": np.arange(n),
        "callback_end_ns": at_ns + 950,
    }
    timer = {"timestamp_ns": at_ns, "expected_ns": at_ns - 5, "real_ns": at_ns, "segment": np.zeros(n, np.int64)}
    text = TextStore(None).add(["x-70 [000] ..... 1000.000000500: callback_end: took_ns=400 name=timer 1 ms of /b\n"])
    assert text
    late = TracedValue(index=3, value_ns=900, limit_ns=10, at_ns=int(at_ns[3]) + 900, tid=70, text=text)
    streams = [
        ObservedOutput(
            suite="observed_messages", parameters={"topic": "/a", "publisher": "/a", "subscriber": "/b"},
            columns=message, asked=n, measured=n, above_limit=1, limit_ns=1000, traced=[late],
        ),
        ObservedOutput(suite="observed_timers", parameters={"node": "/b", "period_ns": 10**6}, columns=timer,
                       asked=n - 1, measured=n - 1),
        ObservedOutput(suite="observed_callbacks", parameters={"node": "/b"}, columns=ends, asked=n, measured=n),
    ]  # fmt: skip
    uname = Uname(release="6.1", version="x", machine="x86_64")
    times = {"start_time": "2026-11-21T10:00:00+00:00", "end_time": "2026-11-21T10:00:01+00:00"}
    thread = Thread(tid=70, name="b", policy="OTHER", priority=0, cpus=[0])
    runs = []
    for stream in streams:
        with tempfile.TemporaryDirectory() as folder:
            partial = Path(folder) / "partial"
            partial.mkdir()
            write_stream(partial, "x", stream, Provenance(version="1", host="x", kernel=uname, **times), [thread])
            record = RunRecord(
                schema=2, run="run", campaign="001", suite=stream.suite, subject="attached",
                parameters=dict(stream.parameters), platform=Platform.HARDWARE, platform_evidence="none",
                status=RunStatus.OK, reason=None, deadline_ns=5_000_000, outputs=["x"], files={},
                programs=[ProgramRecord(name="b", argv=["b"], pid=70, threads=[thread], locked_bytes=0)],
                target=TargetFacts(name="board", cpus=2), **times,
            )  # fmt: skip
            run_directory.close(partial, Path(folder) / "run", record)
            runs.append({path.name: path.read_bytes() for path in sorted((Path(folder) / "run").iterdir())})
    return runs


def _seal(folder: Path) -> None:
    """Write the checksums of the files as they are into run.json, where that still is one."""
    path = folder / "run.json"
    with contextlib.suppress(ValueError, TypeError, RecursionError):
        record = json.loads(path.read_text())
        record["files"] = {
            file.name: {
                "size_bytes": file.stat().st_size,
                "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
            }
            for file in folder.iterdir()
            if file != path
        }
        path.write_text(json.dumps(record))


COMMANDS = (
    ["show", RUN := "{run}"], ["show", "--json", RUN], ["verify", RUN], ["why", RUN, "--perfetto", "{beside}"],
    ["verdict", RUN], ["verdict", "--json", RUN], ["gate", RUN], ["gate", RUN, "--junit", "{beside}"],
    ["compare", RUN, RUN], ["claims", RUN], ["claims", "--json", RUN],
    *(["report", RUN, "--output", "-", "--format", form]
      for form in ("html", "markdown", "json", "junit", "lava", "csv", "parquet")),
    ["archive", "add", RUN, "--to", ARCHIVE := "{beside}.archive", "--samples", "--commit", "c1"], ["history", ARCHIVE],
    ["trends", ARCHIVE], ["bisect", ARCHIVE, "--order", "{beside}.order"],
    ["site", ARCHIVE, "--output", "{beside}.site"],
)  # fmt: skip


def _commands(folder: Path) -> None:
    """The front door: whatever is in a run directory, no command ends with the status of a defect.

    Where the results can be shown, every other command is called, too.
    """
    beside, order = folder.with_name("beside"), folder.with_name("beside.order")
    order.write_text("c0\nc1\nc2\n")
    for argv in COMMANDS:
        words = [word.format(run=folder, beside=beside) for word in argv]
        if _status(words) != 0 and argv is COMMANDS[0]:
            break
    beside.unlink(missing_ok=True)
    order.unlink()
    for ending in ("archive", "site"):
        shutil.rmtree(f"{beside}.{ending}", ignore_errors=True)


def _status(argv: list[str]) -> int:
    stdout, stderr = (io.TextIOWrapper(io.BytesIO()) for _ in range(2))
    with contextlib.redirect_stdout(stdout), contextlib.redirect_stderr(stderr):
        status = cli.main(argv)
    stderr.seek(0)
    assert status in (0, 1, 2, 3), f"rtrun {argv}: {status}: {stderr.read()}"
    return status


def _why(folder: Path) -> None:
    causes.table(*causes.ranked(reading.find_source(folder))[:2])


def _traced_run() -> Files:
    """A run directory with the kernel trace of an outlier, and an outlier that shares it."""
    lines = next((TOP / "tests/data/traces").glob("*-trace-1558.txt")).read_bytes().splitlines(keepends=True)
    files = next(run for run in _runs() if b"cyclic_timer_tests" in run["run.json"])
    output = next(name for name in files if name.endswith(".npy")).removesuffix(".npy")
    files[f"{output}-trace-1558.txt"] = b"".join([lines[0], *lines[-320:]])
    files[f"{output}-trace-1559.txt"] = lines[0] + f"# in {output}-trace-1558.txt\n".encode()
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        _seal(Path(folder))
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


GRAPH_OF_NODES = Topology(
    name="graph",
    nodes=(
        TopologyNode(name="a", executor="a", waits=Waits.PERIOD, period_ns=10_000_000, outputs=("/t",)),
        TopologyNode(name="b", executor="b", waits=Waits.ANY, inputs=("/t",)),
    ),
    executors=(Executor(name="a", process="p"), Executor(name="b", process="p")),
    topics=(TopologyTopic(name="/t"),),
)


def _tables() -> Files:
    """What the process of two nodes leaves: the first one sends, the second one takes each message."""
    begin = np.arange(100, dtype=np.int64) * 10_000_000
    number, step = np.arange(100, dtype=np.int64), 100_000
    first = np.column_stack((begin, begin + step, begin + 2 * step, begin + 3 * step, np.full(100, step)))
    came = np.column_stack((number, begin + 2 * step, begin + 4 * step, number))
    second = np.column_stack((*(begin + (4 + place) * step for place in range(4)), np.full(100, step), number))
    host = json.loads(next(path.with_suffix(".json").read_text() for path in sorted(SUITES.glob("*.npy"))))
    host = {key: value for key, value in host.items() if key in HostRecord.model_fields or key == "schema"}
    asked = {"policy": "0", "priority": 0, "cpus": "", "left_ns": 2 * 10**9, "foreign": 0}
    host |= {"start_ns": 0, "measured_ns": 10**9, "executors": [{"name": name} | asked for name in ("a", "b")]}
    host["nodes"] = [{"name": name, "activations": 100, "skipped": 0} for name in ("a", "b")]
    files = {"process-p.json": json.dumps(host).encode()}
    for name, rows in (("a", first), ("b", second), ("b-0", came)):
        buffer = io.BytesIO()
        np.save(buffer, rows)
        files[f"{name}.npy"] = buffer.getvalue()
    return files


def _follow(folder: Path) -> None:
    tables = read_tables(folder, GRAPH_OF_NODES)
    plan = TopologyPlan(topology=GRAPH_OF_NODES, for_s=0.5, paths=GRAPH_OF_NODES.all_paths())
    list(topology_streams(tables, plan))
    write_topology(folder, topology_runs.figures(tables, plan))
    late_path(tables, plan.paths[0], 1)


def _adopt(folder: Path) -> None:
    shutil.rmtree(folder / "out", ignore_errors=True)
    adopt(next(folder.glob("x.*")), folder / "out", platform=Platform.HARDWARE)


def _outputs() -> list[Files]:
    """Samples with the json beside them."""
    return [
        {f"x{ending}": path.with_suffix(ending).read_bytes() for ending in (".json", ".npy")}
        for path in sorted(SUITES.glob("*.npy"))
    ]


def _kernel_config(path: Path) -> None:
    text = fragment.read_text(path)
    verify.verify_config(KCONFIG, "qemu-armv7", text, str(path))


def _part(path: Path) -> None:
    path.with_suffix("").unlink(missing_ok=True)
    partial_samples.salvage(path)


def _labgrid_service(path: Path) -> None:
    ssh_service(read_resources(path.read_text("utf-8", "replace"), "board"), "board")


LABGRID = b"""targets:
  main:
    resources:
      RemotePlace: {name: board}
    drivers:
      SSHDriver: {keyfile: keys/board}
      NetworkPowerDriver: {}
options: {coordinator_address: "lab:20408"}
"""
LABGRID_PRINTED = b"""Selected place board
targets:
  board:
    resources:
    - NetworkService: {address: 10.0.0.2, username: root, port: 22}
"""
KCONFIG = kconfig.load()
CHECKS = rt_readiness.read_checks()
LOGS = [path.read_bytes() for path in (*sorted(SUITES.glob("*.log")), *sorted(LOGS_2014.glob("*.log")))]
PROGRAMS = ["cyclic_timer_tests"]
READERS: dict[str, Reader] = {
    # Of the user, and of a network that may be another's.
    "ssh_config": of_file(read_ssh_config, "ssh_config", SSH_CONFIG),
    "known_hosts": of_file(
        lambda path: host_keys.read_host_keys(Address(host="board", known_hosts=(path,))), "known_hosts", KNOWN_HOSTS
    ),
    "certificate": of_file(
        expecting_value_error(host_keys.parse_certificate),
        "certificate",
        b"\0\0\0\x20ssh-ed25519-cert-v01@openssh.com" + b"\0\0\0\4abcd" * 20,
    ),
    "target": of_file(read_target, "target.yml", *_contents(TOP / "targets", "*.yml")),
    "campaign": of_file(read_campaign, "campaign.yml", *_contents(TOP / "campaigns", "*.yml"), cost=3),
    "profile": of_file(
        lambda path: load_profile(str(path)), "profile.yml", *_contents(TOP / "tools/rtgen/profiles", "*.yml"), cost=4
    ),
    "environment of labgrid": of_file(read_environment, "labgrid.yml", LABGRID),
    "resources of labgrid": of_file(_labgrid_service, "printed", LABGRID_PRINTED),
    "kernel options": of_file(
        lambda path: [option.holds_for("6.1") for option in config.load(path, kconfig.Concern).options],
        "options.yml",
        *_contents(TOP / "kconfig/options", "*.yml"),
        cost=2,
    ),
    "fragment": of_file(verify.load_fragment, "x.cfg", KERNEL_CONFIG),
    "kernel config": of_file(_kernel_config, "config", KERNEL_CONFIG, gzip.compress(KERNEL_CONFIG, mtime=0)),
    # Of the target.
    "state": of_answer(lambda link: inspection.read_state(link, PurePosixPath("/state.sh")), STATE),
    "equipment": of_answer(inspection.inspect, INSPECTED, INSPECTED.replace("foreign", "program")),
    "leftovers": of_answer(
        lambda link: resumption.inspect_leftovers(link, PurePosixPath("/runs/x"), PROGRAMS, []), LEFTOVERS
    ),
    "exit": of_answer(
        lambda link: processes.wait(link, PurePosixPath("/x"), "x", deadline_s=1), "0 12.00\n", "expired"
    ),
    "ended": of_answer(
        lambda link: processes.end_background(link, PurePosixPath("/x"), [], [], [], service="12", then=[]),
        f"12\nload 1\n== ended\n{STATE}",
    ),
    "programs": of_answer(lambda link: find_programs(link, PurePosixPath("/x")), PROGRAM),
    "libraries": of_answer(_placed, LOOKED),
    "library": of_file(lambda path: read_symbols(path, ["probed"]), "library", _library()),
    "watched": of_file(_watch, "watched", watched.watched(), cost=2),
    "graph": of_answer(_joined, GRAPH),
    "graph of a master": of_file(lambda path: _master(path.read_bytes()), "reply", MASTER),
    "listing": of_answer(
        lambda link: parse_listing(link.check([])),
        "2\n-rw-r--r-- 1 0 0 5 Nov 22 03:20 a b\ndrwxr-xr-x 2 0 0 4096 Nov 22 03:20 c\n",
    ),
    "platform": of_answer(platform_signs.find_platform, PLATFORM),
    "facts": of_file(_check_facts, "facts", FACTS),
    "master": of_file(expecting_value_error(roscpp._parse_reply), "reply", REPLY),
    "observations": of_file(_observe, "sampler.stdout", OBSERVED.encode()),
    "baseline": Reader(read=_baseline, seeds=[{"cyclictest.stdout": CYCLICTEST}]),
    "part": of_file(_part, "x.npy.part", *_contents(SUITES, "*.npy")),
    "tables": Reader(read=_follow, seeds=[_tables()], cost=2),
    "trace": Reader(read=_why, seeds=[_traced_run()], seal=_seal, cost=10),
    # Of results, which may come from a target or from another's hands.
    "run": Reader(
        read=lambda folder: (reading.read_run(folder), verify_run(folder)),
        seeds=[*_runs(), *_observed_runs()],
        seal=_seal,
        cost=2,
    ),
    "commands": Reader(read=_commands, seeds=[*_runs(), *_observed_runs()], seal=_seal, cost=20),
    "samples": Reader(read=lambda folder: series.results_of(series.read_file(folder / "x.npy")), seeds=_outputs()),
    "log": of_file(lambda path: series.results_of(series.read_file(path)), "x.log", *LOGS),
    "log commands": of_file(check_commands, "x.log", *LOGS),
    "import": Reader(
        read=_adopt,
        seeds=[
            *({"x.txt": text} for text in (CYCLICTEST, CYCLICTEST_V, CYCLICTEST_VH, TIMERLAT)),
            *({"x.xml": text} for text in RTEVAL),
            *({"x.json": text} for text in (CYCLICTEST_JSON, JITTERDEBUGGER)),
            *({"x.log": text} for text in LOGS),
        ],
    ),
    "histogram": of_file(read_histogram, f"x{ENDING}", _histogram()),
    "imported samples": Reader(
        read=lambda folder: series.series_of_imported_samples(read_imported_samples(folder / f"x{SAMPLES_ENDING}")),
        seeds=[_samples()],
    ),
    "journal": of_file(_journal, journal.NAME, _new_journal()),
    "goal": Reader(read=goal_file.read_goal, seeds=[{goal_file.FILE: _goal()}]),
    # Of a build.
    "board": Reader(read=qemu.read_board, seeds=[{"board.json": BOARD}]),
    "program": of_file(lambda path: architecture.name(path.read_bytes()), "program", b"\x7fELF\2\1\1" + bytes(13)),
}
