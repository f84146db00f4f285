"""Progress of a campaign on several boards: a line when a run ends, and on a terminal a line for each board as well."""

import contextlib
import math
import threading
import time
from collections.abc import Iterator, Mapping, Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Column

from rtfiles.output import print_line, print_note, printable, shortened
from rtrun.execution.progress import ShowFigures, in_words
from rtrun.plan.run import Run
from rtrun.plan.short_names import short_names_of_runs
from rtrun.results.record import RunStatus


class _Row:
    """The row of a board on a terminal: a bar and a text."""

    def __init__(self, bars: Progress, board: str) -> None:
        self._bars = bars
        self._task = bars.add_task("gets ready", total=None, board=shortened(printable(board), 20))

    def begin(self, text: str, total_s: float | None) -> None:
        """Show another text, and a bar that is full after this time, in seconds."""
        self._bars.reset(self._task, total=total_s, description=printable(text))

    def show(self, text: str) -> None:
        """Show another text beside the same bar."""
        self._bars.update(self._task, description=printable(text))


class BoardLine:
    """Shows what one board does. Every printed line has the name of the board."""

    def __init__(self, board: str, row: _Row | None, lock: threading.Lock, short_names: Mapping[str, str]) -> None:
        self._board, self._row, self._lock, self._short_names = board, row, lock, short_names
        self._began = time.monotonic()
        self.on_figures: ShowFigures | None = None

    def began(self, number: int, run: Run) -> None:
        """Show what is measured."""
        del number
        self._began = time.monotonic()
        if row := self._row:
            row.begin(self._name(run), run.total_s)
            self.on_figures = lambda figures: row.show(in_words(figures, run))

    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None:
        """Print what became of the run."""
        del number
        elapsed_s = time.monotonic() - self._began
        tail = f": {reason}" if reason else ""
        with self._lock:
            print_line(f"{status:10} {self._board:12} {self._name(run)}  {elapsed_s:.1f} s{tail}")
        if self._row:
            self._row.begin("waits for the other boards", None)

    def _name(self, run: Run) -> str:
        return self._short_names.get(run.name, run.name)

    def note(self, text: str) -> None:
        """Print a remark."""
        with self._lock:
            print_note(f"rtrun: {self._board}: {text}")

    def left(self, error: str | None) -> None:
        """Show that the board measures no more, and print why if it failed."""
        if self._row:
            # The bar of a board that failed stays empty, that of one that is done is full.
            self._row.begin("failed" if error else "done", math.inf if error else 0.0)
        if error:
            self.note(f"{error}: the other boards measure what it leaves")


@contextlib.contextmanager
def showing_boards(boards: Sequence[str], runs: Sequence[Run], console: Console) -> Iterator[Mapping[str, BoardLine]]:
    """Yield a progress line for each board, by its name; on a terminal, runs have short names."""
    lock = threading.Lock()
    if not console.is_terminal:
        yield {board: BoardLine(board, None, lock, {}) for board in boards}
        return
    columns = (
        TextColumn("{task.fields[board]}"),
        BarColumn(bar_width=12),
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
    )
    bars = Progress(*columns, console=console, transient=True, refresh_per_second=2, expand=True)
    rows = {board: _Row(bars, board) for board in boards}
    short_names = short_names_of_runs(runs)
    with bars, _moving(bars):
        yield {board: BoardLine(board, row, lock, short_names) for board, row in rows.items()}


@contextlib.contextmanager
def _moving(bars: Progress) -> Iterator[None]:
    """Let the bars move."""
    ended = threading.Event()

    def move() -> None:
        while not ended.wait(0.5):
            for task in bars.tasks:
                if task.total is not None:
                    bars.update(task.id, completed=min(task.total, task.elapsed or 0.0))

    mover = threading.Thread(target=move, daemon=True)
    mover.start()
    try:
        yield
    finally:
        ended.set()
        mover.join()
