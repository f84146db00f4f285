"""Tables for a terminal: in columns if no word has to be broken, otherwise a line for each cell; the answers."""

from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rtfiles.output import console, print_line, printable
from rtfiles.quantities import grouped, time
from rtrun.analysis.deadline import Answer
from rtrun.judgement.gate import Case
from rtrun.judgement.verdicts import bound_text
from rtrun.report import tables

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

# Spaces between two cells.
_GAP = 2
_STYLES: dict[str, str] = {
    Answer.PROVEN: "green",
    Answer.IF_INDEPENDENT: "yellow",
    Answer.NEEDS_MORE: "yellow",
    Answer.REFUTED: "bold red",
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


def styled(word: str) -> "Text":
    """An answer, or pass or FAIL, in its colour, which only a terminal shows."""
    from rich.text import Text

    return Text(printable(word), style=_STYLES.get(word, ""))


def print_styled(word: str, rest: str = "") -> None:
    """Print a line that begins with an answer in its colour."""
    screen = console()
    screen.print(styled(word).append(printable(rest), style="default"), soft_wrap=True)


def fitted(headings: Sequence[str], rows: Sequence[Sequence[str]], numbers: Container[int], width: int) -> "Table":
    """A table of at most `width` columns; cells in the columns `numbers` stay whole.

    If the words do not fit next to each other, each row becomes a list of headings and cells.
    """
    from rich import box
    from rich.table import Table

    cells = [[styled(cell) for cell in row] for row in rows]
    columns = [
        _Column(
            heading=heading,
            is_number=place in numbers,
            least=max([_word(heading), *(len(row[place]) if place in numbers else _word(row[place]) for row in rows)]),
            most=max([len(heading), *(len(row[place]) for row in rows)]),
        )
        for place, heading in enumerate(headings)
    ]
    widths = [column.least for column in columns]
    spare = width - sum(widths) - (_GAP * len(columns) - 1)
    if spare < 0:
        return _listed(headings, cells)
    # Spare width goes to the column that lacks most, so that few cells take several lines.
    missing = [column.most - column.least for column in columns]
    while spare > 0 and max(missing) > 0:
        place = missing.index(max(missing))
        widths[place], missing[place], spare = widths[place] + 1, missing[place] - 1, spare - 1
    made = Table(box=box.SIMPLE, padding=(0, _GAP - 1, 0, 0), show_edge=False, pad_edge=False)
    for column, of_column in zip(columns, widths, strict=True):
        made.add_column(column.heading, justify="right" if column.is_number else "left", width=of_column)
    for row in cells:
        made.add_row(*row)
    return made


def print_rows(table: tables.Table) -> None:
    """Print the rows of a table of the report."""
    screen, shown = console(), tables.printable_table(table)
    screen.print(fitted(shown.columns, shown.rows, range(shown.numbers, len(shown.columns)), screen.width))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Column:
    """A column: the width that it needs, and the smallest width that breaks nothing in it."""

    heading: str
    is_number: bool
    least: int
    most: int


def _word(text: str) -> int:
    """The length of the longest word; an answer counts as one word."""
    return len(text) if text in _STYLES else max(map(len, text.split()), default=0)


def _listed(headings: Sequence[str], rows: "Sequence[Sequence[Text]]") -> "Table":
    """A line for each cell that is not empty, and an empty line between two rows."""
    from rich.table import Table

    made = Table.grid(padding=(0, _GAP))
    made.add_column(no_wrap=True)
    made.add_column(overflow="fold")
    for number, row in enumerate(rows):
        if number:
            made.add_row("", "")
        for heading, cell in zip(headings, row, strict=True):
            if cell.plain:
                made.add_row(heading, cell)
    return made


def print_answers(cases: Sequence[Case], *, verbose: bool) -> None:
    """Print a row for each case: whether it passes, and its answer.

    If `verbose`, or if there is a single case, a sentence explains each answer. Otherwise lines below add what the
    numbers do not show; a line that applies to several cases is printed once.
    """
    if not cases:
        return
    screen = console()
    screen.print(_table(cases, screen.width))
    refusals = {case.refused for case in cases}
    refused = refusals.pop() if len(cases) > 1 and len(refusals) == 1 else None
    if refused:
        print_line()
        print_line(f"no scenario has an answer: {refused}")
    lines: dict[str, list[str]] = {}
    for case in cases:
        if verbose or len(cases) == 1:
            lines.setdefault(f"{case.about}: {case.in_full.removeprefix(f'{refused}; ')}", [])
            continue
        reason = case.in_full if case.reason is None else case.reason
        for text in (reason if case.refused is None else "", case.not_accepted):
            if text:
                lines.setdefault(text, []).append(case.about)
    if lines:
        print_line()
    for text, of in lines.items():
        about = f"{len(of)} scenarios: " if len(of) > 1 else "".join(f"{name}: " for name in of)
        print_line(f"{about}{text}")


def _table(cases: Sequence[Case], width: int) -> "Table":
    headings = ("gate", "answer", "scenario", "misses", "P(miss)", "worst")
    rows = [
        (
            "pass" if case.passed else "FAIL",
            case.answer,
            case.short or case.about,
            "-" if case.n is None else f"{'-' if case.misses is None else grouped(case.misses)} of {grouped(case.n)}",
            "-" if case.lower is None or case.upper is None else bound_text(case.answer, case.lower, case.upper),
            time(case.worst_ns),
        )
        for case in cases
    ]
    return fitted(headings, rows, range(3, len(headings)), width)
