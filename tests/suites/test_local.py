"""A campaign on this machine itself: the real suites and cyclictest, with report, gate and check-rt."""

import json
import os

import pytest

from ports import free_port
from rtrun.cli import main

pytestmark = pytest.mark.ros

CAMPAIGN = """
schema: 1
name: here
runs:
  - {suite: cyclic_timer_tests, repetitions: 200, frequency_hz: 100}
  - {suite: communication_tests, repetitions: 100, frequency_hz: 100, subscribers: 2}
  - {suite: cyclictest, repetitions: 1000, cpu_dma_latency_us: null}
"""


def test_a_campaign_on_this_machine(suites, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "campaign.yml").write_text(CAMPAIGN)
    (tmp_path / "target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {suites}\nros_master_port: {free_port()}\n"
    )
    assert main(["run", "campaign.yml", "--target", "target.yml"]) == 0, capsys.readouterr()
    records = [json.loads(path.read_text()) for path in (tmp_path / "results/here").glob("*/run.json")]
    assert [record["status"] for record in records] == ["ok"] * 3
    publisher_json = [name for record in records for name in record["files"] if name.endswith("-publisher.json")]
    assert publisher_json == ["ct_gnuplot_l100_fq100_pl0-publisher.json"]
    rates = {program["name"]: program["rate"] for record in records for program in record["programs"]}
    # Each periodic program tells its rate; cyclictest has no json.
    assert {name for name, rate in rates.items() if rate and rate["asked_hz"] == 100} == set(rates) - {"cyclictest"}
    assert {record["target"]["kernel_release"] for record in records} == {os.uname().release}
    assert not list((tmp_path / "state/rt-tests/runs").glob("*/*"))
    assert main(["report", "results/here", "--output", "report.html"]) == 0
    page = (tmp_path / "report.html").read_text()
    assert "cyclictest" in page and "communication_tests" in page
    assert main(["verify", "results/here"]) == 0
    # So few measurements prove no such probability, whatever they are. The histogram proves the other: it keeps no
    # order, so nothing in it can change with time.
    assert main(["gate", "results/here", "--deadline", "1s", "--probability", "1e-9"]) == 1
    (histogram,) = (tmp_path / "results/here").glob("*-cyclictest_*")
    question = ["--deadline", "1s", "--probability", "0.5", "--assume-independent"]
    assert main(["gate", str(histogram), *question, "--platform", "virtual"]) == 0, capsys.readouterr()
    # On a virtual machine, as it is found to be, it passes only when told to.
    (platform,) = {record["platform"] for record in records}
    assert main(["gate", str(histogram), *question]) == (0 if platform == "hardware" else 1)
    capsys.readouterr()
    assert main(["check-rt", "--target", "target.yml"]) in (0, 1)
    assert capsys.readouterr().out.startswith("here (this machine): ")
