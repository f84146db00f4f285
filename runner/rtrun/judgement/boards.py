"""Several boards that measured the same: which of them are alike, and how far their results differ."""

from collections.abc import Sequence

from rtfiles.quantities import time
from rtrun.analysis.figures import figures_of_histogram
from rtrun.judgement.groups import Group

_SPREAD_PERCENT = 99.9


def spread(group: Group) -> str:
    """The lowest and the highest value of each figure among the boards, each with its board."""
    parts = []
    misses = {board.boards[0]: board.verdict.p_miss for board in group.members if board.verdict}
    if any(misses.values()):
        parts.append(f"P(miss) {_range({board: (p, f'{p:.2g}') for board, p in misses.items()})}")
    figures = {board.boards[0]: figures_of_histogram(board.histogram) for board in group.members}
    high = {board: measured.percentiles_ns.get(_SPREAD_PERCENT) for board, measured in figures.items()}
    worst = {board.boards[0]: board.verdict.worst_ns for board in group.members if board.verdict}
    for name, values in ((f"p{_SPREAD_PERCENT:g}", high), ("worst", worst)):
        known = {board: (float(value), time(value)) for board, value in values.items() if value is not None}
        if len(known) == len(group.members):
            parts.append(f"{name} {_range(known)}")
    return "; ".join(parts)


def _range(values: dict[str, tuple[float, str]]) -> str:
    low, high = (choose(values, key=lambda board: values[board][0]) for choose in (min, max))
    return f"{values[low][1]} ({low}) to {values[high][1]} ({high})"


def differences(groups: Sequence[Group]) -> list[str]:
    """Why boards that measured the same are not pooled: a line for each fact of the target in which they differ."""
    boards = {board: group.environment for group in groups if not group.members for board in group.boards}
    facts = dict.fromkeys(fact for environment in boards.values() for fact, _ in environment)
    lines = []
    for fact in facts:
        values: dict[str, list[str]] = {}
        for board, environment in boards.items():
            values.setdefault(dict(environment)[fact], []).append(board)
        if len(values) > 1:
            which = "; ".join(f"{value} on {', '.join(names)}" for value, names in values.items())
            lines.append(f"boards that differ in {fact} are not pooled: {which}")
    return lines
