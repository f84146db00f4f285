"""Results for which nobody named a deadline: figures and how to ask, and no verdict by a deadline of others."""

import json
import re

import pytest
from report.campaigns import write_campaign

from rtrun.cli import main


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("results"), n=500)


VERDICTS = ("PROVEN", "REFUTED", "NEEDS MORE", "P(", "> 400 us", "of 400 us", "400us")


@pytest.mark.parametrize(
    ("command", "how"),
    [
        (["verdict"], "15 groups without a deadline: --deadline TIME gives all of them one"),
        (["report"], "Without a deadline there are figures and no answer, for 15 scenarios: ask with --deadline TIME"),
    ],
)
def test_there_are_figures_and_how_to_ask(results, capsys, command, how):
    assert main([*command, str(results)]) == 0
    printed = capsys.readouterr().out
    assert how in printed and not any(word in printed for word in VERDICTS)
    assert "cyclic_timer RR " in printed and "p99.9" in printed
    assert main([*command, str(results), "--deadline", "1ms"]) == 0
    printed = capsys.readouterr().out
    assert how not in printed and re.search("is not met in 5 of 15|REFUTED", printed)


def test_no_file_names_a_deadline(results, capsys):
    for form in ("markdown", "json", "csv"):
        assert main(["report", str(results), "--format", form, "--output", "-"]) == 0
        text = capsys.readouterr().out
        words = ("is met", "not decided", "REFUTED  ", "400us", "> 400 us", "of 400 us")
        assert not any(word in text for word in words)
    assert main(["report", str(results), "--format", "json", "--output", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["deadline_ns"] is None and all(group["verdict"] is None for group in data["groups"])
    assert all(group["n"] > 0 for group in data["groups"])


def test_a_gate_does_not_pass(results, capsys):
    assert main(["gate", str(results)]) == 1
    assert "nothing that was measured has a deadline: give one, as --deadline 1ms" in capsys.readouterr().out


def test_two_sides_are_compared_without_misses(results, capsys):
    assert main(["compare", str(results), str(results), "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["deadline_ns"] is None and all(change["miss"] is None for change in data["changes"])
