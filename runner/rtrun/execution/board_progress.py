"""Progress of a campaign on several boards: a line when a run ends, and on a terminal a line for each board as well."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Column

from rtfiles.output import print_line, print_note, printable
from rtrun.plan.run import Run
from rtrun.results.record import RunStatus


class BoardLine:
    """Shows what one board does. Every printed line has the name of the board."""

    def __init__(self, board: str, show: Callable[[str, float | None], None], lock: threading.Lock) -> None:
        self._board, self._show, self._lock = board, show, lock
        self._began = time.monotonic()

    def began(self, number: int, run: Run) -> None:
        """Show what is measured."""
        del number
        self._began = time.monotonic()
        self._show(run.name, run.total_s)

    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None:
        """Print what became of the run."""
        del number
        elapsed_s = time.monotonic() - self._began
        tail = f": {reason}" if reason else ""
        with self._lock:
            print_line(f"{status:10} {self._board:12} {run.name}  {elapsed_s:.1f} s{tail}")
        self._show("waits for the other boards", None)

    def note(self, text: str) -> None:
        """Print a remark."""
        with self._lock:
            print_note(f"rtrun: {self._board}: {text}")

    def left(self, error: str | None) -> None:
        """Show that the board measures no more, and print why if it failed."""
        self._show("failed" if error else "done", None)
        if error:
            self.note(f"{error}: the other boards measure what it leaves")


@contextlib.contextmanager
def showing_boards(boards: Sequence[str], console: Console) -> Iterator[Mapping[str, BoardLine]]:
    """Yield a progress line for each board, by its name."""
    lock = threading.Lock()
    if not console.is_terminal:
        yield {board: BoardLine(board, lambda *_: None, lock) for board in boards}
        return
    columns = (
        TextColumn("{task.fields[board]}"),
        BarColumn(bar_width=12),
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
    )
    bars = Progress(*columns, console=console, transient=True, refresh_per_second=2, expand=True)
    tasks = {board: bars.add_task("gets ready", total=None, board=board) for board in boards}
    with bars, _moving(bars) as shown:
        yield {board: BoardLine(board, shown(tasks[board]), lock) for board in boards}


@contextlib.contextmanager
def _moving(bars: Progress) -> Iterator[Callable[[TaskID], Callable[[str, float | None], None]]]:
    """Yield a setter for the line of each task: its text, and the time in seconds after which its bar is full."""
    ended = threading.Event()

    def shown(task: TaskID) -> Callable[[str, float | None], None]:
        def show(text: str, total_s: float | None) -> None:
            bars.reset(task, total=total_s, description=printable(text))

        return show

    def move() -> None:
        while not ended.wait(0.5):
            for task in bars.tasks:
                if task.total is not None:
                    bars.update(task.id, completed=min(task.total, task.elapsed or 0.0))

    mover = threading.Thread(target=move, daemon=True)
    mover.start()
    try:
        yield shown
    finally:
        ended.set()
        mover.join()
