"""The answers on a terminal: an aligned table of one line a case, and the reasons below it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rtfiles.output import console, print_line, printable
from rtrun.analysis.deadline import Answer
from rtrun.report.claims.examination import us
from rtrun.report.gate import Case
from rtrun.report.tables import grouped

if TYPE_CHECKING:
    from rich.table import Table

_STYLES: dict[str, str] = {
    Answer.PROVEN: "green",
    Answer.IF_INDEPENDENT: "yellow",
    Answer.NEEDS_MORE: "yellow",
    Answer.REFUTED: "bold red",
    "NOT ANALYSED": "bold red",
}
_UNBOUNDED = 10_000  # columns: the terminal breaks a line that is too long for it, no cell is cut


def print_answers(cases: Sequence[Case], *, judged: bool) -> None:
    """Print the table, with whether each case passes where they are `judged`, then a line for each reason.

    Why there is no answer is printed once where it is the same for all.
    """
    if not cases:
        return
    screen, rows = console(), _table(cases, judged=judged)
    screen.width = screen.measure(rows, options=screen.options.update(max_width=_UNBOUNDED)).maximum
    screen.print(rows)
    print_line()
    refusals = {case.refused for case in cases}
    refused = refusals.pop() if len(cases) > 1 and len(refusals) == 1 else None
    if refused:
        print_line(f"no scenario has an answer: {refused}")
    for case in cases:
        print_line(f"{case.about}: {case.text.removeprefix(f'{refused}; ')}")


def _table(cases: Sequence[Case], *, judged: bool) -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    rows = Table(box=box.SIMPLE, padding=(0, 1, 0, 0), show_edge=False, pad_edge=False)
    for heading in (*["gate"] * judged, "answer", "scenario"):
        rows.add_column(heading, no_wrap=True)
    for heading in ("n", "misses", "worst us"):
        rows.add_column(heading, justify="right", no_wrap=True)
    for case in cases:
        gate = Text("pass", style="green") if case.passed else Text("FAIL", style="bold red")
        numbers = ["-" if count is None else grouped(count) for count in (case.n, case.misses)]
        numbers.append("-" if case.worst_ns is None else us(case.worst_ns))
        answer = Text(case.answer, style=_STYLES.get(case.answer, ""))
        rows.add_row(*[gate] * judged, answer, Text(printable(case.about)), *numbers)
    return rows
