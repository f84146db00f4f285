"""Runs chosen by name with -k, as pytest chooses tests."""

import json

import pytest

from rtrun.cli import main

CAMPAIGN = """
schema: 1
name: chosen
runs:
  - {suite: cyclic_timer_tests, frequency_hz: [100, 1000], policy: [RR, FIFO], repetitions: 100}
  - {suite: oneshot_timer_tests, timeout_us: 1000, repetitions: 100}
"""


@pytest.fixture
def campaign(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "campaign.yml").write_text(CAMPAIGN)
    return tmp_path


@pytest.mark.parametrize(
    ("expression", "numbers"),
    [
        ("ONESHOT", "4"),
        ("cyclic and not fifo", "02"),
        ("cyclic and not (fq1000 or fifo)", "0"),
        ("not not oneshot or fq1000 and rr", "24"),
        ("001-", "0"),
    ],
)
def test_what_an_expression_chooses(campaign, capsys, expression, numbers):
    assert main(["plan", "campaign.yml", "--json"]) == 0
    every = [run["run"] for run in json.loads(capsys.readouterr().out)["runs"]]
    assert main(["plan", "campaign.yml", "-k", expression, "--json"]) == 0
    chosen = [run["run"] for run in json.loads(capsys.readouterr().out)["runs"]]
    assert chosen == [every[int(number)] for number in numbers]
    assert main(["run", "campaign.yml", "-k", expression, "--collect-only"]) == 0
    *names, last = capsys.readouterr().out.splitlines()
    assert names == chosen and last == f"{len(numbers)} of 5 runs, 0 of them finished in results/chosen"
    assert not (campaign / "results").exists()


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("nothing", "is true of none of 5 runs, as 001-"),
        ("cyclic and", "a part of a run's name is missing at the end"),
        ("or rr", "a part of a run's name is missing before 'or'"),
        ("", "a part of a run's name is missing at the end"),
        ("(rr or fifo", "')' is missing"),
        ("rr fifo", "'and' or 'or' is missing before 'fifo'"),
        ("rr)", "'and' or 'or' is missing before ')'"),
    ],
)
@pytest.mark.parametrize("command", ["plan", "run"])
def test_what_is_no_expression(campaign, capsys, command, expression, message):
    assert main([command, "campaign.yml", "-k", expression]) == 2
    shown = capsys.readouterr()
    assert shown.out == "" and f"-k {expression}: {message}" in shown.err and shown.err.count("\n") == 1
