"""rtrun gate: pass (exit status 0) or fail (1) a campaign, for CI."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rtrun.commands._archive import reach
from rtrun.commands._arguments import add_json, add_results, add_verbose
from rtrun.commands._question import add_question, ask, probability_argument, question, time_argument

if TYPE_CHECKING:
    from rtrun.judgement.gate import Gate

HELP = (
    "pass (exit 0) only if every group of runs proves the deadline, or is no worse than its history, else fail (exit 1)"
)
EXAMPLES = (
    "rtrun gate results/brakes --junit gate.xml",
    "rtrun gate results/brakes --against archive",
)
FAILS = "not every group of runs passed"
FALSE_ALARMS = 0.05


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_results(parser)
    add_json(parser)
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write the cases as JUnit XML")
    parser.add_argument(
        "--assume-independent",
        action="store_true",
        help="let histograms and logs pass too, which keep no order, so that bursts in them cannot be seen",
    )
    parser.add_argument(
        "--platform",
        choices=["hardware", "virtual"],
        default="hardware",
        help="virtual: let proofs from virtual machines pass too, which hold for that machine on that host alone",
    )
    parser.add_argument(
        "--max-page-faults",
        type=int,
        metavar="N",
        help="fail where a program had more page faults while it measured, as 0 [not asked]",
    )
    parser.add_argument(
        "--max-allocations",
        type=int,
        metavar="N",
        help="fail where a program allocated memory more often while it measured, as 0; of runs with allocations: "
        "counted [not asked]",
    )
    parser.add_argument(
        "--against",
        metavar="ARCHIVE",
        help="ask instead whether the runs are worse than their history in this archive",
    )
    parser.add_argument(
        "--margin",
        type=time_argument,
        metavar="TIME",
        help="with --against: a shift that is of no concern, as 5us; two standard deviations of the history's boots "
        "at least [5 %% of the history's figure, at least 1us]",
    )
    parser.add_argument(
        "--false-alarms",
        type=probability_argument,
        metavar="P",
        help=f"with --against: chance that any in a year of daily gates is WORSE by mistake [{FALSE_ALARMS}]",
    )
    add_question(parser)
    parser.add_argument(
        "--instead-of-goal",
        action="store_true",
        help="let a question decide that asks less than the goal of the campaign, which else fails",
    )
    add_verbose(parser)


def run(args: argparse.Namespace) -> int:
    """Print one line per case. Raises UsageError when there is nothing to judge."""
    from dataclasses import asdict

    from rtfiles import atomic
    from rtfiles.errors import UsageError
    from rtfiles.output import print_json, print_line
    from rtrun.judgement.gate import gate
    from rtrun.report.formats import junit
    from rtrun.report.screen import print_answers, print_styled
    from rtrun.report.terminal import print_banner
    from rtrun.results.goal_file import read_goal
    from rtrun.targets.inspection.platform import Platform

    asked = ""
    if args.against:
        judged = _against(args)
    elif args.margin or args.false_alarms:
        raise UsageError("--margin, --false-alarms: go with --against ARCHIVE")
    else:
        analysed = ask(args, bounds=False)
        goal = None if args.instead_of_goal else read_goal(args.results)
        judged = gate(
            analysed,
            assume_independent=args.assume_independent,
            platform=Platform(args.platform),
            max_page_faults=args.max_page_faults,
            max_allocations=args.max_allocations,
            goal=goal.question if goal else None,
        )
        if not args.json:
            print_banner(analysed.platform, analysed.preempt_rt)
            asked = analysed.asked_in_full
    if args.json:
        print_json({"schema": 1, "passed": judged.passed, "cases": [asdict(case) for case in judged.cases]})
    else:
        print_styled("passed" if judged.passed else "failed")
        if asked:
            print_line(f"asked: {asked}")
        print_answers(judged.cases, verbose=args.verbose)
    if args.junit:
        atomic.write_named(args.junit, junit(judged).encode("utf-8", "replace"))
    return 0 if judged.passed else 1


def _against(args: argparse.Namespace) -> "Gate":
    from rtfiles.errors import UsageError
    from rtfiles.output import print_note
    from rtrun.targets.inspection.platform import Platform

    limits = (args.max_page_faults, args.max_allocations)
    of_deadline = (args.probability, args.confidence, args.bursts, args.tolerate, args.assume_independent, *limits)
    if any(value not in (None, False) for value in of_deadline):
        raise UsageError(
            "--probability, --confidence, --bursts, --tolerate, --assume-independent, --max-page-faults, "
            "--max-allocations: go without --against"
        )
    archive = reach(args.against)
    from rtrun.archive import NO_DEADLINE
    from rtrun.archive.against import gate_against

    asked = question(args, args.results)
    if asked.deadline_ns is None:
        print_note(f"rtrun: {NO_DEADLINE}")
    return gate_against(
        args.results,
        archive,
        deadline_ns=asked.deadline_ns,
        measure=asked.of,
        margin_ns=args.margin,
        false_alarms=args.false_alarms or FALSE_ALARMS,
        platform=Platform(args.platform),
    )
