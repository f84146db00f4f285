"""rtrun why: what late values waited for, from the kernel traces of a campaign."""

import argparse
from pathlib import Path

NAME = "why"
HELP = "say what late values waited for, from the kernel traces around them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The results."""
    parser.add_argument("results", type=Path, metavar="RESULTS", help="a results folder, or one run directory in it")


def run(args: argparse.Namespace) -> int:
    """Print the answer, the ranking, then each outlier. Raises UsageError for results without traces."""
    from rtfiles.errors import UsageError
    from rtfiles.output import console, print_line
    from rtrun.report import causes
    from rtrun.results.reading import find_source
    from rtrun.results.record import read_record

    source = find_source(args.results)
    ranking, explained, refused = causes.ranked(source)
    if not explained:
        if refused:
            raise UsageError("\n".join(refused))
        if not any(causes.is_traced(read_record(folder)) for folder in source.folders):
            raise UsageError(f"{args.results}: no run with traces: a campaign asks for them by trace_threshold_us")
        print_line("No value was above the limit from which on a run keeps traces.")
        return 0
    table = causes.table(ranking, explained)
    print_line(f"{table.outcome}.")
    for note in table.notes:
        print_line(note)
    if table.rows:
        print_line()
        console().print(causes.for_terminal(table), crop=False)
    for one in explained:
        print_line()
        for line in causes.lines(one):
            print_line(line)
    if refused:
        raise UsageError("\n".join(refused))
    return 0
