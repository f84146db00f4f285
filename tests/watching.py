"""The observer of a campaign that tests give: it remembers, and acts when a run begins."""

from collections.abc import Callable

from rtrun.plan.run import Run


class Watching:
    """Keeps what it was told; `at_start` is called with the number of each run that begins."""

    def __init__(self, at_start: Callable[[int], object] = lambda number: None) -> None:
        self.at_start = at_start
        self.ends: list[tuple[str, str | None]] = []
        self.notes: list[str] = []

    def began(self, number: int, run: Run) -> None:
        self.at_start(number)

    def ended(self, number: int, run: Run, status: str, reason: str | None) -> None:
        self.ends.append((status, reason))

    def note(self, text: str) -> None:
        self.notes.append(text)
