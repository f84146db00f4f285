"""Simulate the error rates of verdicts at length, and write them into docs/analysis.md (an hour on one idle core).

.venv/bin/python tests/coverage/simulate.py [--rounds 0.1] [--only bursts]
"""

import argparse
import sys
import time
from pathlib import Path

from rows import ROWS, SEED, Row

DOCS = Path(__file__).parents[2] / "docs" / "analysis.md"
BEGIN, END = "<!-- make coverage writes from here -->", "<!-- to here -->"


def line(row: Row, scale: float) -> tuple[str, bool]:
    """The row's line of the table, and whether it holds."""
    share, counted = row.share(max(10, round(row.long * scale)))
    at_least = f"at least {row.at_least:g} %" if row.at_least else "-"
    bound = f"at most {row.at_most:g} %" if row.at_most < 100 else at_least
    before = f"{row.reported} %" if row.reported else ""
    return f"| {row.name} | {row.event} | {before} | {share:.1f} % | {bound} | {counted} |", row.holds(share)


def main() -> int:
    """Simulate, print, write. Exit 1 when a row does not hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=float, default=1.0, help="of the full number of draws [1]")
    parser.add_argument("--only", default="", help="rows with this in their name, printed and not written")
    args = parser.parse_args()
    head = [
        "| data, P(miss) = target = 1e-3 | event | before | now | allowed | draws |",
        "|---|---|---:|---:|---:|---:|",
    ]
    lines, failed = list(head), 0
    for row in ROWS:
        if args.only not in row.name:
            continue
        start = time.monotonic()
        text, holds = line(row, args.rounds)
        failed += not holds
        lines.append(text)
        print(f"{'ok    ' if holds else 'FAILED'} {text} {time.monotonic() - start:.0f} s", flush=True)
    if not args.only:
        before, _, rest = DOCS.read_text().partition(BEGIN)
        _, _, after = rest.partition(END)
        table = "\n".join([BEGIN, f"Seed {SEED} for each row, confidence 95 %.", "", *lines, END])
        DOCS.write_text(before + table + after)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
