"""Ten unmodified nodes on rclpy and rcl, observed for ten minutes: the stall that is planted in one is named."""

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from probes.planted import check_named
from probes.test_real_programs import NODE, program, ros2_environment

from ros2 import wheels
from rtgen import suites as builder
from rtrun.cli import main

pytestmark = [pytest.mark.ros, pytest.mark.trace, pytest.mark.slow, pytest.mark.timeout(1500)]
SECONDS = int(os.environ.get("RT_TESTS_OBSERVE_S", "600"))
# Eight nodes one after another; the sixth stalls for 60 ms, once in five seconds, while three messages come to it.
NAMES = ("camera", "rectify", "detect", "track", "fuse", "planner", "smooth", "drive")
STALL = (0.06, 5.0)


@pytest.fixture
def system(tmp_path, tmp_path_factory):
    """The processes, that all take messages: the chain, and a pair on rcl at 1 kHz."""
    environment = ros2_environment("kilted", tmp_path)
    topics = ["-", *(f"/{name}" for name in NAMES)]
    calls = {
        name: [sys.executable, NODE, name, topics[k], topics[k + 1], *(STALL if name == "planner" else ())]
        for k, name in enumerate(NAMES)
    }
    suites = builder.build("host", tmp_path_factory.mktemp("suites"), ros2=wheels.installed("kilted"))
    options = ["-r", 1000 * (SECONDS + 600), "-f", 1000, "--out-dir", tmp_path]
    pair = [program(suites, f"communication_tests_{role}", "rcl") for role in ("subscriber", "publisher")]
    calls |= {
        "subscriber": [pair[0], *options, "--idle-timeout", 600],
        "publisher": [pair[1], *options, "--subscribers", 1],
    }
    started = []
    for name, call in calls.items():
        with (tmp_path / f"{name}.stdout").open("w") as printed:
            argv = [str(word) for word in call]
            started.append(subprocess.Popen(argv, env=environment, cwd=tmp_path, stdout=printed))
    try:
        # What comes to the last one has passed all others; a busy machine has two minutes.
        deadline = time.monotonic() + 120
        while "takes" not in (tmp_path / "drive.stdout").read_text():
            assert time.monotonic() < deadline, "nothing came to the end of the chain"
            time.sleep(0.2)
        assert [process.poll() for process in started] == [None] * 10
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait(30)


def test_every_message_is_accounted_for_and_the_stall_is_named(system, tmp_path, capsys):
    here = tmp_path / "here.yml"
    here.write_text("schema: 1\nname: here\nkind: local\n")
    results = tmp_path / "results"
    words = ["--trace", "above=30ms", "--deadline", "/fuse=30ms", "--results", str(results)]
    assert main(["observe", "--target", str(here), "--for", f"{SECONDS}s", *words]) == 0, capsys.readouterr()
    runs = [(folder, json.loads((folder / "run.json").read_text())) for folder in results.glob("001-messages-*")]
    # Each pair of the chain, and the one on rcl; others may have nodes on this machine as well.
    ours = {process.pid for process in system}
    streams = {
        run["parameters"]["topic"]: folder for folder, run in runs if {p["pid"] for p in run["programs"]} <= ours
    }
    assert set(streams) == {f"/{name}" for name in NAMES[:-1]} | {"/communication_tests"}
    fuse, pair = streams["/fuse"], streams["/communication_tests"]
    counts = json.loads((pair / f"{pair.name}.json").read_text())["counts"]
    assert all(process.poll() is None for process in system)
    # On a busy machine the kernel drops events or the probes rest: that period is in neither count. What the
    # subscriber itself has missed by then was lost.
    system[-2].terminate()
    system[-2].wait(60)
    (own,) = (np.load(path)[:, 2] for path in tmp_path.glob("ct_gnuplot*.npy"))
    lost = own[-1] - own[0] + 1 - len(own)
    assert counts["asked"] - counts["measured"] <= lost + 0.001 * counts["asked"], (lost, counts)
    assert counts["asked"] > 100 * SECONDS
    capsys.readouterr()
    assert main(["why", str(fuse), "--json"]) == 0
    outliers = json.loads(capsys.readouterr().out)["outliers"]
    check_named(outliers, (tmp_path / "planner.stdout").read_text(), "timer 5000 ms of chain_node")
    assert main(["gate", str(fuse), "--deadline", "30ms"]) == 1
