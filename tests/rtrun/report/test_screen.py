"""Tables on screens of every width: no word is broken, and answers have their colours on a terminal alone."""

import io
import os
import pty
import subprocess
import sys

import pytest
from rich.console import Console

from rtrun.report.tables import Table

HEADINGS = ("group", "answer", "P(miss)", "measured", "missing")
ROWS = [
    ("communication RR 100 Hz 200 B 5 sub", "NEEDS MORE", "5.7e-05 to 0.07", "3 668 879", "nothing but ksoftirqd/0"),
    ("cyclic_timer FIFO", "REFUTED", "<= 0.00018", "12", ""),
]
WORDS = {word for row in ROWS for cell in (row[0], row[4]) for word in cell.split()}
WHOLE = [cell for row in ROWS for cell in row[1:4]]


@pytest.mark.parametrize("width", [30, 40, 60, 65, 66, 72, 80, 100, 120, 200])
def test_no_word_is_broken_at_any_width(width: int) -> None:
    stream = io.StringIO()
    Console(file=stream, width=width).print(Table(columns=HEADINGS, rows=ROWS, numbers=range(2, 4)))
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert all(cell in text for cell in WHOLE)
    assert set(text.replace("─", "").split()) >= WORDS
    # A row is one line from where the longest words fit: as wide as they are, with two between each.
    assert (all(heading in text.splitlines()[0] for heading in HEADINGS)) == (width >= 13 + 10 + 15 + 9 + 11 + 4 * 2)


VERDICT = [sys.executable, "-m", "rtrun.cli", "verdict"]


@pytest.mark.parametrize("width", ["60", "140"])
def test_columns_is_honoured_in_a_pipe(campaign, width: str) -> None:
    environment = os.environ | {"COLUMNS": width}
    done = subprocess.run(
        [*VERDICT, campaign, "--deadline", "400us"], env=environment, capture_output=True, text=True, check=True
    )
    assert "\x1b" not in done.stdout and "…" not in done.stdout
    (headings,) = (line for line in done.stdout.splitlines() if line.startswith("group"))
    assert ("P(miss)" in headings) == (width == "140")


def test_answers_have_colours_on_a_terminal(campaign) -> None:
    ours, theirs = pty.openpty()
    environment = {key: value for key, value in os.environ.items() if key != "NO_COLOR"} | {"TERM": "xterm"}
    with subprocess.Popen([*VERDICT, campaign, "--deadline", "400us"], env=environment, stdout=theirs) as process:
        os.close(theirs)
        shown = b""
        while chunk := _read(ours):
            shown += chunk
        assert process.wait() == 0
    assert b"\x1b[1;31mREFUTED" in shown and b"\x1b[33mNEEDS MORE" in shown


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:
        # The other end of a terminal closes in this way.
        return b""


@pytest.mark.parametrize("command", ["verdict", "claims", "report", "why"])
def test_progress_is_shown_on_a_terminal_and_gone_at_the_end(campaign, tmp_path, command: str) -> None:
    ours, theirs = pty.openpty()
    output = ["--output", str(tmp_path / "report.html")] if command == "report" else []
    argv = [sys.executable, "-m", "rtrun.cli", command, str(campaign), *output]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        while chunk := _read(ours):
            shown += chunk
        process.communicate()
    steps = shown.split(b"\r\x1b[K")
    assert b" run 1 of " in shown and steps[-1] == b"" and b"\n" not in shown
