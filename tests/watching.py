"""What tests watch: the observer of a campaign, which remembers, and acts when a run begins; processes that end."""

import time
from collections.abc import Callable, Iterable
from pathlib import Path

from rtrun.plan.run import Run
from rtrun.results.figures_so_far import FiguresSoFar


class Watching:
    """Keeps what it was told; `at_start` is called with the number of each run that begins."""

    def __init__(
        self,
        at_start: Callable[[int], object] = lambda number: None,
        on_figures: Callable[[FiguresSoFar], None] | None = None,
    ) -> None:
        self.at_start, self.on_figures = at_start, on_figures
        self.ends: list[tuple[str, str | None]] = []
        self.notes: list[str] = []

    def began(self, number: int, run: Run) -> None:
        self.at_start(number)

    def ended(self, number: int, run: Run, status: str, reason: str | None) -> None:
        self.ends.append((status, reason))

    def note(self, text: str) -> None:
        self.notes.append(text)


def wait_for_end(pids: Iterable[str | int]) -> None:
    """Wait until none of these processes runs any more."""
    deadline = time.monotonic() + 60
    for pid in pids:
        status = Path(f"/proc/{pid}/status")
        while status.exists() and "Z (zombie)" not in status.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.02)
