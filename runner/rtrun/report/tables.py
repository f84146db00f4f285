"""A table of a report, as text for every format."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from rtfiles.output import printable


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of text; cells from column `numbers` on hold numbers. ``notes`` come below it.

    `how` names the explanation of how its figures are computed (report/how.py). `outcome` is the result in one line.
    ``parts[k]`` are the rows that row k sums up, if any.
    """

    id: str
    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    outcome: str = ""
    parts: Mapping[int, Sequence[tuple[str, ...]]] = field(default_factory=dict)
    numbers: int = 1
    notes: tuple[str, ...] = ()
    how: str = ""

    def as_data(self) -> dict[str, object]:
        """For programs: the rows by column name."""
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return {"outcome": self.outcome, "rows": rows, "notes": self.notes}


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
