"""rtrun why: what late values waited for, and whether they recur at a period."""

import argparse
from pathlib import Path

from rtrun.commands._arguments import add_json, add_results, named_or_latest
from rtrun.commands._question import add_of
from rtrun.kinds.lateness import LATENESS

SHOWN = 3
HELP = "say what late values waited for, from the kernel traces around them, and whether they have a period"
EXAMPLES = (
    "rtrun why results/brakes",
    "rtrun why results/brakes --all --perfetto late.pftrace",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_results(parser, files=False, latest=True)
    parser.add_argument("--all", action="store_true", help=f"every outlier with its parts, not the {SHOWN} worst")
    add_json(parser)
    add_of(parser, "default: that of the campaign's goal, else what its traces are of")
    parser.add_argument("--perfetto", type=Path, metavar="FILE", help="write the outliers for ui.perfetto.dev")


def run(args: argparse.Namespace) -> int:
    """Print the answer, the remedies, the worst outliers, the ranking, and what else is known; write FILE."""
    from rtfiles import atomic
    from rtfiles.errors import UsageError
    from rtfiles.output import console, counted, print_json, print_line
    from rtrun.causes.ftrace import refuse_trace_cmd
    from rtrun.report import causes, late_paths
    from rtrun.report.perfetto import perfetto
    from rtrun.report.tracing_cost import thresholds, tracing_cost_at
    from rtrun.results.goal_file import read_goal
    from rtrun.results.reading import find_source
    from rtrun.results.record import read_record

    args.results = named_or_latest(args.results)
    source = find_source(args.results)
    if not source.folders:
        refuse_trace_cmd(args.results)
        raise UsageError(f"{args.results}: not a results folder or a run directory")
    ranking, explained, refused = causes.ranked(source)
    measure = args.measure
    if measure is None and (goal := read_goal(args.results)):
        measure = goal.of or LATENESS
    periods, not_searched = causes.periods(source, measure)
    table = causes.table(ranking, explained)
    cost, not_compared = tracing_cost_at(source, measure)
    surroundings, not_held = causes.surroundings(source, measure)
    paths, not_cut = late_paths.late_paths([late_paths.run_of(folder) for folder in source.folders])
    if explained or refused or paths is None:
        outcome = f"{table.outcome if explained or refused else causes.no_traces(source)}."
    else:
        outcome = f"{paths.outcome}."
    problems = tuple(dict.fromkeys((*refused, *not_cut, *not_searched, *not_held, *not_compared)))
    if args.perfetto is not None:
        if not explained:
            raise UsageError(f"{args.perfetto}: not written: no value of {args.results} has a trace")
        atomic.write_named(args.perfetto, perfetto(explained))
    if args.json:
        found = causes.as_data(ranking, explained)
        others = {
            section.id: section.as_data() for section in (paths, periods, surroundings, cost) if section is not None
        }
        print_json({"schema": 1, "outcome": outcome, **found, **others, "problems": problems})
        return UsageError.exit_status if problems else 0
    print_line(outcome)
    advice = tuple(causes.remedies(ranking))
    for note in advice:
        print_line(note)
    worst = sorted(
        (explanation for explanation in explained if explanation.parts),
        key=lambda explanation: explanation.outlier.value_ns,
        reverse=True,
    )
    for explanation in worst if args.all else worst[:SHOWN]:
        print_line()
        for line in causes.lines(explanation, every=args.all):
            print_line(line)
    if len(worst) > SHOWN and not args.all:
        print_line()
        print_line(f"{counted(len(worst) - SHOWN, 'more outlier')}: --all prints them, and every part")
    if table.rows:
        print_line()
        print_line(f"{table.title}:")
        console().print(table)
    for note in (*table.notes[len(advice) :], *thresholds([read_record(folder) for folder in source.folders], measure)):
        print_line(note)
    for more in (causes.step_table(explained), paths, periods, surroundings, cost):
        if more is not None and more.rows:
            print_line()
            print_line(f"{more.title}: {more.outcome}")
            console().print(more)
    if args.perfetto is not None:
        print_line(f"written for ui.perfetto.dev: {args.perfetto}")
    if problems:
        raise UsageError("\n".join(problems))
    return 0
