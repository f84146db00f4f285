"""Boards that failed, are offline, in quarantine or new, when each was last seen: on the page, in metrics, told."""

import html
import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from archive.archived import write_course, write_failed
from labgrid_farm import farm_of
from report.campaigns import latencies, oneshot_run
from written import close

from ports import free_port
from rtrun.archive.alarms import board_alarms
from rtrun.archive.fleet import Farm, boards_of, counts_in_words
from rtrun.archive.notes import Notes
from rtrun.archive.runs import read_archive
from rtrun.archive.store import open_archive
from rtrun.cli import main
from rtrun.targets.labgrid.coordinator import LabgridPlace, OfferedResource

SCENARIO = "oneshot_timer RR 1000 us"
DEAD = datetime(2026, 1, 17, 1, 30)
ESCAPE = "\x1b"
DIED = f"node died <b>{ESCAPE}[2J"


@pytest.fixture
def archive(tmp_path):
    """`board` failed three times since its last good run, `dead` as often without an answer, `young` has two boots."""
    write_course(tmp_path / "archive", [100.0] * 8, machine="board")
    write_course(tmp_path / "archive", [100.0] * 8, machine="dead", seed=2)
    write_course(tmp_path / "archive", [100.0] * 2, machine="young", seed=3)
    # One that failed before the last good run is of the past.
    write_failed(tmp_path / "archive", datetime(2026, 1, 3), "long ago", boot_id="x")
    for day in (17, 18, 19):
        write_failed(tmp_path / "archive", DEAD.replace(day=day), DIED, boot_id=f"boot {day}")
        write_failed(tmp_path / "archive", DEAD.replace(day=day), "no route to host", machine="dead")
    return tmp_path / "archive"


def place(name, *, matches=(), **tags):
    return LabgridPlace(name=name, tags=tags, matches=matches, holder=None, reservation=None)


def offers(group):
    return OfferedResource(
        exporter="bench", group=group, kind="NetworkService", name="NetworkService", is_available=True
    )


def alarms_of(boards, kind):
    return {alarm.about: alarm for alarm in board_alarms(boards, Notes(held={})) if alarm.kind == kind}


def test_what_failed_is_told_once_for_each_row_of_failures(archive):
    boards = boards_of(read_archive(open_archive(str(archive))).runs, None)
    assert [board.board for board in boards] == ["board", "dead", "young"]
    failed = alarms_of(boards, "failed")
    assert failed.keys() == {f"{SCENARIO} on board", f"{SCENARIO} on dead"}
    alarm = failed[f"{SCENARIO} on board"]
    assert alarm.size == f"failed: {DIED} (3 runs in a row)"
    assert alarm.since == "2026-01-17 01:30 UTC; last seen 2026-01-19 01:30 UTC"
    assert failed[f"{SCENARIO} on dead"].since.endswith("; last seen 2026-01-08 11:00 UTC")
    # Another one is no news; one after a good run is.
    write_failed(archive, DEAD.replace(day=20), "again", boot_id="x")
    again = alarms_of(boards_of(read_archive(open_archive(str(archive))).runs, None), "failed")[f"{SCENARIO} on board"]
    assert again.key == alarm.key and "again (4 runs in a row)" in again.size
    write_course(archive, [100.0] * 22, machine="board")
    assert f"{SCENARIO} on board" not in alarms_of(
        boards_of(read_archive(open_archive(str(archive))).runs, None), "failed"
    )
    write_failed(archive, DEAD.replace(day=28), "again", boot_id="x")
    again = alarms_of(boards_of(read_archive(open_archive(str(archive))).runs, None), "failed")[f"{SCENARIO} on board"]
    assert again.key != alarm.key


@pytest.mark.parametrize("status", ["failed", "incomplete", "invalid"])
def test_every_status_but_ok_is_a_failure(tmp_path, status):
    write_failed(tmp_path / "archive", DEAD, None, status=status)
    (board,) = boards_of(read_archive(open_archive(str(tmp_path / "archive"))).runs, None)
    assert [scenario.reason for scenario in board.failed] == [status] and board.is_ill and board.is_new
    assert board.last_seen is None and board.last_run == DEAD


def test_what_the_farm_says(archive):
    places = [
        place("board", matches=("bench/board/*",), quarantine="fan_broken"),
        place("dead", matches=("bench/dead/*",), failed_check="2026-01-18_no_route"),
        place("spare", matches=("bench/spare/*",), quarantine="2026-11-24_connection_refused"),
    ]
    runs = read_archive(open_archive(str(archive))).runs
    boards = boards_of(runs, Farm(places=places, offered=[offers("board"), offers("spare")]))
    assert [(board.board, board.is_ill) for board in boards] == [
        ("board", True), ("dead", True), ("spare", True), ("young", False),
    ]  # fmt: skip
    quarantine = alarms_of(boards, "quarantine")
    assert [board.states for board in boards] == [
        ["QUARANTINE", "FAILED"], ["OFFLINE", "FAILED"], ["QUARANTINE", "NEW"], ["NEW"],
    ]  # fmt: skip
    manual, checked = quarantine["board"], quarantine["spare"]
    assert manual.size == "fan broken" and "check" not in f"{manual.since}{manual.size}"
    assert manual.since == "not known: its tag has no day; last seen 2026-01-19 01:30 UTC"
    assert checked.size == "connection refused (since 2026-11-24)"
    assert checked.since == "2026-11-24; never seen in a run"
    (offline,) = alarms_of(boards, "offline").values()
    assert offline.about == "dead" and "the exporter bench ended" in offline.size
    assert "last seen 2026-01-08 11:00 UTC" in offline.since
    assert alarms_of(boards, "new").keys() == {"young", "spare"}


def test_the_state_of_each_board_at_a_glance(archive):
    """A board that somebody holds measures; one that failed in the past does not fail now, and its failure is told."""
    write_course(archive, [100.0] * 22, machine="board")
    places = [
        replace(place("board", matches=("bench/board/*",)), holder="runner/rtlab"),
        place("young", matches=("bench/young/*",)),
    ]
    runs = read_archive(open_archive(str(archive))).runs
    boards = boards_of(runs, Farm(places=places, offered=[offers("board"), offers("young")]))
    assert {board.board: board.states for board in boards} == {
        "board": ["MEASURING"], "dead": ["FAILED"], "young": ["NEW", "IDLE"],
    }  # fmt: skip
    assert counts_in_words(boards) == "3 boards: 1 failed in the last run, 1 new, 1 measuring, 1 idle"
    (board,) = (board for board in boards if board.board == "board")
    assert not board.failed and board.last_failed.reason == DIED


def test_a_board_is_described_by_its_last_run_that_knows(tmp_path):
    """Its target.json names processor, memory and command line; a run that lacks it, or is damaged, changes nothing."""
    cpuinfo = "processor\t: 0\nmodel name\t: ARMv7 Processor rev 10 (v7l)\n\nHardware\t: OMAP4 PandaBoard\n"
    state = {"cpuinfo": cpuinfo, "memory": "MemTotal:        1011852 kB\nMemFree: 1 kB", "cmdline": "isolcpus=1 <b>"}
    results, archive = tmp_path / "results", str(tmp_path / "archive")
    for number, extra in enumerate(({"before": state, "after": {}, "own_service": False}, None, {"before": 7})):
        start = f"2026-10-0{number + 1}T10:00:00Z"
        folder = oneshot_run(results, f"{number}", latencies(100, number), start_time=start)
        if extra:
            (folder / "target.json").write_text(json.dumps({"schema": 1, **extra}))
            close(folder, "target.json")
    assert main(["archive", "add", str(results), "--to", archive, "--image", "rt-1"]) == 0
    assert main(["archive", "compact", archive]) == 0
    (board,) = boards_of(read_archive(open_archive(archive)).runs, None)
    processor = "OMAP4 PandaBoard, ARMv7 Processor rev 10 (v7l)"
    assert board.description == [processor, "2 CPUs", "988 MiB of memory", "kernel 6.1.0-rt", "image rt-1"]
    assert board.command_line == "isolcpus=1 <b>" and len(board.rows) == 3
    assert main(["site", archive, "--output", str(tmp_path / "pages")]) == 0
    assert "<code>isolcpus=1 &lt;b&gt;</code>" in (tmp_path / "pages" / "boards.html").read_text()


def test_offline_again_after_it_was_measured_is_told_again(archive):
    farm = Farm(places=[place("dead", matches=("bench/dead/*",))], offered=[])
    runs = read_archive(open_archive(str(archive))).runs
    first = alarms_of(boards_of(runs, farm), "offline")["dead"]
    write_failed(archive, DEAD.replace(day=20), "again", machine="dead")
    runs = read_archive(open_archive(str(archive))).runs
    assert alarms_of(boards_of(runs, farm), "offline")["dead"].key == first.key, "it did not answer"
    write_course(archive, [100.0] * 9, machine="dead", seed=2)
    runs = read_archive(open_archive(str(archive))).runs
    assert alarms_of(boards_of(runs, farm), "offline")["dead"].key != first.key


def site(capsys, archive, *words, status=0):
    pages = archive.parent / "pages"
    assert main(["site", str(archive), "--output", str(pages), *words]) == status
    return pages, capsys.readouterr().err


def rows(page, table):
    """The texts of the cells of a table of a page."""
    body = re.search(rf'<table class="{table}">.*?<tbody>(.*?)</tbody>', page, re.S)[1]
    return [
        [html.unescape(re.sub("<.*?>", "|", cell)).strip("|") for cell in re.findall("<td.*?>(.*?)</td>", row)]
        for row in body.split("</tr>")
        if "<td" in row
    ]


def metrics(pages):
    text = (pages / "metrics.txt").read_text()
    return dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))


def test_the_page_and_the_metrics_without_a_farm(capsys, archive, monkeypatch):
    monkeypatch.delenv("LG_COORDINATOR", raising=False)
    pages, _ = site(capsys, archive)
    page = (pages / "boards.html").read_text()
    failed, last = "✗ FAILED: 1 of 1 scenario", f"2026-01-19 01:30 {SCENARIO}: failed"
    assert [[cell.replace(ESCAPE, "?").replace("|b|", "<b>") for cell in row] for row in rows(page, "health")] == [
        ["board| |kernel 6.1", failed, "2026-01-19 01:30", "2026-01-19 01:30", f"{last}: {DIED.replace(ESCAPE, '?')}"],
        ["dead| |kernel 6.1", failed, "2026-01-08 11:00", "2026-01-19 01:30", f"{last}: no route to host"],
        ["young| |kernel 6.1", "? NEW: 2 boots of 6", "2026-01-02 11:00", "2026-01-02 11:00", ""],
    ]
    assert [row[:2] + row[3:] for row in rows(page, "failed")] == [
        [name, SCENARIO, "2026-01-19 01:30", "3", "2026-01-17 01:30", "0130-oneshot"] for name in ("board", "dead")
    ]
    assert "failed: node died &lt;b&gt;" in page and "no labgrid coordinator was asked" in page
    front = (pages / "index.html").read_text()
    assert "3 boards: 2 failed in the last run, 1 new" in front and "idle</a>" not in front
    known = metrics(pages)
    of_board = f'{{scenario="{SCENARIO}",machine="%s",platform="hardware"}}'
    assert [known[f"rtrun_run_failed{of_board % name}"] for name in ("board", "dead", "young")] == ["1", "1", "0"]
    assert known['rtrun_board_failed_scenarios{machine="dead"}'] == "1"
    assert known['rtrun_board_new{machine="young"}'] == "1" and known['rtrun_board_new{machine="board"}'] == "0"
    seen = datetime(2026, 1, 8, 11, tzinfo=UTC).timestamp()
    assert float(known['rtrun_board_last_seen_time_seconds{machine="dead"}']) == seen
    assert not any("offline" in name or "quarantined" in name for name in known)


def test_an_archive_in_which_every_run_failed_has_a_site(capsys, tmp_path):
    write_failed(tmp_path / "archive", DEAD, DIED)
    pages, _ = site(capsys, tmp_path / "archive")
    assert [row[:2] for row in rows((pages / "boards.html").read_text(), "failed")] == [["board", SCENARIO]]
    assert metrics(pages)['rtrun_board_failed_scenarios{machine="board"}'] == "1"


def test_names_that_look_alike_in_the_metrics_are_one_sample(capsys, tmp_path):
    """Prometheus refuses all of a page in which two samples have the same labels."""
    for number, name in enumerate(("a\x1b", "a\x07", "a?")):
        write_failed(tmp_path / "archive", DEAD, None, machine=name, boot_id="x" if number else None)
    pages, _ = site(capsys, tmp_path / "archive")
    lines = (pages / "metrics.txt").read_text().splitlines()
    assert len(lines) == len({*lines}) and 'rtrun_board_new{machine="a?"} 1' in lines


@pytest.fixture
def lab(tmp_path, archive):
    """A real coordinator and exporter, where `dead` has none, and a receiver."""
    pytest.importorskip("labgrid", reason="the extra farm")
    (tmp_path / "farm").mkdir()
    service = {"NetworkService": {"address": "127.0.0.1", "username": "x"}}
    with farm_of(tmp_path / "farm", {"board": service, "dead": {}, "young": service}, {}) as farm:
        farm.client("-p", "board", "set-tags", "quarantine=fan_broken")
        log = {"name": "log", "kind": "command", "command": ["sh", "-c", f"cat >>{tmp_path}/heard"]}
        config = {"schema": 1, "coordinator": farm.coordinator, "receivers": [log]}
        (tmp_path / "lab.yml").write_text(json.dumps(config))
        yield farm


def test_a_real_farm_on_the_page_in_the_metrics_and_told(capsys, archive, lab, tmp_path):
    pages, _ = site(capsys, archive, "--coordinator", lab.coordinator)
    page = (pages / "boards.html").read_text()
    states = {row[0].partition("|")[0]: row[1] for row in rows(page, "health")}
    assert (
        "IDLE" in states["young"]
        and "QUARANTINE: fan broken" in states["board"]
        and "FAILED: 1 of 1" in states["board"]
    )
    assert "OFFLINE: nobody offers bench/dead/*" in states["dead"] and "no labgrid coordinator" not in page
    known = metrics(pages)
    for name, offline, quarantined in (("board", "0", "1"), ("dead", "1", "0"), ("young", "0", "0")):
        assert known[f'rtrun_board_offline{{machine="{name}"}}'] == offline
        assert known[f'rtrun_board_quarantined{{machine="{name}"}}'] == quarantined
    notify = ["notify", str(tmp_path / "lab.yml"), str(archive)]
    assert main(notify) == 0 and "4 things wrong" in capsys.readouterr().out
    heard = (tmp_path / "heard").read_text()
    assert heard.startswith("2 scenarios failed, 1 board offline, 1 board in quarantine, 1 board new\n")
    for text in (
        "FAILED  oneshot",
        "OFFLINE  dead",
        "QUARANTINE  board\n  fan broken\n",
        "NEW  young",
        "last seen 2026",
    ):
        assert text in heard
    assert "second failed check" not in heard
    assert main(notify) == 0 and (tmp_path / "heard").read_text() == heard, "once each"
    annotate = ["archive", "annotate", str(archive), "--known", "--machine", "bo*", "--reason", "ticket 7"]
    assert main([*annotate, "--scenario", "*"]) == 0
    capsys.readouterr()
    assert main(notify) == 0 and f"known: {SCENARIO} on board: ticket 7" in capsys.readouterr().out


def test_a_coordinator_that_is_gone_hides_nothing(capsys, archive, tmp_path, monkeypatch):
    gone = f"127.0.0.1:{free_port()}"
    monkeypatch.setenv("LG_COORDINATOR", gone)
    pages, printed = site(capsys, archive, status=3)
    page = (pages / "boards.html").read_text()
    assert gone in printed and "Which boards are offline or in quarantine is not known: " in page and gone in page
    assert len(rows(page, "failed")) == 2
    log = {"name": "log", "kind": "command", "command": ["sh", "-c", f"cat >>{tmp_path}/heard"]}
    config = {"schema": 1, "coordinator": gone, "receivers": [log]}
    Path(tmp_path / "lab.yml").write_text(json.dumps(config))
    assert main(["notify", str(tmp_path / "lab.yml"), str(archive)]) == 3
    assert gone in capsys.readouterr().err and "2 scenarios failed" in (tmp_path / "heard").read_text()


def test_a_coordinator_that_is_no_host_is_refused(capsys, archive):
    assert main(["site", str(archive), "--output", str(archive.parent / "x"), "--coordinator", "a..b:1"]) == 2
    assert "--coordinator" in capsys.readouterr().err
