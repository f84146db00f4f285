"""Streams of programs that ran already, written as runs: every command that reads results takes them as any other.

Each stream has a deadline of its own or none; one that somebody names comes before them.
"""

import dataclasses
import json
import re
import shutil

import numpy as np
import pytest
from written import write_record

from rtrun.cli import main
from rtrun.judgement.study import study
from rtrun.kinds.messages import NOT_SEEN_NS
from rtrun.kinds.timer import UNKNOWN_NS
from rtrun.plan.question import Question
from rtrun.report.contents import contents
from rtrun.report.plots.charts import plots
from rtrun.results.observed import ObservedOutput, Provenance, write_stream
from rtrun.results.output import Thread, Uname

PERIOD_NS = 10_000_000
N = 6000
PROVENANCE = Provenance(
    version="0.1.0",
    host="robot",
    kernel=Uname(release="6.1.0-rt", version="#1 SMP PREEMPT_RT", machine="aarch64"),
    start_time="2026-11-21T10:00:00Z",
    end_time="2026-11-21T10:01:00Z",
)
THREADS = [Thread(tid=7, name="controller", policy="OTHER", priority=0, cpus=[0])]
AT_NS = 10**12 + PERIOD_NS * np.arange(N, dtype=np.int64)
LATE_NS = 100_000 + np.random.default_rng(1).integers(0, 20_000, N)


def write(root, name, stream, **changed):
    folder = root / name
    folder.mkdir(parents=True)
    write_stream(folder, name, stream, PROVENANCE, THREADS)
    parameters = dict(stream.parameters)
    programs = [{"name": "controller", "argv": ["controller"], "pid": 7, "threads": [THREADS[0].model_dump()]}]
    write_record(folder, stream.suite, [name], parameters, **{"subject": "attached", "programs": programs, **changed})


def messages(lost=()):
    seq = np.setdiff1d(np.arange(N), lost)
    # Every second callback was not seen to end.
    end = np.where(seq % 2, NOT_SEEN_NS, AT_NS[seq] + 500_000)
    columns = {"publication_ns": AT_NS[seq], "reception_ns": (AT_NS + LATE_NS)[seq], "seq": seq, "callback_end_ns": end}
    parameters = {"topic": "/cmd_vel", "publisher": "/controller", "subscriber": "/base"}
    return ObservedOutput(
        suite="observed_messages", parameters=parameters, columns=columns, asked=N, measured=seq.size, missing=len(lost)
    )


def timer(*, known=True, segments=1, skipped=0, ahead_ns=0):
    """A timer in segments with a gap of a second between them; within the last one periods without a call.

    Its own clock is ahead of that of the hits.
    """
    segment = np.arange(N) * segments // N
    due = AT_NS + segment * 10**9
    due[-10:] += skipped * PERIOD_NS
    columns = {
        "timestamp_ns": due + LATE_NS,
        "expected_ns": due + ahead_ns if known else np.full(N, UNKNOWN_NS),
        "real_ns": due + LATE_NS + ahead_ns,
        "segment": segment,
    }
    parameters = {"node": "/controller", "timer": "timer 10 ms", "period_ns": PERIOD_NS}
    return ObservedOutput(
        suite="observed_timers", parameters=parameters, columns=columns, asked=N - segments, measured=N - segments
    )


def spans(suite, begin_ns=AT_NS, **parameters):
    columns = {"begin_ns": begin_ns, "end_ns": begin_ns + LATE_NS}
    return ObservedOutput(suite=suite, parameters=parameters, columns=columns, asked=N, measured=N)


def interval():
    columns = {"timestamp_ns": AT_NS, "segment": np.zeros(N, np.int64)}
    return ObservedOutput(
        suite="observed_intervals", parameters={"topic": "/scan"}, columns=columns, asked=N - 1, measured=N - 1
    )


@pytest.fixture
def results(tmp_path):
    write(tmp_path, "a", messages(), deadline_ns=5_000_000)
    write(tmp_path, "b", timer(segments=3), deadline_ns=50_000)
    write(tmp_path, "c", spans("observed_callbacks", callback="0x1"), deadline_ns=1_000_000)
    write(tmp_path, "d", spans("observed_paths", AT_NS - 1000, path="/scan,/cmd_vel"))
    write(tmp_path, "e", interval())
    return tmp_path


@pytest.fixture
def rtrun(capsys):
    """Run a command; returns its status and what it printed."""

    def run(*words):
        status = main([str(word) for word in words])
        return status, capsys.readouterr().out

    return run


def answers(rtrun, results, *options):
    """The sentence about each group, by its first word."""
    groups = json.loads(rtrun("verdict", results, "--json", *options)[1])["groups"]
    return {group["group"].split(" ")[0]: group for group in groups}


@pytest.mark.parametrize("missing", [0, 1])
def test_an_interval_that_had_not_ended_is_a_miss(tmp_path, missing):
    parameters = {"topic": "/cmd_vel", "end": "publisher", "node": "/controller"}
    columns = {"timestamp_ns": AT_NS, "segment": np.zeros(N, np.int64)}
    stream = ObservedOutput(
        suite="observed_intervals", parameters=parameters, columns=columns,
        asked=N - 1 + missing, measured=N - 1, missing=missing,
    )  # fmt: skip
    write(tmp_path, "a", stream, deadline_ns=5 * PERIOD_NS)
    (group,) = study(tmp_path).groups
    assert (group.verdict.misses, group.verdict.n) == (missing, N - 1 + missing)


def test_each_stream_is_held_against_its_own_deadline(rtrun, results):
    seen = {suite: group["answer"] for suite, group in answers(rtrun, results, "--probability", "0.01").items()}
    assert seen == {
        "messages": "PROVEN",
        "timer": "REFUTED",
        "callback": "PROVEN",
        "path": "no deadline",
        "interval": "no deadline",
    }


def test_a_deadline_that_is_named_comes_before_them(rtrun, results):
    seen = answers(rtrun, results, "--probability", "0.01", "--deadline", "110us")
    assert {suite for suite, group in seen.items() if group["answer"] == "no deadline"} == set()
    assert {group["answer"] for group in seen.values()} == {"REFUTED"}


def test_a_comparison_counts_misses_of_each_by_its_own_deadline(rtrun, results):
    status, printed = rtrun("compare", results, results)
    assert status == 0
    misses = dict(
        re.findall(r"^[A-Z ]+  (\w+) .*\n(?: {4}(?!P\(|no).*\n)+ {4}(P\(\w+ > [^)]+\)|no deadline)", printed, re.M)
    )
    assert misses == {
        "messages": "P(value > 5 ms)",
        "timer": "P(value > 50 us)",
        "callback": "P(value > 1 ms)",
        "path": "no deadline",
        "interval": "no deadline",
    }
    assert rtrun("compare", results, results, "--deadline", "110us")[1].count(" > 110 us) ") == 5


def test_the_gate_asks_of_what_has_a_deadline(rtrun, results):
    status, printed = rtrun("gate", results, "--probability", "0.01")
    assert status == 1 and "timer 10 ms of " in printed and "path /scan" not in printed
    shutil.rmtree(results / "b")
    assert rtrun("gate", results, "--probability", "0.01")[0] == 0
    for folder in "ac":
        shutil.rmtree(results / folder)
    assert rtrun("gate", results)[0] == 1, "nothing that has a deadline is no pass"


def test_the_report_asks_nothing_without_a_deadline_and_says_how_it_was_made(tmp_path):
    """400 us, the default question, are asked of no program that ran already."""
    write(tmp_path, "a", messages())
    written = contents(study(tmp_path))
    assert written.question.startswith("What follows are figures alone")
    (plot,) = (plot for plot in plots(written.scenarios[0], probability=1e-6) if plot.id == "shares")
    assert [mark.kind for mark in plot.marks] == ["steps"] and "deadline" not in plot.caption
    rows = {row[0]: row[1] for table in written.tables for row in table.rows}
    assert "--deadline" not in rows["examined"] and not {"None", "True"} & set(rows.values())
    named = contents(study(tmp_path, Question(deadline_ns=400_000)))
    assert any("--deadline 400us" in row[1] for table in named.tables for row in table.rows)


@pytest.mark.parametrize(
    ("stream", "misses", "undecidable"),
    [
        (messages(lost=(5, 6, 7)), 3, None),
        (timer(segments=3), 0, None),
        (timer(segments=3, skipped=4), 4, None),
        # ROS time counts from 1970.
        (timer(skipped=4, ahead_ns=1_796_000_000 * 10**9), 4, None),
        (timer(known=False), None, "not known: ask for the jitter"),
    ],
)
def test_what_is_lost_is_a_miss_and_what_was_not_observed_is_none(rtrun, tmp_path, stream, misses, undecidable):
    """Between segments nothing was observed: no period is skipped there, and no jitter spans it."""
    write(tmp_path, "a", stream, deadline_ns=1_000_000)
    (group,) = json.loads(rtrun("verdict", tmp_path, "--json")[1])["groups"]
    if undecidable:
        assert undecidable in group["missing"]
        return
    assert group["verdict"]["late"] + group["verdict"]["absent"] == misses


def test_all_else_takes_them(rtrun, results, tmp_path_factory):
    """show, compare, report, archive and history."""
    shown = json.loads(rtrun("show", results, "--json")[1])
    series = {result["series"] for run in shown["runs"] for result in run["results"]}
    assert series == {"latency", "handled", "lateness", "jitter", "duration", "reaction", "interval"}
    page = tmp_path_factory.mktemp("page") / "report.html"
    assert rtrun("report", results, "--output", page)[0] == 0
    assert "Its deadline is not met" in page.read_text()
    archive = tmp_path_factory.mktemp("archive")
    assert rtrun("archive", "add", results, "--to", archive)[0] == 0
    assert "messages /cmd_vel /controller -> /base" in rtrun("history", archive, "--by", "commit")[1]
    assert rtrun("compare", results, results)[0] == 0


@pytest.mark.parametrize(("skipped", "overdue"), [(0, 0), (4, 0), (0, 1), (4, 1)])
def test_the_header_of_a_timer_tells_skipped_periods_and_an_overdue_call_apart(tmp_path, skipped, overdue):
    """Both miss: a call that had not come at the end does not hide the periods that were skipped before it."""
    observed = timer(skipped=skipped)
    write(tmp_path, "a", dataclasses.replace(observed, asked=observed.asked + overdue, missing=overdue))
    (group,) = study(tmp_path, Question(deadline_ns=10**9)).groups
    (digest,) = [digest for digest in group.digests if digest.header.main]
    assert (digest.header.skipped, digest.header.missing) == (skipped, overdue)
