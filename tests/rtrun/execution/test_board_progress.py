"""Progress of several boards on a terminal: short names, whole lines, rows that fit."""

import re

import pytest

from rtfiles.output import console
from rtrun.execution.board_progress import showing_boards
from rtrun.plan.campaign import Campaign, plan

ENTRY = {"suite": "communication_tests", "payload_bytes": [64, 1024]}
RUNS = plan(Campaign(schema=1, name="test", runs=[ENTRY]), "test")
REASON = f"/a/{'long/' * 30}path: no"


@pytest.fixture
def drawn(capsys, monkeypatch, request):
    """What a terminal of this width shows: a run that failed on a board, another one goes on, and a board is lost."""
    monkeypatch.setenv("COLUMNS", str(request.param))
    monkeypatch.setenv("FORCE_COLOR", "1")
    with showing_boards(["left", "right"], RUNS, console()) as boards:
        boards["left"].began(0, RUNS[0])
        boards["left"].ended(0, RUNS[0], "failed", REASON)
        boards["left"].began(1, RUNS[1])
        boards["right"].left(REASON)
    return request.param, capsys.readouterr().out


@pytest.mark.parametrize("drawn", [60, 80], indirect=True)
def test_rows_fit_and_what_is_printed_above_them_stays_whole(drawn):
    width, text = drawn
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text).replace("\r", "\n").splitlines()
    rows = [line for line in lines if "\N{BOX DRAWINGS HEAVY HORIZONTAL}" in line]
    assert rows and max(map(len, rows)) <= width
    assert any(
        re.fullmatch(rf"failed     left         communication 64 B  \d+\.\d s: {REASON}", line) for line in lines
    )
    assert f"rtrun: right: {REASON}: the other boards measure what it leaves" in lines
    assert any("communication 1024 B" in row for row in rows)


@pytest.mark.parametrize("drawn", [80], indirect=True)
def test_the_bar_of_a_board_that_failed_stands_still(drawn):
    assert re.search(r"m\N{BOX DRAWINGS HEAVY HORIZONTAL}{12}\x1b\[0m failed", drawn[1])
