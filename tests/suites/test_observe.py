"""`rtrun observe` on unmodified programs: those of the suites tell themselves what they measured."""

import json
import os
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest
from probes.standin import build, running

from rtrun.cli import main
from rtrun.probes.session import LIMIT_PER_S

pytestmark = [pytest.mark.ros, pytest.mark.trace]


# Starts a program again and again, some time after its end; neither outlives whom it was started by.
AGAIN = """
import ctypes, subprocess, sys, time
die = lambda: ctypes.CDLL(None).prctl(1, 9)
die()
for k in range(1000):
    argv = [sys.argv[1], "300", "300", str((4 + k) * 10**15), "1000", "/again"]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, preexec_fn=die) as process:
        process.stdout.readline()
        process.kill()
    time.sleep(2)
"""


@pytest.fixture(scope="session")
def standin(tmp_path_factory):
    return build(tmp_path_factory.mktemp("standin"))


@pytest.fixture
def here(tmp_path):
    path = tmp_path / "here.yml"
    path.write_text(f"schema: 1\nname: here\nkind: local\nwork_dir: {tmp_path}/new\n")
    return path


@pytest.fixture
def pair(suites, ros_master, tmp_path):
    """A publisher and a subscriber at 500 Hz for some seconds, whose stamps are of the clock of the trace."""
    environment = {"ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}", "ROS_IP": "127.0.0.1", "PATH": "/usr/bin:/bin"}
    folder = suites / "lib" / "communication_tests"
    options = ["-r", "4000", "-f", "500", "--clock", "monotonic", "--out-dir", str(tmp_path)]
    remap = "/communication_tests:=/observed_pair"
    started = [
        subprocess.Popen(
            [folder / "communication_tests_subscriber", *options, "--idle-timeout", "30", remap], env=environment
        ),
        subprocess.Popen([folder / "communication_tests_publisher", *options, "-d", "8", remap], env=environment),
    ]
    yield started
    for process in started:
        process.kill()
        process.wait(30)


def test_what_is_observed_lies_between_the_stamps_of_the_programs_themselves(pair, here, tmp_path, capsys):
    """Of each message: its own stamp, published, taken, its own stamp, in this order; none is lost, none made up."""
    results = tmp_path / "results"
    status = main(
        [
            "observe",
            "--target",
            str(here),
            "--for",
            "18s",
            "--deadline",
            "/observed_pair=10s",
            "--deadline",
            "interval:/nobody=1s",
            "--results",
            str(results),
        ]
    )
    assert status == 0, capsys.readouterr()
    assert [process.wait(60) for process in pair] == [0, 0]
    (nobody,) = results.glob("*-intervals-nobody")
    reason = json.loads((nobody / "run.json").read_text())["reason"]
    assert reason.startswith("interval /nobody: it was not seen; seen were /")
    (folder,) = results.glob("*-messages-observed_pair-*")
    observed = np.load(folder / f"{folder.name}.npy")
    counts = json.loads((folder / f"{folder.name}.json").read_text())["counts"]
    assert counts["measured"] == counts["asked"] == len(observed) > 100 and counts["missing"] == 0
    # The first ones may have been sent before all probes were there; none after them is left out.
    own = np.load(next(tmp_path.glob("ct_gnuplot*.npy")))[-len(observed) :]
    assert np.array_equal(observed[:, 2], np.arange(len(observed)))
    assert (own[:, 0] <= observed[:, 0]).all() and (observed[:, 0] <= observed[:, 1]).all()
    assert (observed[:, 1] <= own[:, 1]).all()


def _seen(here, results, for_s, capsys) -> tuple[dict[str, int], float, str]:
    """Of an observation: how many pairs of stand-ins each topic has, their events a second, what was printed."""
    assert main(["observe", "--target", str(here), "--for", f"{for_s}s", "--results", str(results)]) == 0
    topics, rate = Counter(), 0.0
    for folder in results.glob("*-messages-*"):
        record = json.loads((folder / f"{folder.name}.json").read_text())
        if not record["requested"]["publisher"].startswith(("standin", "restarted")):
            continue  # of others on this machine
        topics[record["requested"]["topic"]] += 1
        rows, counts = np.load(folder / f"{folder.name}.npy"), record["counts"]
        # A timer calls, too. A busy machine is observed for longer than was asked for.
        rate += 3 * len(rows) / (int(rows[-1, 1] - rows[0, 0]) / 1e9)
        # Each is taken by the program itself, directly after it was published.
        assert counts["missing"] == 0 and counts["asked"] == counts["measured"] == len(rows) > 10
        assert np.array_equal(rows[:, 2], np.arange(len(rows)))
        assert (rows[:, 1] > rows[:, 0]).all()
    return topics, rate, capsys.readouterr().out


def test_names_of_any_bytes_a_fork_and_a_restart(here, standin, tmp_path, capsys):
    """The child is a program of its own; one that begins anew goes on in the stream of the one before."""
    restarted = standin.with_name("restarted")
    os.link(standin, restarted)
    name = b"/\xff\x1b[31m\\\n. ../\xe2\x82"
    with (
        running(standin, 500, 10**6, 10**15, 1000, "/forks", 2000),
        running(standin, 200, 10**6, 3 * 10**15, 1000, os.fsdecode(name)),
        subprocess.Popen([sys.executable, "-c", AGAIN, restarted]) as again,
    ):
        topics, _, printed = _seen(here, tmp_path / "results", 8, capsys)
        again.kill()
    assert "\x1b" not in printed
    assert topics == {"/forks": 2, "/again": 1, "/\ufffd?[31m\\?. ../\ufffd": 1}


def test_of_20_000_messages_a_second_what_was_seen_adds_up(here, standin, tmp_path, capsys):
    """However many events there are: then the probes pause, and the report says so."""
    with running(standin, 20_000, 10**6, 2 * 10**15, 1000, "/many"):
        topics, rate, printed = _seen(here, tmp_path / "results", 5, capsys)
    assert topics == {"/many": 1}
    # Where the machine is too busy for so many messages, there are fewer events.
    reasons = ("of the probes: more events than the limit", "lost by the kernel")
    assert any(reason in printed for reason in reasons) or rate < LIMIT_PER_S
