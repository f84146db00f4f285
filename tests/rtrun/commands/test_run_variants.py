"""A and B in one campaign, end to end: the real command, the real sshd, a stand-in for the suite."""

import json
from pathlib import Path

import pytest
from faulty import target_file, write_faulty_suites

from rtrun.cli import main

pytestmark = [pytest.mark.sshd, pytest.mark.ros]

CAMPAIGN = """
schema: 1
name: ab
order: interleaved
seed: 7
common: {repetitions: 102, repeats: 2}
runs: [{suite: cyclic_timer_tests, frequency_hz: 1000}]
variants:
  old: {suites: old}
  new: {suites: new, ros_setup: setup.sh}
"""


@pytest.fixture
def builds(tmp_path, loopback, ros_master, monkeypatch):
    """Two builds of the suites beside a campaign and a target; what the stand-in of each is to do."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "setup.sh").write_text("export ROS_OF=new\n")
    (tmp_path / "target.yml").write_text(json.dumps(target_file(loopback, ros_master)))
    (tmp_path / "campaign.yml").write_text(CAMPAIGN.replace("setup.sh", str(tmp_path / "setup.sh")))
    return {name: write_faulty_suites(tmp_path / name) for name in ("old", "new")}


def test_each_variant_runs_its_own_build_in_turn_and_the_two_are_compared(builds, capsys):
    assert main(["run", "campaign.yml", "--target", "target.yml"]) == 0
    assert [len(build.calls()) for build in builds.values()] == [2, 2], "each build was run, and no other"
    records = [json.loads(path.read_text()) for path in sorted(Path("results/ab").glob("*/run.json"))]
    assert sorted(record["variant"] for record in records) == ["new", "new", "old", "old"]
    in_order = [record["variant"] for record in sorted(records, key=lambda record: record["start_time"])]
    assert set(in_order[:2]) == set(in_order[2:]) == {"new", "old"}, "each repeat holds both"
    assert Path("results/latest").readlink() == Path("ab")
    capsys.readouterr()
    assert main(["compare"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert set(out[0].replace(",", "").split()[1::2]) == {"old", "new"}, out[0]
    # A banner may come before it, where this machine is virtual.
    assert any("cyclic_timer" in line for line in out[1:3]) and not any("only in" in line for line in out)


def test_a_variant_for_another_release_of_debian_is_refused_before_anything_runs(builds, capsys):
    Path("new/build.json").write_text('{"debian": "hamm"}')
    assert main(["run", "campaign.yml", "--target", "target.yml"]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "suites for Debian" in line]
    assert line.startswith("rtrun: new: suites for Debian hamm, but ")
    assert [build.calls() for build in builds.values()] == [[], []]
