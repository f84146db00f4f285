"""How far a campaign is, on a terminal as a bar with the time left, elsewhere as a line for each run."""

import contextlib
import threading
import time
from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from rtfiles.output import print_line, print_note
from rtrun.plan.campaign import Run
from rtrun.results.record import RunStatus

REFRESH_S = 0.5
# Before a run was seen to its end: copying, starting and stopping takes about this long beside the measuring.
OVERHEAD_GUESS_S = 2.0


class _Estimate:
    """The time left: what is planned, and per run the overhead seen so far."""

    def __init__(self, runs: Sequence[Run]) -> None:
        self._runs = runs
        self._overhead_s: list[float] = []
        self._began = time.monotonic()
        self._number = 0

    def began(self, number: int) -> None:
        self._number, self._began = number, time.monotonic()

    def ended(self) -> float:
        elapsed_s = time.monotonic() - self._began
        self._overhead_s.append(max(0.0, elapsed_s - self._runs[self._number].expected_s))
        self._number += 1
        self._began = time.monotonic()
        return elapsed_s

    def left_s(self) -> float:
        seen = self._overhead_s
        overhead_s = sum(seen) / len(seen) if seen else OVERHEAD_GUESS_S
        current_s, *rest_s = [run.expected_s + overhead_s for run in self._runs[self._number :]] or [0.0]
        return max(0.0, current_s - (time.monotonic() - self._began)) + sum(rest_s)


class PlainProgress:
    """A line when a run ends; fit for a file or a CI log."""

    def __init__(self, runs: Sequence[Run]) -> None:
        self._estimate, self._total = _Estimate(runs), len(runs)

    def began(self, number: int, run: Run) -> None:
        """Take note of the time."""
        del run
        self._estimate.began(number)

    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None:
        """Print what became of the run."""
        elapsed_s = self._estimate.ended()
        tail = f": {reason}" if reason else ""
        width = len(str(self._total))
        print_line(f"[{number + 1:{width}}/{self._total}] {status:10} {run.name}  {elapsed_s:.1f} s{tail}")

    def note(self, text: str) -> None:
        """Print a remark."""
        print_note(f"rtrun: {text}")


class BarProgress(PlainProgress):
    """The same lines above a bar that moves while a run measures."""

    def __init__(self, runs: Sequence[Run], bar: Progress) -> None:
        super().__init__(runs)
        self._bar = bar
        self._task = bar.add_task("getting the target ready", total=None, left="?")

    def began(self, number: int, run: Run) -> None:
        """Show the run's name."""
        super().began(number, run)
        self._bar.update(self._task, description=f"{number + 1}/{self._total} {run.name}")
        self.refresh()

    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None:
        """Print what became of the run above the bar."""
        super().ended(number, run, status, reason)
        self.refresh()

    def refresh(self) -> None:
        """Move the bar to the time that has passed."""
        left_s = self._estimate.left_s()
        done_s = time.monotonic() - (self._bar.tasks[0].start_time or 0.0)
        self._bar.update(self._task, completed=done_s, total=done_s + left_s, left=_duration(left_s))


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min {rest:02} s" if minutes else f"{rest} s"


@contextlib.contextmanager
def showing(runs: Sequence[Run], console: Console) -> Iterator[PlainProgress]:
    """Yield whoever shows the progress of these runs on this console."""
    if not console.is_terminal:
        yield PlainProgress(runs)
        return
    columns = (BarColumn(), TextColumn("{task.description}"), TextColumn("{task.fields[left]} left"))
    with Progress(*columns, console=console, transient=True, auto_refresh=True, refresh_per_second=2) as bar:
        shown = BarProgress(runs, bar)
        done = threading.Event()

        def tick() -> None:
            while not done.wait(REFRESH_S):
                shown.refresh()

        ticker = threading.Thread(target=tick, daemon=True)
        ticker.start()
        try:
            yield shown
        finally:
            done.set()
            ticker.join()
