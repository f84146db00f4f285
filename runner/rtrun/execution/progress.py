"""Progress of a campaign: a line for each run; on a terminal also a bar with the time left, and figures so far."""

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.progress_bar import ProgressBar
from rich.text import Text

from rtfiles.output import print_line, print_note, print_status, printable, shortened, shows_status
from rtfiles.quantities import duration, grouped
from rtrun.plan.run import RESTART_S, Run, blocks
from rtrun.plan.short_names import short_names_of_runs
from rtrun.results.figures_so_far import FiguresSoFar
from rtrun.results.record import RunStatus

ShowFigures = Callable[[FiguresSoFar], None]


def in_words(figures: FiguresSoFar, run: Run) -> str:
    """The figures of a run so far, in about 50 columns; times in microseconds, as cyclictest prints them."""
    asked = int(run.parameters.get("repetitions") or 0) * int(run.parameters.get("subscribers") or 1)
    total = f" of {grouped(asked)}" if asked else ""
    lowest, mean, highest = map(_in_us, (figures.min_ns, figures.mean_ns, figures.max_ns))
    return f"{grouped(figures.n)}{total}  min {lowest}  avg {mean}  max {highest} us"


def _in_us(value_ns: int) -> str:
    return grouped(value_ns / 1000) if abs(value_ns) >= 1_000_000 else f"{value_ns / 1000:.1f}"


class _Estimate:
    """The time left: the planned time and, once a run has ended, the time that runs take beyond their measuring."""

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
        runs = self._runs[self._number :]
        restarts = len(blocks(runs)) - 1
        planned_s = [run.expected_s + sum(seen) / len(seen) if seen else run.total_s for run in runs]
        current_s, *rest_s = planned_s or [0.0]
        return max(0.0, current_s - (time.monotonic() - self._began)) + sum(rest_s) + restarts * RESTART_S


class PlainProgress:
    """A line when a run ends; fit for a file or a CI log."""

    on_figures: ShowFigures | None = None

    def __init__(self, runs: Sequence[Run]) -> None:
        self._estimate, self._total = _Estimate(runs), len(runs)
        self._shown_names = {run.name: run.name for run in runs}

    def began(self, number: int, run: Run) -> None:
        """Take note of the time."""
        del run
        self._estimate.began(number)

    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None:
        """Print what became of the run."""
        elapsed_s = self._estimate.ended()
        tail = f": {reason}" if reason else ""
        width = len(str(self._total))
        name = self._shown_names.get(run.name, run.name)
        print_line(f"[{number + 1:{width}}/{self._total}] {status:10} {name}  {elapsed_s:.1f} s{tail}")

    def note(self, text: str) -> None:
        """Print a remark."""
        print_note(f"rtrun: {text}")


class RoundProgress:
    """A line when a run of a round ends; how many there will be is not known."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self.on_figures: ShowFigures | None = None

    def began(self, number: int, run: Run) -> None:
        """Show what is measured."""
        del number
        self._began = time.monotonic()
        print_status(f"measuring {run.name}, {duration(run.expected_s)}")
        if shows_status():
            self.on_figures = lambda figures: print_status(f"measuring: {in_words(figures, run)}")

    def ended(self, number: int, run: Run, status: RunStatus, reason: str | None) -> None:
        """Print what became of the run."""
        del number
        print_status("")
        tail = f": {reason}" if reason else ""
        print_line(f"{status:10} {run.name}  {time.monotonic() - self._began:.1f} s{tail}")

    def note(self, text: str) -> None:
        """Print a remark."""
        print_note(f"rtrun: {text}")


class BarProgress(PlainProgress):
    """The same lines, with short names, above a bar that moves while a run measures, and the figures so far.

    The bar begins with the first run: earlier it might overwrite the prompt for a passphrase.
    """

    def __init__(self, runs: Sequence[Run], bar: "_Bar") -> None:
        super().__init__(runs)
        self._shown_names = short_names_of_runs(runs)
        self._bar = bar
        self._task = bar.add_task("", total=None, left_s=None)
        print_status("getting the target ready")

    def began(self, number: int, run: Run) -> None:
        """Show what is measured."""
        super().began(number, run)
        if not self._bar.live.is_started:
            print_status("")
            self._bar.start()
        self._bar.measured = measured = _Measured(self._shown_names.get(run.name, run.name))
        self._bar.update(self._task, description=f"{number + 1}/{self._total}", left_s=self._estimate.left_s)

        def show(figures: FiguresSoFar) -> None:
            measured.figures = in_words(figures, run)

        self.on_figures = show

    def note(self, text: str) -> None:
        """Print a remark."""
        if not self._bar.live.is_started:
            print_status("")
        super().note(text)


@dataclass(slots=True)
class _Measured:
    """What is measured, and its figures so far: where the line is too long, the name is cut and the figures stay."""

    name: str = ""
    figures: str = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Its line, as rich asks for it each time it draws."""
        room = options.max_width - len(self.figures) - 3
        name = f"{shortened(printable(self.name), room)}  " if room > len("...") else ""
        yield Text(f"{name}{self.figures}", no_wrap=True, overflow="crop")


class _Bar(Progress):
    """A bar, and under it what is measured."""

    def __init__(self, *columns: ProgressColumn, console: Console) -> None:
        self.measured = _Measured()
        super().__init__(*columns, console=console, transient=True, refresh_per_second=2)

    def get_renderables(self) -> Iterable[RenderableType]:
        """Both of them."""
        yield from super().get_renderables()
        yield self.measured


class _TimeBar(BarColumn):
    """A bar that shows which part of the campaign's expected time has passed."""

    def render(self, task: Task) -> ProgressBar:
        left_s = task.fields["left_s"]
        if left_s is not None:
            task.completed = task.elapsed or 0.0
            task.total = task.completed + left_s()
        return super().render(task)


class _TimeLeft(ProgressColumn):
    """The time left, as estimated now."""

    def render(self, task: Task) -> Text:
        left_s = task.fields["left_s"]
        return Text("" if left_s is None else f"{duration(left_s())} left")


@contextlib.contextmanager
def showing(runs: Sequence[Run], console: Console) -> Iterator[PlainProgress]:
    """Yield an observer that shows the progress of these runs on this console."""
    if not console.is_terminal:
        yield PlainProgress(runs)
        return
    columns = (_TimeBar(), TextColumn("{task.description}", markup=False), _TimeLeft())
    bar = _Bar(*columns, console=console)
    try:
        yield BarProgress(runs, bar)
    finally:
        print_status("")
        bar.stop()
