"""Simulate the error rates of verdicts at length, and write them into docs/one-hazard.csv and docs/coverage.md.

PYTHONPATH=runner:tests .venv/bin/python tests/coverage/simulate.py [--draws 0.1] [--only bursts]

All processors share the work. The numbers do not depend on how many there are: each part of a row has its own seed.
"""

import argparse
import csv
import math
import os
import sys
import time
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from rows import ROWS, SEED, Row, percent

from docs_table import share_text, write_rows
from rtrun.analysis.chance.intervals import clopper_pearson

DOCS = Path(__file__).parents[2] / "docs"
PAGE, TABLE = DOCS / "coverage.md", DOCS / "one-hazard.csv"
BEGIN = "<!-- simulate.py writes from here -->"
HEAD = """\
| nearest to what is allowed; P(miss) = target = 1e-3 | event | now | allowed |
|---|---|---:|---:|"""
COLUMNS = ("data", "event", "before_percent", "percent", "low", "high", "at_least", "at_most", "draws")
_PART = 100  # draws that one processor makes at a time
_NEAREST = 12


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """A row of the table, with the events that were counted in so many draws."""

    row: Row
    events: int
    draws: int

    @property
    def share(self) -> float:
        """The events in percent of the draws."""
        return percent(self.events, self.draws)

    @property
    def holds(self) -> bool:
        """Whether the share is within the bounds of the row."""
        return self.row.holds(self.share)

    @property
    def is_bounded(self) -> bool:
        """Whether not every share is allowed."""
        return self.row.at_most < 100 or self.row.at_least > 0

    @property
    def used(self) -> float:
        """Which part of what is allowed its share takes; above 1 the row does not hold."""
        least = (100 - self.share) / (100 - self.row.at_least) if self.row.at_least else 0.0
        most = self.share / self.row.at_most if self.row.at_most else math.inf if self.share else 0.0
        return max(least, most if self.row.at_most < 100 else 0.0)

    def cells(self) -> tuple[object, ...]:
        """Its cells in the file: percentages, with a 95 % interval."""
        low, high = (round(100 * end, 2) for end in clopper_pearson(self.events, max(1, self.draws), 0.95))
        row = self.row
        return (
            row.name,
            row.event,
            row.reported,
            round(self.share, 2),
            low,
            high,
            row.at_least,
            row.at_most,
            self.draws,
        )

    def line(self) -> str:
        """Its line on the page."""
        bound = f"at most {self.row.at_most:g} %" if self.row.at_most < 100 else f"at least {self.row.at_least:g} %"
        shown = share_text(self.events, max(1, self.draws))
        return f"| {self.row.name} | {self.row.event} | {shown} | {bound} |"


def draw(row: int, draws: int, part: int) -> tuple[int, int]:
    """Events and counted draws of one part of a row, given by its place in ROWS: a row itself cannot be sent."""
    return ROWS[row].events(draws, part)


def write(drawn: list[Drawn], minutes: float) -> None:
    """Write the file, and into the page of docs the rows that are nearest to what is allowed."""
    with TABLE.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *(one.cells() for one in drawn)])
    bounded = [one for one in drawn if one.is_bounded]
    made = (
        f"All {len(drawn)} rows, with 95 % intervals: [one-hazard.csv](one-hazard.csv). Seed {SEED} for each row,\n"
        f"confidence 95 %; made in {minutes:.0f} minutes on {os.cpu_count()} cores. "
        f"{sum(one.holds for one in bounded)} of the {len(bounded)} rows that have\na bound keep it."
    )
    nearest = sorted(bounded, key=lambda one: one.used, reverse=True)[:_NEAREST]
    write_rows(PAGE, BEGIN, f"{made}\n\n{HEAD}", [one.line() for one in nearest])


def main() -> int:
    """Simulate, print, write. Exit 1 when a row does not hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=float, default=1.0, help="of the full number of draws; not 1: not written [1]")
    parser.add_argument("--only", default="", help="rows with this in their name, printed and not written")
    args = parser.parse_args()
    start, rows, failed = time.monotonic(), list[Drawn](), 0
    with ProcessPoolExecutor() as processors:
        parts: dict[int, list[Future[tuple[int, int]]]] = {}
        for place, row in enumerate(ROWS):
            if args.only in row.name:
                draws = max(2, round(row.long * args.draws))
                parts[place] = [
                    processors.submit(draw, place, min(_PART, draws - first), first // _PART)
                    for first in range(0, draws, _PART)
                ]
        for place, futures in parts.items():
            events, counted = (sum(numbers) for numbers in zip(*(f.result() for f in futures), strict=True))
            rows.append(drawn := Drawn(row=ROWS[place], events=events, draws=counted))
            failed += not drawn.holds
            taken = time.monotonic() - start
            print(f"{'ok    ' if drawn.holds else 'FAILED'} {drawn.line()} after {taken:.0f} s", flush=True)
    if not args.only and args.draws == 1:
        write(rows, (time.monotonic() - start) / 60)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
