"""The limit for traces, found in a warm-up: on run directories, and with a real campaign over sshd."""

import json

import numpy as np
import pytest
from faulty import measure, record, runs_of
from report.campaigns import cyclic_rows, latencies, write_run

from rtfiles.errors import UsageError
from rtrun.execution.trace_threshold import with_threshold_of_warm_up
from rtrun.plan.campaign import Campaign, plan
from rtrun.results.reading import find_source

ENTRY = {"suite": "cyclic_timer_tests", "frequency_hz": 1000, "repetitions": 20_000}


def planned(above="p99"):
    runs = plan(Campaign(schema=1, name="c", runs=[{**ENTRY, "trace": {"above": above}}]), "c.yml")
    return next(run for run in runs if run.trace not in ("", "off"))


def write_warm_up(root, name, values_ns, **closing):
    rows = cyclic_rows(values_ns, 1000)
    return write_run(root, name, "cyclic_timer_tests", [rows], {"frequency_hz": 1000}, asked=len(values_ns), **closing)


def test_the_threshold_is_the_quantile_of_the_warm_up(tmp_path):
    run, values_ns = planned(), latencies(1000, 3)
    write_warm_up(tmp_path, f"{run.name}.warm-up", values_ns)
    found = with_threshold_of_warm_up(run, tmp_path)
    assert found.parameters["trace_threshold_us"] == round(np.quantile(values_ns, 0.99) / 1000)
    assert {**found.parameters, "trace_threshold_us": None} == run.parameters


def test_a_limit_in_microseconds_needs_no_warm_up(tmp_path):
    run = planned("300us")
    assert with_threshold_of_warm_up(run, tmp_path) is run


def test_values_below_a_microsecond_give_the_lowest_threshold(tmp_path):
    run = planned()
    write_warm_up(tmp_path, f"{run.name}.warm-up", np.zeros(1000, dtype=np.int64))
    assert with_threshold_of_warm_up(run, tmp_path).parameters["trace_threshold_us"] == 1


def test_without_a_whole_warm_up_there_is_no_threshold(tmp_path):
    run = planned()
    with pytest.raises(UsageError, match="incomplete run"):
        with_threshold_of_warm_up(run, tmp_path)
    folder = write_warm_up(tmp_path, f"{run.name}.warm-up", latencies(1000, 3), status="failed", reason="it broke")
    with pytest.raises(UsageError, match=r"\.warm-up is failed: it broke"):
        with_threshold_of_warm_up(run, tmp_path)
    data = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(data | {"status": "ok"}))
    (samples,) = folder.glob("*.npy")
    samples.write_bytes(samples.read_bytes()[:-8])
    with pytest.raises(UsageError, match="altered since the run was closed"):
        with_threshold_of_warm_up(run, tmp_path)


@pytest.mark.sshd
@pytest.mark.ros
@pytest.mark.trace
def test_a_campaign_finds_it_and_writes_it_down(ready_target, tmp_path, wishes):
    runs = runs_of(1, repetitions=1000, frequency_hz=2000, trace={"above": "p90"})
    warm_up, run = runs
    statuses = measure(ready_target, runs, tmp_path / "results")
    assert statuses == ["ok", "ok"]
    # The stand-in's values are 500 us, 100 of them in the warm-up.
    assert wishes.calls() == ["100 2000 ok", "1000 2000 ok"]
    written = record(tmp_path / "results", run)
    assert written["trace"] == "p90" and written["parameters"]["trace_threshold_us"] == 500
    assert "500" in written["programs"][0]["argv"]
    assert record(tmp_path / "results", warm_up)["parameters"]["trace_threshold_us"] == 60_000_000
    assert [folder.name for folder in find_source(tmp_path / "results").folders] == [run.name]


@pytest.mark.sshd
@pytest.mark.ros
@pytest.mark.trace
def test_a_warm_up_that_fails_costs_its_run_alone(ready_target, tmp_path, wishes):
    wishes.will("fail")
    runs = runs_of(2, repetitions=1000, trace={"above": "p90"})
    statuses = measure(ready_target, runs, tmp_path / "results")
    assert statuses == ["failed", "incomplete", "ok", "ok"]
    # The same command measures both again.
    statuses = measure(ready_target, runs, tmp_path / "results")
    assert statuses == ["ok"] * 4
