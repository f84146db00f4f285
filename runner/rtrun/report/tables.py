"""A table as text for every format, and how it is laid out on a screen."""

import math
import textwrap
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from rtfiles.output import printable

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.text import Text

# Answers, and pass or FAIL, in their colours, which only a terminal shows. No line break divides them.
STYLES = {
    "PROVEN": "green",
    "PROVEN IF INDEPENDENT": "yellow",
    "NEEDS MORE": "yellow",
    "REFUTED": "bold red",
    "NOT ANALYSED": "bold red",
    "WORSE": "bold red",
    "PERHAPS WORSE": "yellow",
    "pass": "green",
    "passed": "green",
    "FAIL": "bold red",
    "failed": "bold red",
    "confirmed": "green",
    "refuted": "bold red",
}


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of text; cells in the columns `numbers` hold numbers. ``notes`` come below it.

    `how` names the explanation of how its figures are computed (report/how.py). `outcome` is the result in one line.
    ``parts[k]`` are the rows that row k sums up, if any. `gap` are the spaces between two cells on a screen.
    """

    id: str = ""
    title: str = ""
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    outcome: str = ""
    parts: Mapping[int, Sequence[tuple[str, ...]]] = field(default_factory=dict)
    numbers: Container[int] = ()
    notes: tuple[str, ...] = ()
    how: str = ""
    gap: int = 2

    def as_data(self) -> dict[str, object]:
        """For programs: the rows by column name."""
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return {"outcome": self.outcome, "rows": rows, "notes": self.notes}

    def __rich_console__(self, console: "Console", options: "ConsoleOptions") -> "Iterator[Text]":
        """Its lines on a console, as rich asks for them."""
        return self.lines(options.max_width)

    def lines(self, width: float = math.inf) -> "Iterator[Text]":
        """The headings and rows on a screen of this width; numbers and answers stay whole.

        If the words do not fit next to each other, each row becomes a list of headings and cells.
        """
        rows = [_printable(row) for row in self.rows]
        columns = [*enumerate(zip(self.columns, *rows, strict=True))]
        widths = [
            max([_word(heading), *map(len if place in self.numbers else _word, cells)])
            for place, (heading, *cells) in columns
        ]
        missing = [max(map(len, column)) - widths[k] for k, column in columns]
        gaps = self.gap * (len(columns) - 1)
        spare = width - sum(widths) - gaps
        if spare < 0:
            yield from self._listed(rows, int(width))
            return
        # Spare width goes to the text that lacks most, so that few cells take several lines, then to other headings.
        while spare > 0 and any(missing):
            place = min((k for k, lack in enumerate(missing) if lack), key=lambda k: (k in self.numbers, -missing[k]))
            widths[place], missing[place], spare = widths[place] + 1, missing[place] - 1, spare - 1
        yield from self._row(self.columns, widths, is_heading=True)
        yield _text("─" * (sum(widths) + gaps))
        for cells in rows:
            yield from self._row(cells, widths)

    def _row(self, cells: Sequence[str], widths: Sequence[int], *, is_heading: bool = False) -> "Iterator[Text]":
        parts = [_wrapped(cell, width) for cell, width in zip(cells, widths, strict=True)]
        height = max(map(len, parts))
        for number in range(height):
            line = _text("")
            for place, (part, width) in enumerate(zip(parts, widths, strict=True)):
                at = number - (height - len(part) if is_heading else 0)
                text = part[at] if 0 <= at < len(part) else ""
                line.append(" " * self.gap * bool(place))
                line.append(f"{text:{'>' if place in self.numbers else '<'}{width}}", STYLES.get(cells[place], ""))
            line.rstrip()
            yield line

    def _listed(self, rows: Sequence[Sequence[str]], width: int) -> "Iterator[Text]":
        """A line for each cell that is not empty, and an empty line between two rows."""
        indent = max(map(len, self.columns)) + self.gap
        for number, row in enumerate(rows):
            if number:
                yield _text("")
            for heading, cell in zip(self.columns, row, strict=True):
                for place, part in enumerate(_wrapped(cell, max(1, width - indent)) if cell else ()):
                    yield _text(("" if place else heading).ljust(indent)).append(part, STYLES.get(cell, ""))


def _text(text: str) -> "Text":
    from rich.text import Text

    return Text(text)


def _word(text: str) -> int:
    """The length of the longest word; an answer counts as one word."""
    return len(text) if text in STYLES else max(map(len, text.split()), default=0)


def _wrapped(text: str, width: int) -> list[str]:
    return [text] if len(text) <= width else textwrap.wrap(text, width, break_on_hyphens=False)


def printable_table(table: Table) -> Table:
    """The table without terminal commands and characters that cannot be encoded: much in it comes from a target."""
    return replace(
        table,
        rows=[_printable(row) for row in table.rows],
        outcome=printable(table.outcome),
        parts={place: [_printable(row) for row in rows] for place, rows in table.parts.items()},
        notes=_printable(table.notes),
    )


def _printable(texts: Sequence[str]) -> tuple[str, ...]:
    return tuple(map(printable, texts))
