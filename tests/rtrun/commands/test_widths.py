"""What every command prints at four widths: no table is wider than the screen, and nothing of it is lost."""

import io
import re
import sys

import pytest
from archive.archived import write_course
from commands.test_json import COMMANDS
from labgrid_farm import farm_of
from rich.console import Console

from rtfiles.output import surviving_output
from rtrun.cli import main
from rtrun.report.tables import Table

WIDTHS = (60, 80, 120, 200)
# What is imported once is not imported again.
TABLES = [command for command in COMMANDS if not command.startswith("import")]
TABLES += ["verdict runs --deadline 100us", "report runs --deadline 100us", "plan reference-system"]


@pytest.mark.parametrize("command", TABLES)
def test_a_table_fits_the_screen_and_loses_nothing(folder, capsys, monkeypatch, command):
    """Lines of text are not broken, so that what they name can be copied."""
    monkeypatch.chdir(folder)
    fits(command, capsys, monkeypatch)


def fits(command, capsys, monkeypatch):
    lines_of, in_tables = Table.lines, []

    def lines(table, width=1000):
        for line in lines_of(table, width):
            in_tables.append(line.plain)
            yield line

    monkeypatch.setattr(Table, "lines", lines)
    characters = []
    for width in WIDTHS:
        monkeypatch.setenv("COLUMNS", str(width))
        in_tables.clear()
        main(command.split())
        printed = capsys.readouterr().out
        assert max(map(len, in_tables), default=0) <= width
        assert all(line in printed.splitlines() for line in in_tables)
        characters.append(sorted(re.sub(r"[─\s]", "", printed)))
        assert characters[-1] == characters[0]
        if not in_tables:
            break


@pytest.mark.parametrize("command", TABLES)
def test_a_terminal_without_unicode_shows_no_question_marks(folder, monkeypatch, command):
    monkeypatch.chdir(folder)
    assert not re.search(r"\?\S", ascii_of(command, monkeypatch))


def ascii_of(command, monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    with surviving_output():
        main(command.split())
    text = raw.getvalue().decode("ascii")
    assert text.strip()
    return text


def test_the_places_of_a_farm_fit_the_screen(tmp_path, capsys, monkeypatch):
    """A real coordinator: one place was measured on, one is ill, one is offered by nobody."""
    pytest.importorskip("labgrid", reason="the extra farm is not installed")
    facts = [{"kernel": "6.12.48-rt", "temperature_mc": 61_000}]
    write_course(tmp_path / "archive", [100.0], machine="panda-1", facts=facts, parameters={"middleware": "rclcpp"})
    service = {"NetworkService": {"address": "127.0.0.1", "username": "root"}}
    offered = {"panda-1": service, "panda-2": service, "away-1": {}}
    with farm_of(tmp_path, offered, {"quarantine": "2026-01-09_127.0.0.1_does_not_answer"}) as farm:
        monkeypatch.setenv("LG_COORDINATOR", farm.coordinator)
        monkeypatch.chdir(tmp_path)
        fits("farm --archive archive", capsys, monkeypatch)
        fits("farm", capsys, monkeypatch)
        text = ascii_of("farm --archive archive", monkeypatch)
    assert "61.0" in text and "?" not in text


def drawn(table, width, **options):
    screen = io.StringIO()
    Console(file=screen, width=width, **options).print(table)
    return screen.getvalue()


WIDE = Table(
    columns=("place", "kernel", "worst", "lost"),
    rows=[("a board of a farm", "PREEMPT_RT 6.12.30-rt", "1.234 ms", "12"), ("b", "", "1 us", "")],
    numbers=(2, 3),
)


def test_what_does_not_fit_is_broken_into_lines_of_columns():
    assert drawn(WIDE, 28).splitlines() == [
        "place        kernel",
        "     worst  lost",
        "────────────────────────────",
        "a board of   PREEMPT_RT",
        "  a farm       6.12.30-rt",
        "  1.234 ms    12",
        "b",
        "      1 us",
    ]
    assert len(drawn(WIDE, 60).splitlines()) == 4


@pytest.mark.parametrize("width", [1, 5, 12, 30, 45, 60, 200])
def test_no_width_loses_a_character(width):
    lines = drawn(WIDE, width).splitlines()
    assert max(map(len, lines)) <= width
    expected = "".join(("".join(WIDE.columns), *map("".join, WIDE.rows))).replace(" ", "")
    assert sorted("".join(lines).replace(" ", "").replace("─", "")) == sorted(expected)


def test_colour_changes_no_line():
    table = Table(columns=("answer", "n"), rows=[("PROVEN IF INDEPENDENT", "12")], numbers=(1,))
    coloured = drawn(table, 40, force_terminal=True, color_system="standard", legacy_windows=False)
    assert "\x1b[" in coloured
    assert re.sub(r"\x1b\[[0-9;]*m", "", coloured) == drawn(table, 40)
