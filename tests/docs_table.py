"""Tables in pages of docs that programs of the tests write, each between two comments of its page."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from rtrun.analysis.chance.intervals import clopper_pearson

END = "<!-- to here -->"


def share_text(events: int, draws: int) -> str:
    """A share in percent, with its 95 % interval (Clopper & Pearson 1934)."""
    low, high = clopper_pearson(events, draws, 0.95)
    return f"{100 * events / draws:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def write_rows(page: Path, begin: str, head: str, rows: Iterable[str], order: Sequence[str] = ()) -> None:
    """Write a table behind the comment `begin`: the lines of `head`, then the rows.

    `order` has the names of all rows (their first column): rows of other names stay, and all come in this order.
    Raises RuntimeError when the page has no such place.
    """
    before, begun, rest = page.read_text().partition(begin)
    table, end, after = rest.partition(END)
    if not begun or not end:
        raise RuntimeError(f"{page}: has no place for the table: {begin}")
    if order:
        by_name = {row.split(" | ")[0].removeprefix("| "): row for row in [*table.splitlines(), *rows]}
        rows = [by_name[name] for name in order if name in by_name]
    page.write_text("\n".join([before + begin, head, *rows, end]) + after)
