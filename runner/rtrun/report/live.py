"""Current measurements of observed programs: a table that is redrawn, lines, or JSON."""

import json
from typing import TYPE_CHECKING, Self

from rtfiles.output import console, counted, print_line, printable, shortened
from rtfiles.quantities import duration, grouped, time
from rtrun.flows.live import LiveRow, Snapshot, worst_first
from rtrun.kinds.kind import StreamKind
from rtrun.kinds.known import STREAMS
from rtrun.report.tables import Table

if TYPE_CHECKING:
    from rich.console import Group
    from rich.live import Live

_COLUMNS = ("what", "of", "number", "rate/Hz", "median", "p99", "worst", "lost", "misses")
_ROUND_THE_TABLE = 5  # lines of a screen outside the table


def live_table(snapshot: Snapshot, width: int, height: int) -> "Group":
    """Messages, timers and paths for a screen of this size, those with misses first, and what is missing."""
    from rich.console import Group
    from rich.text import Text

    rows = worst_first(_shown(snapshot))
    fitting = max(1, height - _ROUND_THE_TABLE - len(snapshot.remarks))
    lines = [f"{duration(snapshot.observed_s)} observed"]
    if len(rows) > fitting:
        lines.append(f"{counted(len(rows) - fitting, 'more stream')} not shown")
    shown = Table(columns=_COLUMNS, rows=[_cells(row) for row in rows[:fitting]], numbers=range(2, len(_COLUMNS)))
    return Group(
        shown, *(Text(shortened(printable(line), width), no_wrap=True) for line in (*lines, *snapshot.remarks))
    )


def _shown(snapshot: Snapshot) -> list[LiveRow]:
    return [row for row in snapshot.rows if row.kind.is_shown or row.deadline_ns is not None]


def _cells(row: LiveRow) -> tuple[str, ...]:
    misses = "-"
    if row.misses is not None:
        misses = f"{grouped(row.misses)} > {time(row.deadline_ns)}"
    return (
        row.name,
        row.detail,
        grouped(row.n),
        f"{row.rate_hz:.4g}",
        time(row.median_ns),
        time(row.p99_ns),
        time(row.worst_ns),
        "-" if row.lost is None else grouped(row.lost),
        misses,
    )


def live_line(snapshot: Snapshot) -> str:
    """The same in one line: how much there is, and the worst value of what has a deadline, by name."""
    rows = _shown(snapshot)
    parts = []
    for kind in STREAMS.values():
        alike = [row for row in rows if row.kind is kind]
        numbers = zip((len(alike), sum(row.n for row in alike)), kind.live_words, strict=True)
        if words := [counted(number, word) for number, word in numbers if word and alike]:
            parts.append(" with ".join(words))
            if lost := [row.lost for row in alike if row.lost is not None]:
                parts.append(f"{sum(lost)} lost")
    with_deadline: dict[tuple[StreamKind, str], list[LiveRow]] = {}
    for row in rows:
        if row.misses is not None:
            with_deadline.setdefault((row.kind, row.name), []).append(row)
    for (kind, name), alike in with_deadline.items():
        worst_ns = max((row.worst_ns for row in alike if row.worst_ns is not None), default=None)
        worst = "no value yet" if worst_ns is None else f"worst {time(worst_ns)}"
        parts.append(f"{kind.name(name)}: {worst}, misses {sum(row.misses or 0 for row in alike)}")
    return f"{duration(snapshot.observed_s)}: {', '.join((*(parts or ['nothing yet']), *snapshot.remarks))}"


def live_json(snapshot: Snapshot) -> str:
    """The same as a JSON object in one line, for programs."""
    rows = [{name: getattr(row, name) for name in row.__slots__} | {"kind": str(row.kind)} for row in snapshot.rows]
    return json.dumps({name: getattr(snapshot, name) for name in snapshot.__slots__} | {"rows": rows})


class LiveView:
    """Shows snapshots: on a terminal as a table that is redrawn in place, elsewhere as a line each, or as JSON."""

    def __init__(self, *, as_json: bool = False) -> None:
        self._console = console()
        self._as_json = as_json
        self._live: Live | None = None

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._as_json:
            from rich.live import Live

            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.__exit__(None, None, None)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if self._live is not None:
            self._live.update(live_table(snapshot, self._console.width, self._console.height), refresh=True)
        else:
            print_line(live_json(snapshot) if self._as_json else live_line(snapshot))
