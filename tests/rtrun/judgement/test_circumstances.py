"""Runs under another condition are not runs of the same thing, and an invalid run is no result."""

import json

from written import write_oneshot, write_record

from rtrun.cli import main
from rtrun.results.reading import read_run

OUTPUT = "oneshot_timer_tests_l4_tm1000-tnRTRR"


def run_with(folder, **changed):
    folder.mkdir(parents=True)
    write_oneshot(folder, armed_after_ns=int(folder.name))  # two runs never measure the same
    write_record(folder, "oneshot_timer_tests", [OUTPUT], {"policy": "RR", "timeout_us": 1000}, **changed)
    return folder


def test_the_condition_stands_beside_the_parameters(tmp_path, capsys):
    run_with(tmp_path / "runs" / "001")
    settings = {"load_cpu": "1", "governor": "", "irq_cpu": ""}
    run_with(tmp_path / "runs" / "002", condition="cpu80", settings=settings)
    idle, loaded = (read_run(tmp_path / "runs" / name).results[0].header.parameters for name in ("001", "002"))
    alike = {"policy": "RR", "timeout_us": 1000, "middleware": "roscpp"}
    assert idle == alike
    assert loaded == alike | {"condition": "cpu80", "load_cpu": "1"}
    assert main(["show", str(tmp_path / "runs")]) == 0
    assert "condition=cpu80" in capsys.readouterr().out.replace("\n", "")


def test_the_report_keeps_them_apart(tmp_path, capsys):
    for name, condition in (("001", "idle"), ("002", "cpu80"), ("003", "cpu80")):
        run_with(tmp_path / "runs" / name, condition=condition)
    assert main(["report", str(tmp_path / "runs"), "--format", "json", "--output", "-"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    assert [(group["parameters"].get("condition"), group["runs"]) for group in groups] == [
        (None, ["001"]),
        ("cpu80", ["002", "003"]),
    ]


def test_an_invalid_run_has_no_results_and_says_why(tmp_path, capsys):
    reason = "condition cpu80: stress ended in the middle of the run"
    folder = run_with(tmp_path / "runs" / "001", status="invalid", reason=reason)
    assert read_run(folder).results == ()
    main(["show", str(tmp_path / "runs")])
    assert f"001: invalid: {reason}" in capsys.readouterr().out


def test_a_kernel_without_preempt_rt_is_named_in_the_first_line(tmp_path, capsys):
    run_with(tmp_path / "runs" / "001", target={"name": "board", "preempt_rt": False})
    main(["show", str(tmp_path / "runs")])
    assert capsys.readouterr().out.splitlines()[0] == "NO PREEMPT_RT: this kernel promises no deadline"
    main(["report", str(tmp_path / "runs"), "--format", "markdown", "--output", "-"])
    assert "NO PREEMPT_RT: this kernel promises no deadline" in capsys.readouterr().out.splitlines()[0]
