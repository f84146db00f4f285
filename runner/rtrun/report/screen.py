"""The answers on a terminal."""

from collections.abc import Sequence

from rtfiles.output import console, print_line, printable
from rtfiles.quantities import grouped, time
from rtrun.judgement.digest import pool_figures
from rtrun.judgement.gate import Case
from rtrun.judgement.groups import Group, short_names
from rtrun.report.tables import STYLES, Table


def print_styled(word: str, rest: str = "") -> None:
    """Print a line that begins with an answer in its colour."""
    from rich.text import Text

    console().print(Text(printable(word), STYLES.get(word, "")).append(printable(rest), "default"))


def print_figures(groups: Sequence[Group]) -> None:
    """Print a row of figures for each group."""
    columns = ("scenario", "n", "p50", "p99", "p99.9", "worst")
    rows = []
    names = short_names(groups)
    for group in groups:
        figures = pool_figures(group.digests)
        percentiles = (time(figures.percentiles_ns.get(percent)) for percent in (50.0, 99.0, 99.9))
        rows.append((names[group.key], grouped(figures.n), *percentiles, time(figures.max_ns)))
    if rows:
        console().print(Table(columns=columns, rows=rows, numbers=range(1, len(columns))))


def print_answers(cases: Sequence[Case], *, verbose: bool) -> None:
    """Print a row for each case: whether it passes, and its answer.

    If `verbose`, or if there is a single case, a sentence explains each answer. Otherwise lines below add what the
    numbers do not show; a line that applies to several cases is printed once.
    """
    if not cases:
        return
    console().print(_table(cases))
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
    for text, names in lines.items():
        about = f"{len(names)} scenarios: " if len(names) > 1 else "".join(f"{name}: " for name in names)
        print_line(f"{about}{text}")


def _table(cases: Sequence[Case]) -> Table:
    columns = ("gate", "answer", "scenario", "misses", "P(miss)", "worst")
    rows = [
        (
            "pass" if case.passed else "FAIL",
            case.answer,
            case.short or case.about,
            "-" if case.n is None else f"{'-' if case.misses is None else grouped(case.misses)} of {grouped(case.n)}",
            case.bound,
            time(case.worst_ns),
        )
        for case in cases
    ]
    return Table(columns=columns, rows=rows, numbers=range(3, len(columns)))
