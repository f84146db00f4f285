"""The gate, compare and claims commands: answers and exit statuses."""

import json
import re
import shutil
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from report.campaigns import cyclic_run, latencies, oneshot_run
from written import write_record

from rtrun.cli import main
from rtrun.plan.quantities import read_time_ns
from rtrun.results.observed import ObservedOutput, Provenance, write_stream
from rtrun.results.output import Uname


def write_oneshot(root, name="a", n=5000, mean_us=90.0, seed=1, **more):
    return oneshot_run(root, name, latencies(n, seed, mean_us), **more)


def test_a_proof_passes(tmp_path, capsys):
    write_oneshot(tmp_path / "r")
    junit = tmp_path / "gate.xml"
    junit.symlink_to("elsewhere.xml")
    question = ["--deadline", "400us", "--probability", "1e-3", "--bursts", "1", "--confidence", "0.95"]
    assert main(["gate", str(tmp_path / "r"), *question, "--junit", str(junit)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == "passed"
    assert junit.is_symlink() and ElementTree.parse(junit).getroot().attrib["failures"] == "0"


def test_a_log_without_order_passes_only_when_told_to(tmp_path, capsys):
    folder = write_oneshot(tmp_path, logs=True)
    log = str(next(folder.glob("*measured.log")))
    assert main(["gate", log, "--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]) == 1
    assert "FAIL  PROVEN IF INDEPENDENT" in capsys.readouterr().out
    assert (
        main(["gate", log, "--deadline", "400us", "--probability", "1e-3", "--bursts", "1", "--assume-independent"])
        == 0
    )


def test_runs_of_one_name_that_were_put_together_are_runs_of_their_own(tmp_path, capsys):
    """Two boots, measured into two folders; as one run of one boot they would be a proof."""
    for folder, boot, late in (("001", "a", [2500, 7537]), ("001-again", "b", [1250, 3787, 6398, 9083])):
        values = latencies(10_000, len(late), 90.0)
        values[late] = 500_000
        oneshot_run(tmp_path, folder, values, run="001", target={"name": "board", "boot_id": boot})
    question = [str(tmp_path), "--deadline", "400us", "--probability", "1e-3", "--bursts", "1", "--json"]
    assert main(["gate", *question]) == 1
    capsys.readouterr()
    main(["verdict", *question])
    (group,) = json.loads(capsys.readouterr().out)["groups"]
    assert (group["verdict"]["answer"], group["verdict"]["boots"]) == ("NEEDS MORE", 2)


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        (["--deadline", "400us", "--probability", "1e-6"], "NEEDS MORE"),
        (["--deadline", "0.09ms", "--probability", "1e-3", "--bursts", "1"], "REFUTED"),
    ],
)
def test_too_little_and_too_late_fail(tmp_path, capsys, question, answer):
    write_oneshot(tmp_path)
    assert main(["gate", str(tmp_path), *question]) == 1
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "failed" and printed[4].startswith(f"FAIL  {answer}")


def test_emulated_results_never_pass(tmp_path, capsys):
    write_oneshot(tmp_path, platform="emulated")
    assert main(["gate", str(tmp_path), "--deadline", "400us", "--probability", "1e-2", "--bursts", "1"]) == 1
    printed = capsys.readouterr().out
    assert printed.startswith("EMULATED") and "FAIL  not a real-time statement" in printed


def test_the_worst_answer_is_the_first_line(campaign, capsys):
    assert main(["gate", str(campaign), "--deadline", "400us"]) == 1
    table = capsys.readouterr().out.splitlines()[4:]
    answers = [re.split(r"  +", line)[1] for line in table]
    assert answers == sorted(answers, key=["REFUTED", "NEEDS MORE"].index) and len(set(answers)) == 2
    values = [read_time_ns(re.split(r"  +", line)[-1].replace(" ", "")) for line in table if "REFUTED" in line]
    assert values == sorted(values, reverse=True)


@pytest.mark.parametrize("command", ["gate", "report"])
def test_a_scenario_is_a_line_and_what_its_answer_rests_on_is_told_when_asked_for(
    campaign, capsys, monkeypatch, command
):
    monkeypatch.setenv("COLUMNS", "200")
    main([command, str(campaign), "--deadline", "400us"])
    short = capsys.readouterr().out.splitlines()
    main([command, str(campaign), "--deadline", "400us", "-v"])
    lines = [line for line in capsys.readouterr().out.splitlines() if "; worst " in line]
    assert len(lines) == 15 and len(short) < 15 + 6 and not any("; worst " in line for line in short)


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (["gate"], "\n\nno scenario has an answer: measured on an emulated board\n"),
        (["report", "--format", "junit"], " in any scenario: measured on an emulated board.\n"),
    ],
)
def test_why_no_scenario_has_an_answer_is_printed_once(emulated, tmp_path, capsys, command, sentence):
    output = ["--output", str(tmp_path / "x")] if command[0] == "report" else []
    main([command[0], str(emulated), "--deadline", "400us", *command[1:], *output])
    printed = capsys.readouterr().out
    assert printed.count(sentence) == 1
    assert printed.count("measured on") == 1


def test_a_proof_from_a_virtual_machine_passes_only_when_told_to(tmp_path, capsys):
    write_oneshot(tmp_path, platform="virtual")
    question = ["gate", str(tmp_path), "--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]
    assert main(question) == 1
    printed = capsys.readouterr().out
    assert printed.startswith("VIRTUAL: verdicts are for this virtual machine on this host\nfailed\n")
    assert re.search(r"^FAIL  PROVEN ", printed, re.M) and "passes only with --platform virtual" in printed
    assert main([*question, "--platform", "virtual"]) == 0
    assert capsys.readouterr().out.startswith("VIRTUAL: ")


def test_virtual_is_no_pass_for_what_is_emulated_or_not_proven(tmp_path, capsys):
    write_oneshot(tmp_path / "emulated", platform="emulated")
    write_oneshot(tmp_path / "virtual", platform="virtual")
    question = ["--platform", "virtual", "--probability"]
    assert main(["gate", str(tmp_path / "emulated"), *question, "1e-2"]) == 1
    assert main(["gate", str(tmp_path / "virtual"), *question, "1e-6"]) == 1
    assert "--platform" not in capsys.readouterr().out, "what else is missing is not the platform"


@pytest.mark.parametrize("command", ["gate", "verdict", "report", "claims"])
def test_runs_of_two_platforms_are_not_examined_together(tmp_path, capsys, command):
    write_oneshot(tmp_path, "a")
    write_oneshot(tmp_path, "b", platform="virtual")
    assert main([command, str(tmp_path)]) == 2
    assert "holds runs of several platforms (hardware, virtual)" in capsys.readouterr().err


def test_two_platforms_are_not_compared(tmp_path, capsys):
    write_oneshot(tmp_path / "a")
    write_oneshot(tmp_path / "b", platform="emulated")
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert "times of different platforms are not compared" in capsys.readouterr().err


def test_a_failed_run_does_not_pass_unseen(tmp_path, capsys):
    write_oneshot(tmp_path)
    write_oneshot(tmp_path, "b", status="failed", reason="the link was lost")
    assert main(["gate", str(tmp_path), "--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]) == 1
    assert "NOT ANALYSED" in capsys.readouterr().out


def test_what_a_restart_cut_off_is_named_and_counts_as_late(tmp_path, capsys):
    write_oneshot(tmp_path, "a")
    # Its warm-up, too.
    write_oneshot(tmp_path, "a.warm-up")
    for name in ("a", "a.warm-up"):
        (tmp_path / f"{name}.incomplete-1").mkdir()
    question = ["gate", str(tmp_path), "--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]
    assert main(question) == 1
    printed = capsys.readouterr().out
    assert re.search(r"^pass  REPEATED +a.incomplete-1 +-", printed, re.M)
    assert (
        "1 of 2 attempts gave no values (a.incomplete-1: cut off by a restart of the target) and count as late"
        in printed
    )
    assert "2 scenarios: cut off by a restart" in printed
    (tmp_path / "b.incomplete-1").mkdir()
    assert main(question) == 1
    assert "FAIL  NOT ANALYSED  b.incomplete-1" in capsys.readouterr().out


def test_a_run_that_failed_when_it_was_repeated_does_not_pass(tmp_path, capsys):
    write_oneshot(tmp_path, "a")
    write_oneshot(tmp_path, "b", status="failed", reason="the link was lost")
    (tmp_path / "b.incomplete-1").mkdir()
    assert main(["gate", str(tmp_path), "--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]) == 1
    printed = capsys.readouterr().out
    assert re.search(r"^FAIL  NOT ANALYSED  b +-", printed, re.M) and "b: failed" in printed


COSTS = {"major_faults": 1, "voluntary_switches": 5000, "involuntary_switches": 0, "cpu_time_ns": 10**8}


@pytest.mark.parametrize(
    ("costs", "allowed", "says"),
    [
        (COSTS | {"minor_faults": 0}, 1, None),
        (COSTS | {"minor_faults": 1}, 1, "2 page faults while it measured, 1 allowed"),
        (None, 1, "it does not tell how many it had while it measured, 1 allowed"),
    ],
)
def test_a_program_with_page_faults_fails_where_they_are_asked_for(tmp_path, capsys, costs, allowed, says):
    program = {"name": "oneshot_timer_tests", "argv": ["x"], "exit_status": 0, "costs": costs, "loops": 5000}
    write_oneshot(tmp_path, programs=[program])
    question = ["gate", str(tmp_path), "--deadline", "400us", "--probability", "1e-2", "--bursts", "1"]
    assert main(question) == 0
    capsys.readouterr()
    assert main([*question, "--max-page-faults", str(allowed)]) == (1 if says else 0)
    assert (says or "") in capsys.readouterr().out.replace("\n", " ")


def test_page_faults_of_the_processes_of_a_topology_count_and_of_observed_programs_nobody_does(tmp_path, capsys):
    process = {"name": "brake", "argv": ["x"], "exit_status": 0, "costs": COSTS | {"minor_faults": 1}, "loops": 5}
    for suite, programs, says in (("topology", [process], "2 page faults"), ("observed_timers", [], "nobody counted")):
        write_oneshot(tmp_path / suite)
        (tmp_path / suite / "b").mkdir()
        write_record(tmp_path / suite / "b", suite, [], {}, programs=programs, subject="attached")
        question = ["gate", str(tmp_path / suite), "--deadline", "400us", "--probability", "1e-2", "--bursts", "1"]
        assert main(question) == 0
        capsys.readouterr()
        if says == "nobody counted":
            shutil.rmtree(tmp_path / suite / "a")
        assert main([*question, "--max-page-faults", "0"]) == 1
        assert says in capsys.readouterr().out


def test_what_has_no_deadline_fails_by_a_case(tmp_path, capsys):
    """A JUnit file without one is green where it is shown."""
    (tmp_path / "a").mkdir()
    columns = {"timestamp_ns": np.arange(100) * 10**7, "segment": np.zeros(100, np.int64)}
    parameters = {"topic": "/a", "end": "publisher", "node": "/b"}
    stream = ObservedOutput(suite="observed_intervals", parameters=parameters, columns=columns, asked=99, measured=99)
    times = {"start_time": "2026-11-21T10:00:00Z", "end_time": "2026-11-21T10:01:00Z"}
    kernel = Uname(release="6.1", version="#1", machine="x86_64")
    write_stream(tmp_path / "a", "a", stream, Provenance(version="1", host="x", kernel=kernel, **times), [])
    write_record(tmp_path / "a", stream.suite, ["a"], parameters, subject="attached")
    junit = tmp_path / "gate.xml"
    assert main(["gate", str(tmp_path), "--probability", "1e-2", "--bursts", "1", "--junit", str(junit)]) == 1
    assert "nothing that was measured has a deadline" in capsys.readouterr().out
    assert ElementTree.parse(junit).getroot().attrib["failures"] == "1"


def test_differences_near_all_are_no_powers_of_ten(tmp_path, capsys):
    for name, mean_us in (("a", 90.0), ("b", 900.0)):
        write_oneshot(tmp_path / name, mean_us=mean_us)
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    assert "largest difference of the distributions 100 %" in capsys.readouterr().out.replace("\n", " ")


def test_wrong_questions_are_usage_errors(tmp_path, capsys):
    write_oneshot(tmp_path)
    for wrong in (["--deadline", "400"], ["--deadline", "0us"], ["--probability", "0"], ["--confidence", "nan"]):
        assert main(["gate", str(tmp_path), *wrong]) == 2
        assert wrong[1] in capsys.readouterr().err
    assert main(["gate", str(tmp_path / "none")]) == 2


def test_compare_tells_what_changed(tmp_path, capsys):
    write_oneshot(tmp_path / "a", n=20_000)
    write_oneshot(tmp_path / "b", n=20_000, mean_us=95.0, seed=2)
    write_oneshot(tmp_path / "c", n=20_000, seed=3)
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--margin", "1us"]) == 0
    printed = capsys.readouterr().out
    assert (
        printed.startswith(
            "THESE RUNS DIFFER  oneshot_timer RR 1000 us: fewer than five runs or boots a side; not measured"
        )
        and "us in these runs; an interval takes five runs a side" in printed
    )
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "c"), "--margin", "50us"]) == 0
    assert capsys.readouterr().out.startswith("NO DIFFERENCE  ")
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "c"), "--margin", "0.01us"]) == 0
    assert capsys.readouterr().out.startswith("NO DIFFERENCE SEEN  ")
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["changes"][0]["comparison"]["answer"] == "THESE RUNS DIFFER"


def test_compare_matches_each_target_with_itself(tmp_path, capsys):
    for side, seed in (("a", 1), ("b", 5)):
        for name, mean_us in (("slow", 590.0), ("fast", 90.0)):
            target = {"name": name, "kernel_release": "6.1"}
            write_oneshot(tmp_path / side, name, mean_us=mean_us, seed=seed, target=target)
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert [change["label"].partition(" on ")[2] for change in data["changes"]] == ["fast, 6.1", "slow, 6.1"]
    for change in data["changes"]:
        assert all(abs(shift["b_ns"] - shift["a_ns"]) < 20_000 for shift in change["comparison"]["shifts"])


def test_compare_refuses_what_could_be_matched_in_two_ways(tmp_path, capsys):
    write_oneshot(tmp_path / "a", "x", target={"name": "first"})
    for name in ("second", "third"):
        write_oneshot(tmp_path / "b", name, target={"name": name})
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert "first in A, second and third in B: no target is in both" in capsys.readouterr().err
    write_oneshot(tmp_path / "a", "y", target={"name": "second"})
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert "only in A: oneshot_timer RR 1000 us on first" in printed
    assert "only in B: oneshot_timer RR 1000 us on third" in printed


def test_compare_needs_something_in_common(tmp_path, capsys):
    write_oneshot(tmp_path / "a")
    cyclic_run(tmp_path / "b", "x", latencies(500, 1))
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert "in common" in capsys.readouterr().err


def test_claims_are_printed_with_their_numbers(campaign, capsys):
    assert main(["claims", str(campaign)]) == 0
    printed = capsys.readouterr().out
    assert sum(line.startswith(("confirmed", "refuted", "undecided")) for line in printed.splitlines()) == 19
    assert main(["claims", str(campaign), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["claims"]) == 19
