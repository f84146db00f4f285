"""What `rtrun why` says of messages of unmodified programs: a culprit is planted, and must be named."""

import json
import subprocess
import sys
import time
from itertools import pairwise

import pytest

from rtrun.cli import main

pytestmark = [pytest.mark.ros, pytest.mark.trace]
# Has the CPU of the subscriber for 20 ms, above all of its threads, three times a second.
HOG = """
import os, time
os.sched_setaffinity(0, {1})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
open("/proc/self/comm", "w").write("planted_hog")
while True:
    time.sleep(0.3)
    end = time.monotonic() + 0.02
    while time.monotonic() < end:
        pass
"""


@pytest.fixture
def pair(suites, ros_master, tmp_path):
    """A publisher and a subscriber, the latter on CPU 1, where the culprit is; before all that runs here else."""
    environment = {"ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}", "ROS_IP": "127.0.0.1", "PATH": "/usr/bin:/bin"}
    folder = suites / "lib" / "communication_tests"
    options = ["-r", "60000", "-f", "200", "--out-dir", str(tmp_path)]
    remap = "/communication_tests:=/late"
    subscriber = [folder / "communication_tests_subscriber", *options, "--idle-timeout", "30", remap]
    publisher = [folder / "communication_tests_publisher", *options, "-d", "3", remap]
    started = [
        subprocess.Popen(["taskset", "-c", "1", "chrt", "-f", "10", *subscriber], env=environment),
        subprocess.Popen(["taskset", "-c", "0", "chrt", "-f", "10", *publisher], env=environment),
        subprocess.Popen([sys.executable, "-c", HOG]),
    ]
    time.sleep(4)
    yield started
    for process in started:
        process.kill()
        process.wait(30)


def test_the_process_that_a_late_message_waited_for_is_named(pair, tmp_path, capsys):
    here = tmp_path / "here.yml"
    here.write_text("schema: 1\nname: here\nkind: local\n")
    results = tmp_path / "results"
    call = ["observe", "--target", str(here), "--for", "10s", "--trace", "above=8ms", "--results", str(results)]
    assert main(call) == 0, capsys.readouterr()
    (folder,) = results.glob("*-messages-late-*")
    record = json.loads((folder / "run.json").read_text())
    assert (record["trace"], record["parameters"]["trace_threshold_us"]) == ("8000us", 8000)
    output = json.loads((folder / f"{folder.name}.json").read_text())
    traces = output["traces"]
    # On a busy machine the probes rest at times.
    assert 1 < len(traces["files"]) <= min(16, traces["above_limit"])
    # Those of the subscriber alone.
    threads = {thread["tid"] for thread in output["in_effect"]["threads"]}
    assert pair[0].pid in threads and pair[1].pid not in threads
    capsys.readouterr()
    assert main(["why", str(folder), "--json"]) == 0
    outliers = json.loads(capsys.readouterr().out)["outliers"]
    # Of messages that waited behind one another there is one. The time has microseconds.
    spans = sorted((outlier["at_ns"] - outlier["value_ns"], outlier["at_ns"]) for outlier in outliers)
    assert all(end_ns < begin_ns + 1000 for (_, end_ns), (begin_ns, _) in pairwise(spans)), spans
    assert main(["why", str(folder)]) == 0
    first = capsys.readouterr().out.partition("\n")[0]
    assert "thread of higher priority planted_hog" in first, first
