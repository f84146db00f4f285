"""`rtrun observe` on unmodified programs: those of the suites tell themselves what they measured."""

import json
import subprocess

import numpy as np
import pytest

from rtrun.cli import main

pytestmark = [pytest.mark.ros, pytest.mark.trace]


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
