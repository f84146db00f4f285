"""rtrun verdict: the answer of each group of runs, what it is based on, and what is still missing."""

import argparse
from typing import TYPE_CHECKING

from rtrun.commands._arguments import add_json, add_results, named_or_latest
from rtrun.commands._question import add_question, ask

if TYPE_CHECKING:
    from rtrun.judgement.study import Study

HELP = "say for each group of runs whether the deadline is met, and what is still missing to be sure"
EXAMPLES = (
    "rtrun verdict results/brakes",
    "rtrun verdict results/brakes --deadline 300us --probability 1e-5",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_results(parser, latest=True)
    add_json(parser)
    add_question(parser)


def run(args: argparse.Namespace) -> int:
    """Print the table. Raises UsageError when there is nothing to judge."""

    from rtfiles.output import print_json
    from rtrun.judgement.standings import standings
    from rtrun.report.standings import as_data

    args.results = named_or_latest(args.results)
    study = ask(args, bounds=False)
    if args.json:
        groups = as_data(standings(study))
        data = {"schema": 2, "platform": study.platform, "groups": groups, "left_out": study.left_out}
        print_json(data)
    else:
        print_answers(study)
    return 0


def print_answers(study: "Study") -> None:
    """Print the answers of a study as a table."""
    from rtfiles.output import console, counted, print_line
    from rtrun.judgement.boards import differences, spread
    from rtrun.judgement.standings import standings
    from rtrun.report.screen import print_figures
    from rtrun.report.standings import question, reasons, startups, table
    from rtrun.report.terminal import print_banner

    print_banner(study.platform, study.preempt_rt)
    every = standings(study)
    groups = [standing for standing in every if standing.has_deadline]
    if groups:
        print_line(question(study))
    if groups:
        console().print(table(groups))
    if without := len(every) - len(groups):
        print_figures([group for group in study.answers if group.question is None])
        print_line(f"{counted(without, 'group')} without a deadline: --deadline TIME gives all of them one")
    for text in (*reasons(groups), *startups(groups)):
        print_line(text)
    for group in study.pooled:
        print_line(f"{study.name(group)}: of single boards: {spread(group)}")
    for text in (*differences(study.groups), *(f"not analysed: {text}" for text in study.left_out)):
        print_line(text)
