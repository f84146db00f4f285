"""A table as text for every format, and how it is laid out on a screen."""

import math
import re
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
_THOUSANDS = re.compile(r"(?<=\d) (?=\d{3}\b)")
_KEPT = "\N{NO-BREAK SPACE}"


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

        If the words do not fit next to each other, headings and each row take several lines, all but the first
        indented; columns stay columns. Headings are left out if there is none.
        """
        rows = [_printable(row) for row in self.rows]
        columns = [*zip(self.columns, *rows, strict=True)]
        bands = self._bands(columns, width)
        if any(self.columns):
            yield from self._row(self.columns, bands, is_heading=True)
            yield _text("─" * max(indent + self._width(widths) for indent, widths in bands))
        for cells in rows:
            yield from self._row(cells, bands)

    def _bands(self, columns: Sequence[Sequence[str]], width: float) -> list[tuple[int, dict[int, int]]]:
        """The lines that a row takes: the indent of each, and the widths of its columns by their places."""
        least = [
            max([_word(heading), *map(len if place in self.numbers else _word, cells)])
            for place, (heading, *cells) in enumerate(columns)
        ]
        # The names of rows have a line of their own, before their numbers, unless that takes more lines.
        names = next((place for place in range(len(least)) if place in self.numbers), 0)
        is_narrow = self._width(dict(enumerate(least))) > width
        bands = min((self._divided(least, width, last) for last in ([names, 0] if is_narrow else [0])), key=len)
        for indent, widths in bands:
            missing = {place: max(map(len, columns[place])) - widths[place] for place in widths}
            spare = width - indent - self._width(widths)
            # Spare width goes to a short first column, which names the rows; then to the text that lacks most, so that
            # few cells take several lines; then to other headings.
            first = 0 if missing.get(0, 0) + widths.get(0, 0) <= width / 3 else None
            while spare > 0 and any(missing.values()):
                lacking = (place for place, lack in missing.items() if lack)
                place = min(lacking, key=lambda column: (column in self.numbers, column != first, -missing[column]))
                widths[place], missing[place], spare = widths[place] + 1, missing[place] - 1, spare - 1
        return bands

    def _divided(self, least: Sequence[int], width: float, end: int) -> list[tuple[int, dict[int, int]]]:
        """Lines for columns of these least widths, each as full as possible; a line ends at the column `end`."""
        bands: list[tuple[int, dict[int, int]]] = [(0, {})]
        for place, word in enumerate(least):
            indent, widths = bands[-1]
            if place and (place == end or indent + self._width(widths | {place: word}) > width):
                indent, widths = self.gap, {}
                bands.append((indent, widths))
            # A word longer than the screen is broken.
            widths[place] = int(min(word, max(1, width - indent)))
        return bands

    def _width(self, widths: Mapping[int, int]) -> int:
        return sum(widths.values()) + self.gap * max(0, len(widths) - 1)

    def _row(
        self, cells: Sequence[str], bands: Sequence[tuple[int, Mapping[int, int]]], *, is_heading: bool = False
    ) -> "Iterator[Text]":
        for indent, widths in bands:
            parts = {place: _wrapped(cells[place], width) for place, width in widths.items()}
            height = max(map(len, parts.values()))
            for number in range(height if any(cells[place] for place in widths) or not indent else 0):
                line = _text(" " * indent)
                for place, part in parts.items():
                    at = number - (height - len(part) if is_heading else 0)
                    text = part[at] if 0 <= at < len(part) else ""
                    side = ">" if place in self.numbers else "<"
                    line.append(" " * self.gap * (place != next(iter(parts))))
                    line.append(f"{text:{side}{widths[place]}}", STYLES.get(cells[place], ""))
                line.rstrip()
                yield line


def _text(text: str) -> "Text":
    from rich.text import Text

    return Text(text)


def _word(text: str) -> int:
    """The length of the longest word; an answer counts as one word."""
    return len(text) if text in STYLES else max(map(len, text.split()), default=0)


def _wrapped(text: str, width: int) -> list[str]:
    """The lines of a cell; those after the first are indented if every word still fits."""
    if len(text) <= width:
        return [text]
    # A number stays whole, with the spaces between its thousands.
    whole = _THOUSANDS.sub(_KEPT, text)
    indent = "  " if max(map(len, whole.split(" "))) + 2 <= width else ""
    lines = textwrap.wrap(whole, width, break_on_hyphens=False, subsequent_indent=indent)
    return [line.replace(_KEPT, " ") for line in lines]


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
