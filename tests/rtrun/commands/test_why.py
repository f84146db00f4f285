"""rtrun why: the answer first, then the ranking, then each outlier."""

import json
import re

import numpy as np
import pytest
from report.campaigns import communication_rows, cyclic_rows, latencies, oneshot_rows, write_campaign, write_run
from traced import OUTPUT, head, line, specimen, switch, write_traced_run

from rtrun.cli import main


@pytest.fixture
def results(tmp_path):
    shared = head(1500, 1600, 28900_000_000) + f"# in {OUTPUT}-trace-1558.txt\n"
    write_traced_run(tmp_path / "results", {1558: specimen(1558), 1600: shared}, [23166, 23175])
    return tmp_path / "results"


def test_the_answer_comes_first(results, capsys):
    assert main(["why", str(results)]) == 0
    out = capsys.readouterr().out
    first, second, third, worst = out.splitlines()[:4]
    assert first == (
        "thread of higher priority planted_hog (pid 23165, real-time 98 above real-time 95): "
        "the main cause of 1 of 1 traced outlier, 97 % of their lateness."
    )
    assert second.startswith("planted_hog: give the thread a lower real-time priority than the measured one")
    assert second.endswith("(sched(7), chrt(1))")
    assert (third, worst.split(":")[0]) == ("", "1.722 ms too late")
    assert "\n1 outlier without parts: the trace holds nothing of that moment" in out
    lines = [line.split() for line in out.splitlines()]
    units = {"ns": 0.001, "us": 1, "ms": 1000}
    parts = [
        float(words[0]) * units[words[1]] for words in lines[4 : lines.index([], 3)] if words[1:2] and words[1] in units
    ]
    assert sum(parts) == pytest.approx(1721.9, abs=1)
    # What no event explains is shown even where that is nothing: in the ranking and with the outlier.
    unexplained = [words for words in lines if "unexplained" in words]
    assert unexplained == [
        ["0", "us", "unexplained"],
        ["unexplained", "0", "of", "1", "0", "0", "us", "0", "us", "-"],
    ]


def test_a_run_with_traces_in_which_nothing_was_late(tmp_path, capsys):
    folder = write_traced_run(tmp_path, {}, [1])
    assert main(["why", str(folder)]) == 0
    assert capsys.readouterr().out == "No value was above the limit from which on a run keeps traces.\n"


def test_results_without_traces(tmp_path, capsys):
    folder = write_traced_run(tmp_path, {}, [1])
    record = folder / "run.json"
    record.write_text(record.read_text().replace('"trace_threshold_us": 100', '"trace_threshold_us": null'))
    assert main(["why", str(folder)]) == 0
    assert capsys.readouterr().out.startswith("No run kept kernel traces, which name causes: a campaign asks for them")


def test_what_was_refused_comes_after_the_answer(results, capsys):
    other = write_traced_run(results.parent / "other", {3: "# tracer: nop\n"}, [1])
    other.rename(results / "002-run")
    assert main(["why", str(results)]) == 2
    captured = capsys.readouterr()
    assert captured.out.startswith("thread of higher priority planted_hog")
    assert "its first line does not name an outlier" in captured.err


def test_where_all_was_refused_the_answer_does_not_say_that_nothing_was_late(tmp_path, capsys):
    write_traced_run(tmp_path, {3: ""}, [1])
    assert main(["why", str(tmp_path)]) == 2
    captured = capsys.readouterr()
    assert captured.out.startswith("No outlier has a trace that could be read.")
    assert "its first line does not name an outlier" in captured.err


def test_names_of_threads_are_not_cut_off(tmp_path, capsys):
    me, hog = ("cyclic_timer_te", 1, 4), ("a_name_of_15_ch", 2, 1)
    text = head(90_000_000, 3, 100_000_000) + switch(9_000_000, me, hog, state="R")
    text += switch(99_999_000, hog, me, state="R")
    write_traced_run(tmp_path, {3: text + line(100_000_001, "local_timer_entry: vector=1")}, [1])
    assert main(["why", str(tmp_path)]) == 0
    assert "a_name_of_15_ch  " in capsys.readouterr().out.split("\nwhat ")[1]


@pytest.mark.parametrize("width", ["60", "80"])
def test_the_first_screen_has_the_three_worst_and_no_broken_word(width, tmp_path, capsys, monkeypatch):
    """Whoever took less than a hundredth of an outlier is summed up there; --all prints every part of every outlier."""
    monkeypatch.setenv("COLUMNS", width)
    me, hog, short = ("cyclic_timer_te", 1, 4), ("a_name_of_15_ch", 2, 1), [(f"short_{n}", n, 1) for n in (3, 4)]
    traces = {}
    for index in (3, 4, 5, 6):
        text = head(900_000 + index, index, 1_000_000) + switch(90_000, me, hog, state="R")
        text += "".join(switch(us, *pair) for us, *pair in zip((990_000, 990_100), (hog, short[0]), short, strict=True))
        traces[index] = text + switch(990_200, short[1], me, state="R") + line(1_000_001, "local_timer_entry: vector=1")
    write_traced_run(tmp_path, traces, [1])
    assert main(["why", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    worst, ranking = out.split("\n1 more outlier: --all prints them, and every part\n")
    assert (worst.count(" too late: "), worst.count("200 us  2 more, which took less than 1 % each")) == (3, 3)
    assert max(map(len, ranking.splitlines()[2:-1])) <= int(width)
    assert {"thread", "higher", "a_name_of_15_ch", "real-time", "unexplained"} <= set(ranking.split())
    assert main(["why", str(tmp_path), "--all"]) == 0
    out = capsys.readouterr().out
    assert (out.count(" too late: "), out.count("short_3"), "more" in out.split("What late")[0]) == (4, 4, False)


def test_an_idle_cpu_that_the_thread_could_not_use_is_said(tmp_path, capsys):
    me, hog, idle, other = ("me", 1, 4), ("hog", 2, 1), ("swapper/1", 0, 120), ("other", 3, 120)
    text = head(1000, 3, 5000) + switch(3000, other, me, cpu=1) + switch(3500, me, other, cpu=1)
    text += switch(4000, me, hog, state="R") + switch(4200, other, idle, cpu=1) + switch(4990, hog, me)
    text += line(5001, "local_timer_entry: vector=1")
    sentence = "  meanwhile CPU 1 was idle for 790 us: its affinity excludes it"
    for name, trace, is_said in (("idle", text, True), ("busy", text.replace("next_pid=0 ", "next_pid=7 "), False)):
        assert main(["why", str(write_traced_run(tmp_path / name, {3: trace}, [1]))]) == 0
        assert (sentence in capsys.readouterr().out) is is_said


def test_who_took_little_is_counted(tmp_path, capsys):
    me, hog, trifle = ("me", 1, 4), ("hog", 2, 1), ("trifle", 3, 1)
    text = head(1000, 3, 5000) + switch(3000, hog, me, state="R") + switch(3500, me, hog, state="R")
    text += switch(4985, hog, trifle, state="R") + switch(4990, trifle, me, state="R")
    write_traced_run(tmp_path, {3: text + line(5001, "local_timer_entry: vector=1")}, [1])
    assert main(["why", str(tmp_path), "--all"]) == 0
    outlier, ranking = capsys.readouterr().out.split("\nWhat late values waited for:\n")
    assert "1 more took less than 1 % each" in ranking and "trifle" not in ranking
    assert "trifle" in outlier, "the parts of an outlier are all there"


def test_a_section_of_the_report(results, capsys):
    assert main(["report", str(results), "--output", "-", "--format", "markdown"]) == 0
    out = capsys.readouterr().out
    assert "## What late values waited for" in out
    assert "| thread of higher priority | planted\\_hog | real-time 98 above real-time 95 | 1 of 1 | 1 |" in out


def every_500th_is_late(n=20_000):
    values = latencies(n, 1)
    values[np.arange(n) % 500 == 123] += 900_000
    return values


@pytest.mark.parametrize(
    ("suite", "rows", "parameters", "period"),
    [
        (
            "oneshot_timer_tests",
            oneshot_rows(every_500th_is_late(), 1000),
            {"timeout_us": 1000, "busy_mode": 0},
            "0.575 s",
        ),
        ("cyclic_timer_tests", cyclic_rows(every_500th_is_late(), 1000), {"frequency_hz": 1000}, "0.5 s"),
        (
            "communication_tests",
            communication_rows(every_500th_is_late(), 1000),
            {"frequency_hz": 1000, "payload_bytes": 0},
            "0.5 s",
        ),
    ],
)
def test_a_period_needs_no_trace(suite, rows, parameters, period, tmp_path, capsys):
    write_run(tmp_path, "001-run", suite, [rows], parameters, asked=20_000, logs=False)
    assert main(["why", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert f"Late values that come at a period: every {period}, in 1 output\n" in captured.out, captured
    assert re.search(rf" 64 +{period} +39 of 40 ", captured.out), captured
    assert main(["report", str(tmp_path), "--output", "-", "--format", "markdown"]) == 0
    out = capsys.readouterr().out
    assert "## Late values that come at a period" in out
    assert re.search(rf"\| 64 \| {period} \| 39 of 40 \|", out), out


def test_the_series_that_is_judged_is_explained(tmp_path, capsys):
    """Calls drift by milliseconds, and every 500th comes 0.3 ms late: its jitter is among the highest alone."""
    drift = np.cumsum(np.random.default_rng(1).normal(0, 20_000, 20_000)).astype(np.int64)
    late = 10_000_000 + drift + (np.arange(20_000) % 500 == 123) * 300_000
    write_run(tmp_path, "001-run", "cyclic_timer_tests", [cyclic_rows(late, 20)], {"frequency_hz": 20},
              asked=20_000, logs=False)  # fmt: skip
    write_traced_run(tmp_path / "traced", {}, [1]).rename(tmp_path / "002-run")
    found, other = "Late values that come at a period", "Traces are of the lateness in 1 run, not of the jitter, which"

    def answers(*words):
        assert main([*words]) == 0
        out = capsys.readouterr().out
        return [found in out, other in out]

    assert answers("why", str(tmp_path)) == [False, False]
    assert answers("why", str(tmp_path), "--of", "jitter") == [True, True]
    goal = {"schema": 1, "until": {"of": "jitter", "deadline": "1ms", "probability": 0.1, "at_most": "1h"}}
    (tmp_path / "goal.json").write_text(json.dumps(goal))
    assert answers("why", str(tmp_path)) == [True, True]
    assert answers("why", str(tmp_path), "--of", "lateness") == [False, False]
    report = ("report", str(tmp_path), "--output", "-", "--format", "markdown")
    assert [answers(*report)[0], answers(*report, "--of", "lateness")[0]] == [True, False]


def test_without_a_period_none_is_said(tmp_path, capsys):
    write_campaign(tmp_path / "results", n=2000)
    assert main(["why", str(tmp_path / "results")]) == 0
    out = capsys.readouterr().out
    assert out.startswith("No run kept kernel traces")
    assert len(out.splitlines()) == 1
