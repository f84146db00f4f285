"""The answers on a terminal: an aligned table of one line a case, and the reasons below it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rtfiles.output import console, print_line
from rtfiles.quantities import grouped, us
from rtrun.judgement.gate import Case
from rtrun.report.screen import fitted

if TYPE_CHECKING:
    from rich.table import Table


def print_answers(cases: Sequence[Case], *, judged: bool) -> None:
    """Print the table, with whether each case passes where they are `judged`, then a line for each reason.

    Why there is no answer is printed once where it is the same for all.
    """
    if not cases:
        return
    screen = console()
    screen.print(_table(cases, judged=judged, width=screen.width))
    print_line()
    refusals = {case.refused for case in cases}
    refused = refusals.pop() if len(cases) > 1 and len(refusals) == 1 else None
    if refused:
        print_line(f"no scenario has an answer: {refused}")
    for case in cases:
        print_line(f"{case.about}: {case.text.removeprefix(f'{refused}; ')}")


def _table(cases: Sequence[Case], *, judged: bool, width: int) -> "Table":
    headings = (*["gate"] * judged, "answer", "scenario", "n", "misses", "worst us")
    rows = [
        (
            *["pass" if case.passed else "FAIL"] * judged,
            case.answer,
            case.about,
            *("-" if count is None else grouped(count) for count in (case.n, case.misses)),
            "-" if case.worst_ns is None else us(case.worst_ns),
        )
        for case in cases
    ]
    return fitted(headings, rows, range(len(headings) - 3, len(headings)), width)
