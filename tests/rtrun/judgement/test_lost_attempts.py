"""Runs whose publisher missed its rate: told in every answer, and no lucky repetition proves anything."""

import json

import pytest
from report.campaigns import latencies, message_run

from rtrun.cli import main
from rtrun.judgement.standings import standings
from rtrun.judgement.study import study

QUESTION = ["--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]
LOST = "1 of 3 attempts gave no values ("


def write(root, name, seed, achieved_hz, **record):
    rate = {"asked_hz": 1000, "achieved_hz": achieved_hz, "overruns": 1, "skipped": 2}
    programs = [{"name": "communication_tests_publisher", "argv": ["x"], "exit_status": 0, "rate": rate}]
    message_run(root, name, [latencies(4000, seed)], hz=1000, programs=programs, **{"attempt": name, **record})


@pytest.fixture
def results(tmp_path):
    for number in range(2):
        write(tmp_path, f"00{number}", number, 999.9)
    return tmp_path


def missed(root, name):
    write(root, name, 9, 800.0, status="invalid", reason="off by 20 %")


def test_what_every_run_keeps_is_proven_and_its_rate_is_shown(results, capsys):
    assert main(["gate", str(results), *QUESTION]) == 0
    assert main(["show", str(results / "000")]) == 0
    words = "communication_tests_publisher: asked for 1000 Hz, achieved 999.9 Hz, 1 overrun, 2 skipped periods"
    assert words in capsys.readouterr().out
    assert main(["show", str(results / "000"), "--json"]) == 0
    rates = json.loads(capsys.readouterr().out)["rates"]
    assert rates["communication_tests_publisher"]["skipped"] == 2
    assert main(["report", str(results), "--format", "markdown"]) == 0
    report = (results / "report.md").read_text()
    assert "| 000 | communication\\_tests\\_publisher | 1000 | 999.9 | 1 | 2 |" in report


@pytest.mark.parametrize("name", ["002", "000.old-1"], ids=["not repeated", "repeated"])
def test_nothing_is_proven_where_a_run_missed_its_rate(results, name, capsys):
    missed(results, name)
    assert main(["gate", str(results), *QUESTION]) == 1
    assert main(["verdict", str(results), *QUESTION]) == 0
    assert main(["report", str(results), *QUESTION, "--format", "markdown"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert out.count(LOST) >= 3 and " PROVEN" not in out
    assert main(["verdict", str(results), *QUESTION, "--json"]) == 0
    (standing,) = standings(study(results, bounds=False))
    assert standing.is_final, "its group leaves the rounds: measuring on proves nothing"
    (group,) = json.loads(capsys.readouterr().out)["groups"]
    verdict = group["verdict"]
    assert (group["answer"], verdict["runs"], verdict["further"]) == ("NEEDS MORE", 2, None)
    assert len(verdict["lost"]) == 1 and verdict["lost"][0].startswith(f"{name}: invalid")


@pytest.mark.parametrize("name", ["002", "000.old-1"], ids=["not repeated", "repeated"])
def test_an_archive_tells_how_many_runs_its_figures_are_without(results, tmp_path_factory, name, capsys):
    missed(results, name)
    archive = tmp_path_factory.mktemp("archive")
    assert main(["archive", "add", str(results), "--to", str(archive)]) == 0
    assert main(["history", str(archive), "--json"]) == main(["site", str(archive), "--output", str(archive)]) == 0
    out = capsys.readouterr().out
    (point,) = json.loads(out[out.index("{") : out.rindex("}") + 1])["points"]
    assert (len(point["run_keys"]), point["off_rate"]) == (2, 1)
    assert main(["history", str(archive)]) == main(["trends", str(archive)]) == 0
    out = capsys.readouterr().out
    assert " 2, 1 off rate " in out
    assert "0 changes in 1 course, of 2 boots, without 1 run that missed the rate that was asked for\n" in out
    (page,) = (page for page in archive.glob("*.html") if page.name not in ("index.html", "boards.html"))
    assert "2 runs on 2 boots since 2026-11-21, without 1 that missed the rate asked for." in page.read_text()


def test_runs_of_another_kind_are_not_concerned(results, capsys):
    write(results, "002.old-1", 9, 800.0, status="invalid", reason="off by 20 %", condition="cpu80")
    write(results, "003.old-1", 8, 999.0, status="invalid", reason="other middleware", unrelated_end="other set-up")
    assert main(["gate", str(results), *QUESTION]) == 0
