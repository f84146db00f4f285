"""Attempts of which nothing is judged count as late, whoever removed them, unless their end had another reason."""

import fcntl
import json
import os
import shutil
from contextlib import closing

import pytest
from report.campaigns import latencies, message_run

from rtrun.cli import main
from rtrun.results.journal import NAME, at_work, open_journal
from rtrun.results.run_state import RunState

QUESTION = ["--deadline", "400us", "--probability", "1e-3", "--bursts", "1"]


def write(root, name, seed, **record):
    return message_run(root, name, [latencies(4000, seed)], hz=1000, **{"attempt": name, **record})


@pytest.fixture
def results(tmp_path):
    for number in (1, 2):
        write(tmp_path, f"{number:02}-messages", number)
    return tmp_path


def closed(results, *runs):
    """A journal by which these runs were closed."""
    with closing(open_journal(results, "test", "1:plan", "board")) as log:
        for run in runs:
            log.note("2026-11-21T10:00:00+00:00", run, RunState.MEASURING)
            log.note("2026-11-21T10:01:00+00:00", run, RunState.CLOSED, "ok")


def lost_of(results, capsys):
    """The attempts that the verdict of the only group counts as late."""
    passes = main(["gate", str(results), *QUESTION]) == 0
    capsys.readouterr()
    assert main(["verdict", str(results), *QUESTION, "--json"]) == 0
    (group,) = json.loads(capsys.readouterr().out)["groups"]
    assert (group["answer"] == "PROVEN") == (not group["verdict"]["lost"])
    assert passes == (not group["verdict"]["lost"])
    return group["verdict"]["lost"]


def test_what_is_whole_is_proven(results, capsys):
    assert lost_of(results, capsys) == []
    closed(results, "01-messages", "02-messages")
    assert lost_of(results, capsys) == []


@pytest.mark.parametrize(
    ("name", "status", "why"),
    [
        ("01-messages.old-1", "failed", "failed, then measured again"),
        ("01-messages.old-1", "ok", "ok, then measured again"),
        ("03-messages", "failed", "failed: the publisher did not end within 60 s"),
        ("03-messages", "incomplete", "incomplete: the publisher did not end within 60 s"),
    ],
)
def test_an_attempt_that_gave_nothing_counts(results, name, status, why, capsys):
    write(results, name, 9, status=status, reason="the publisher did not end within 60 s")
    assert lost_of(results, capsys) == [f"{name}: {why}"]


@pytest.mark.parametrize("end", ["interrupted", "link lost", "disk full", "other set-up"])
def test_an_end_that_had_another_reason_does_not(results, end, capsys):
    write(results, "01-messages.old-1", 9, status="failed", reason="it was ended", unrelated_end=end)
    assert lost_of(results, capsys) == []


def test_another_kind_is_not_concerned(results, capsys):
    write(results, "01-messages.old-1", 9, status="failed", reason="it hung", condition="cpu80")
    assert lost_of(results, capsys) == []


def test_a_record_that_cannot_be_read_may_have_been_of_any_kind(results, capsys):
    (write(results, "01-messages.old-1", 9) / "run.json").write_text("{}")
    assert lost_of(results, capsys)[0].startswith("01-messages.old-1: measured again, and its record cannot be read")


def test_a_run_that_was_deleted_is_known_from_the_journal(results, capsys):
    closed(results, "01-messages", "02-messages", "03-messages")
    assert lost_of(results, capsys) == ["03-messages: closed 1 time by the journal, 0 of them are here"]


def test_so_is_an_attempt_that_was_measured_again(results, capsys):
    closed(results, "01-messages", "01-messages", "02-messages")
    assert lost_of(results, capsys) == ["01-messages: closed 2 times by the journal, 1 of them is here"]


def test_without_a_journal_the_numbers_tell(results, capsys):
    shutil.move(results / "02-messages", results / "04-messages")
    whys = [f"number {number}: there is no such run, and no journal" for number in (2, 3)]
    assert lost_of(results, capsys) == whys
    (results / NAME).write_bytes(b"garbage" * 1000)
    assert lost_of(results, capsys) == whys


def test_a_restart_after_the_end_of_a_run_loses_nothing(results, capsys):
    with closing(open_journal(results, "test", "1:plan", "board")) as log:
        for run in ("01-messages", "02-messages"):
            log.note("2026-11-21T10:01:00+00:00", run, RunState.CLOSED, "ok")
        log.note("2026-11-21T10:01:01+00:00", "02-messages", RunState.CLOSED, "board: was restarted")
    assert lost_of(results, capsys) == []


def noted(results, run, *events):
    """A journal by which both runs that are here were closed, and this became of another attempt at one."""
    closed(results, "01-messages", "02-messages")
    with closing(open_journal(results, "test", "1:plan", "board")) as log:
        for what, reason in events:
            log.note("2026-11-21T11:00:00+00:00", run, what, reason)


BEGUN = ((RunState.STARTING, None), (RunState.LAUNCHING, None), (RunState.MEASURING, None))


@pytest.mark.parametrize(
    ("events", "why"),
    [
        ([*BEGUN, (RunState.PLANNED, "took longer than it may: sh")], ["took longer than it may: sh"]),
        (BEGUN, ["begun and never closed"]),
        (BEGUN[:2], ["begun and never closed"]),
        ([*BEGUN, (RunState.CUT_OFF, "x")], ["cut off by a restart of the target"]),
        (
            [*BEGUN, (RunState.CUT_OFF, "x"), (RunState.PLANNED, "kept as 01-messages.incomplete-1")],
            ["cut off by a restart of the target, and what was kept of it is not here"],
        ),
        ([*BEGUN, (RunState.PLANNED, "interrupted")], []),
        (BEGUN[:1], []),
        ([(RunState.STARTING, None), (RunState.PLANNED, "nothing was measured: no space")], []),
    ],
)
@pytest.mark.parametrize("run", ["01-messages", "03-messages", "03-messages.warm-up"])
def test_what_left_no_record_counts_unless_its_end_is_known(results, run, events, why, capsys):
    noted(results, run, *events)
    assert lost_of(results, capsys) == [f"{run}: {reason}" for reason in why if "warm-up" not in run]


def test_what_a_killed_runner_closed_is_no_loss(results, capsys):
    """It had no time to say so."""
    noted(results, "03-messages", *BEGUN)
    write(results, "03-messages", 3)
    assert lost_of(results, capsys) == []


def test_what_is_cut_off_counts_whether_it_is_closed_later_or_not(results, capsys):
    noted(results, "03-messages", *BEGUN, (RunState.CUT_OFF, "x"))
    (results / "03-messages.incomplete-1").mkdir()
    assert lost_of(results, capsys) == ["03-messages.incomplete-1: cut off by a restart of the target"]


def test_what_goes_on_is_not_lost_yet(results, capsys):
    noted(results, "03-messages", *BEGUN)
    with at_work(results):
        assert lost_of(results, capsys) == []
    assert lost_of(results, capsys) == ["03-messages: begun and never closed"]


def test_a_run_whose_record_was_removed_counts(results, capsys):
    closed(results, "01-messages", "02-messages", "03-messages", "03-messages")
    for name in ("03-messages", "03-messages.old-1"):
        (write(results, name, 3) / "run.json").unlink()
    assert lost_of(results, capsys) == 2 * ["03-messages: closed 2 times by the journal, 0 of them are here"]


def test_another_kind_is_not_concerned_by_what_left_no_record(results, capsys):
    """Nor is what it would have measured, whatever target the next attempt was on."""
    noted(results, "03-messages", *BEGUN)
    write(results, "03-messages", 3, condition="cpu80")
    write(results, "04-messages", 4, condition="cpu80")
    with closing(open_journal(results, "test", "1:plan", "board")) as log:
        log.note("2026-11-21T11:00:00+00:00", "03-messages", RunState.STARTING)
        log.note("2026-11-21T11:00:00+00:00", "03-messages", RunState.CLOSED, "ok")
    capsys.readouterr()
    assert main(["verdict", str(results), *QUESTION, "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    lost = {group["runs"][0]: group["verdict"]["lost"] for group in groups}
    assert lost == {"01-messages": [], "03-messages": ["03-messages: begun and never closed"]}


@pytest.mark.parametrize("name", ["03-graph", "01-graph.old-1"])
def test_a_topology_that_hung_counts_for_each_of_its_streams(tmp_path, name, capsys):
    """A graph has no stream that is judged, but those of its nodes."""
    for number in (1, 2):
        write(tmp_path, f"{number:02}-graph", number, condition="cpu80")
        write(tmp_path, f"{number:02}-graph-scan", 10 + number, observed_by=f"{number:02}-graph")
    write(tmp_path, "00-other", 4, condition="io")
    write(tmp_path, name, 3, condition="cpu80", status="failed", reason="it hung")
    assert main(["verdict", str(tmp_path), *QUESTION, "--json"]) == 0
    lost = {group["runs"][0]: group["verdict"]["lost"] for group in json.loads(capsys.readouterr().out)["groups"]}
    assert {run: len(reasons) for run, reasons in lost.items()} == {"01-graph": 1, "01-graph-scan": 1, "00-other": 0}


def test_an_observation_that_was_killed_counts_though_it_left_nothing_but_its_number(tmp_path, capsys):
    for number in (1, 3):
        write(tmp_path, f"{number:03}-messages", number)
    taken = tmp_path / ".002.taken"
    taken.mkdir()
    (taken / "begun").touch()
    assert lost_of(tmp_path, capsys) == ["002: begun and never closed"]
    held = os.open(taken, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    assert lost_of(tmp_path, capsys) == [], "it goes on"
    os.close(held)
