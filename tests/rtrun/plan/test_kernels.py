"""Campaigns that measure on several kernels: which runs there are, in what order, and what `rtrun plan` shows of it."""

import json

import pytest

from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.plan.campaign import Campaign, plan
from rtrun.plan.run import blocks

ENTRY = {"suite": "cyclic_timer_tests", "frequency_hz": [100, 200]}


def runs_of(**keys):
    return plan(Campaign.model_validate({"schema": 1, "name": "k", "runs": [ENTRY]} | keys), "k.yml")


def refusal(**keys):
    with pytest.raises(UsageError) as refused:
        runs_of(**keys)
    return str(refused.value)


def test_every_run_is_planned_for_each_kernel():
    runs = runs_of(kernels=["standard", "rt"])
    assert [(run.kernel, run.parameters["frequency_hz"]) for run in runs] == [
        *[("standard", 100), ("standard", 200)],
        *[("rt", 100), ("rt", 200)],
    ]
    assert len({run.name for run in runs}) == 4
    assert all(run.name.endswith(f"-{run.kernel}") for run in runs)


def test_the_kernels_take_turns_in_going_first_and_each_block_is_a_boot():
    runs = runs_of(kernels=["standard", "rt"], common={"repeats": 4})
    divided = [{(run.repeat, run.kernel) for run in block} for block in blocks(runs)]
    assert divided == [
        *[{(1, "standard")}, {(1, "rt")}, {(2, "rt")}, {(2, "standard")}],
        *[{(3, "standard")}, {(3, "rt")}, {(4, "rt")}, {(4, "standard")}],
    ]


def test_within_a_block_the_order_is_the_drawn_one():
    keys = {"order": "interleaved", "seed": 5, "common": {"repeats": 3}}
    (drawn,) = blocks(runs_of(**keys))
    runs = runs_of(kernels=["rt", "standard"], **keys)
    assert [(block[0].repeat, block[0].kernel) for block in blocks(runs)] == [
        *[(1, "rt"), (1, "standard"), (2, "standard"), (2, "rt"), (3, "rt"), (3, "standard")],
    ]
    assert runs != runs_of(kernels=["rt", "standard"], common={"repeats": 3}) and len(drawn) == 6


def test_one_kernel_is_one_block_in_the_order_of_the_file():
    (block,) = blocks(runs_of(kernels=["rt"], common={"repeats": 2}))
    assert [(run.kernel, run.parameters["frequency_hz"], run.repeat) for run in block] == [
        *[("rt", 100, 1), ("rt", 100, 2), ("rt", 200, 1), ("rt", 200, 2)],
    ]


def test_runs_of_one_kernel_are_left_out():
    runs = runs_of(kernels=["standard", "rt"], exclude=[{"kernel": "standard", "frequency_hz": 200}])
    assert [(run.kernel, run.parameters["frequency_hz"]) for run in runs] == [
        *[("standard", 100), ("rt", 100), ("rt", 200)],
    ]


def test_what_makes_no_sense_is_refused():
    assert "k.yml: kernels: names a kernel twice" in refusal(kernels=["rt", "rt"])
    goal = {"deadline": "1ms", "probability": 0.1, "at_most": "1h"}
    words = {"order": "interleaved", "seed": 1, "until": goal}
    assert "until: takes one kernel" in refusal(kernels=["standard", "rt"], **words)
    assert runs_of(kernels=["rt"], **words)
    with pytest.raises(ValueError, match="kernels"):
        runs_of(kernels=["realtime"])


def test_plan_lists_the_restarts(tmp_path, capsys):
    path = tmp_path / "k.yml"
    path.write_text(json.dumps({"schema": 1, "name": "k", "kernels": ["standard", "rt"], "runs": [ENTRY]}))
    assert main(["plan", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "-- kernel standard" and lines[3] == "-- restart into kernel rt"
    assert lines[-1].startswith("4 runs, ") and lines[-1].endswith(", about 1 min 00 s for 1 restart into a kernel")
    assert main(["plan", str(path), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    parts = ("measuring_s", "settling_s", "start_and_end_s", "restarting_s")
    assert data["total_s"] == pytest.approx(sum(data[part] for part in parts)) and data["restarting_s"] == 60
    assert data["restarts"] == 1 and [run["kernel"] for run in data["runs"]] == ["standard"] * 2 + ["rt"] * 2
