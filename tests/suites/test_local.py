"""A campaign on this machine itself: the real suites and cyclictest, with report, gate and check-rt."""

import json
import os
import shutil

import pytest

from ports import free_port
from rtrun.cli import main
from rtrun.judgement.gate import ALLOCATIONS, gate
from rtrun.judgement.study import study

pytestmark = [pytest.mark.ros, pytest.mark.root]

ALLOCATED_BY_LOOP = "allocations_of_measuring_thread"
# Beside other work, programs of the normal policy miss their rate: such a run is invalid. Cyclictest has no rate; at
# a real-time policy somebody would have to see it, for which it is too short.
CAMPAIGN = """
schema: 1
name: here
runs:
  - {suite: cyclic_timer_tests, repetitions: 200, frequency_hz: 100, policy: FIFO}
  - {suite: communication_tests, repetitions: 100, frequency_hz: 100, subscribers: 2, policy: FIFO}
  - {suite: cyclictest, repetitions: 1000, cpu_dma_latency_us: null}
"""


def test_a_campaign_on_this_machine(suites, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "campaign.yml").write_text(CAMPAIGN)
    (tmp_path / "target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {suites}\nros_master_port: {free_port()}\n"
    )
    asked = ["run", "campaign.yml", "--target", "target.yml"]
    assert main([*asked, "-k", "cyclictest", "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    (chosen,) = first["runs"]
    assert "cyclictest" in chosen and first["runs"][chosen] == "ok" and first["results"] == "results/here"
    # The campaign goes on with the others, in the same folder.
    assert main([*asked, "--collect-only", "--json"]) == 0
    collected = json.loads(capsys.readouterr().out)["runs"]
    assert [run["run"] for run in collected if run["is_finished"]] == [chosen] and len(collected) == 3
    assert main(asked) == 0
    assert "1 of 3 runs are finished" in capsys.readouterr().err
    records = [json.loads(path.read_text()) for path in (tmp_path / "results/here").glob("*/run.json")]
    assert [record["status"] for record in records] == ["ok"] * 3
    publisher_json = [name for record in records for name in record["files"] if name.endswith("-publisher.json")]
    assert publisher_json == ["ct_gnuplot_l100_fq100_pl0-tnRTFIFO-publisher.json"]
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


ALLOCATING = """
schema: 1
name: allocating
common: {repetitions: 100, frequency_hz: 50, policy: FIFO}
runs:
  - {suite: communication_tests, middleware: [roscpp, futex], subscribers: 2, allocations: [null, counted]}
  - {suite: cyclic_timer_tests, allocations: counted}
"""


def test_allocations_are_counted_apart_from_times(suites, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "campaign.yml").write_text(ALLOCATING)
    (tmp_path / "target.yml").write_text(
        f"schema: 1\nname: here\nkind: local\nsuites: {suites}\nros_master_port: {free_port()}\n"
    )
    assert main(["run", "campaign.yml", "--target", "target.yml"]) == 0, capsys.readouterr()
    results = tmp_path / "results/allocating"
    costs_by_program = {True: {}, False: {}}
    for path in results.glob("*/run.json"):
        record = json.loads(path.read_text())
        is_counted = record["parameters"].get("allocations") == "counted"
        for program in record["programs"]:
            costs = program["costs"]
            assert is_counted == (costs.get("allocations") is not None) == ("frees" in costs)
            name = (record["parameters"].get("middleware", "roscpp"), program["name"])
            costs_by_program[is_counted][name] = [costs.get(key) for key in ("allocations", "frees", ALLOCATED_BY_LOOP)]
    assert len(costs_by_program[True]) == 7 and len(costs_by_program[False]) == 6
    for (middleware, name), (allocations, frees, by_loop) in costs_by_program[True].items():
        if middleware == "futex":
            assert (allocations, frees, by_loop) == (0, 0, 0), name
        else:  # each message, and each call of a timer, has some; not all are the loop's own
            assert allocations > 90 and frees > 90 and 0 <= by_loop <= allocations, name
    capsys.readouterr()
    # Their times are in no answer.
    assert main(["verdict", str(results), "--deadline", "1s", "--probability", "0.5"]) in (0, 1)
    printed = capsys.readouterr().out
    assert "cyclic_timer" not in printed and "allocations" not in printed and printed.count("middleware=futex") >= 1, (
        printed
    )
    assert main(["report", str(results), "--output", "report.html"]) == 0
    assert "4 of 7 programs allocated memory while measuring" in (tmp_path / "report.html").read_text()
    for most, failing in ((0, 4), (10**6, 0)):
        cases = [case for case in gate(study(results), max_allocations=most).cases if case.answer == ALLOCATIONS]
        assert len(cases) == 7 and sum(not case.passed for case in cases) == failing, cases
    # Alone they prove nothing of time.
    for path in results.glob("*/run.json"):
        if json.loads(path.read_text())["parameters"]["allocations"] is None:
            shutil.rmtree(path.parent)
    (case,) = (case for case in gate(study(results), max_allocations=10**6).cases if not case.passed)
    assert case.text == "no run was measured but those that count allocations, whose times are not judged"
