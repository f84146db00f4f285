"""rtrun why: the answer first, then the ranking, then each outlier."""

import pytest
from traced import OUTPUT, head, specimen, write_traced_run

from rtrun.cli import main


@pytest.fixture
def results(tmp_path):
    shared = head(1500, 1600, 28900_000_000) + f"# in {OUTPUT}-trace-1558.txt\n"
    write_traced_run(tmp_path / "results", {1558: specimen(1558), 1600: shared}, [23166, 23175])
    return tmp_path / "results"


def test_the_answer_comes_first(results, capsys):
    assert main(["why", str(results)]) == 0
    out = capsys.readouterr().out
    first, second, third = out.splitlines()[:3]
    assert first == (
        "thread of higher priority planted_hog (pid 23165, real-time 98): "
        "the main cause of 1 of 1 traced outlier, 97 % of their lateness."
    )
    assert second.startswith("planted_hog: give the thread a lower real-time priority than the measured one")
    assert second.endswith("(sched(7), chrt(1))")
    assert third.startswith("1 more without parts: the trace holds nothing of that moment")
    lines = [line.split() for line in out.splitlines()]
    begin = next(k for k, words in enumerate(lines) if words[:4] == ["1722", "us", "too", "late:"])
    parts = [float(words[0]) for words in lines[begin + 1 :] if words[1:2] == ["us"] and "late:" not in words]
    assert sum(parts) == pytest.approx(1721.9, abs=0.2)


def test_a_run_with_traces_in_which_nothing_was_late(tmp_path, capsys):
    folder = write_traced_run(tmp_path, {}, [1])
    assert main(["why", str(folder)]) == 0
    assert capsys.readouterr().out == "No value was above the limit from which on a run keeps traces.\n"


def test_results_without_traces(tmp_path, capsys):
    folder = write_traced_run(tmp_path, {}, [1])
    record = folder / "run.json"
    record.write_text(record.read_text().replace('"trace_threshold_us": 100', '"trace_threshold_us": null'))
    assert main(["why", str(folder)]) == 2
    assert "no run with traces: a campaign asks for them by trace_threshold_us" in capsys.readouterr().err


def test_what_was_refused_comes_after_the_answer(results, capsys):
    other = write_traced_run(results.parent / "other", {3: "# tracer: nop\n"}, [1])
    other.rename(results / "002-run")
    assert main(["why", str(results)]) == 2
    captured = capsys.readouterr()
    assert captured.out.startswith("thread of higher priority planted_hog")
    assert "its first line does not name an outlier" in captured.err


def test_a_section_of_the_report(results, capsys):
    assert main(["report", str(results), "--output", "-", "--format", "markdown"]) == 0
    out = capsys.readouterr().out
    assert "## What late values waited for" in out
    assert "| thread of higher priority | planted\\_hog | real-time 98 | 1 of 1 | 1 |" in out
