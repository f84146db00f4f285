"""Simulate the error rates of verdicts at length, and write them into docs/coverage.md.

PYTHONPATH=runner:tests .venv/bin/python tests/coverage/simulate.py [--draws 0.1] [--only bursts]

All processors share the work. The numbers do not depend on how many there are: each part of a row has its own seed.
"""

import argparse
import os
import sys
import time
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

from rows import ROWS, SEED, Row, percent

from docs_table import share_text, write_rows

DOCS = Path(__file__).parents[2] / "docs" / "coverage.md"
BEGIN = "<!-- simulate.py writes from here -->"
HEAD = """\
| data; P(miss) = target = 1e-3 in those of verdicts | event | before | now | allowed | draws |
|---|---|---:|---:|---:|---:|"""
_PART = 100  # draws that one processor makes at a time


def line(row: Row, events: int, counted: int) -> str:
    """The row's line of the table."""
    at_least = f"at least {row.at_least:g} %" if row.at_least else "-"
    bound = f"at most {row.at_most:g} %" if row.at_most < 100 else at_least
    before = f"{row.reported} %" if row.reported else ""
    return f"| {row.name} | {row.event} | {before} | {share_text(events, max(1, counted))} | {bound} | {counted} |"


def draw(row: int, draws: int, part: int) -> tuple[int, int]:
    """Events and counted draws of one part of a row, given by its place in ROWS: a row itself cannot be sent."""
    return ROWS[row].events(draws, part)


def write(lines: list[str], minutes: float) -> None:
    """Replace the table of docs/coverage.md."""
    made = (
        f"Seed {SEED} for each row, confidence 95 %; made in {minutes:.0f} minutes on {os.cpu_count()} cores.\n"
        "Shares have their 95 % intervals; a row does not hold where the share itself is beyond what is allowed."
    )
    write_rows(DOCS, BEGIN, f"{made}\n\n{HEAD}", lines)


def main() -> int:
    """Simulate, print, write. Exit 1 when a row does not hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=float, default=1.0, help="of the full number of draws; not 1: not written [1]")
    parser.add_argument("--only", default="", help="rows with this in their name, printed and not written")
    args = parser.parse_args()
    start, lines, failed = time.monotonic(), [], 0
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
            share = percent(events, counted)
            holds = ROWS[place].holds(share)
            failed += not holds
            lines.append(line(ROWS[place], events, counted))
            taken = time.monotonic() - start
            print(f"{'ok    ' if holds else 'FAILED'} {lines[-1]} after {taken:.0f} s", flush=True)
    if not args.only and args.draws == 1:
        write(lines, (time.monotonic() - start) / 60)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
