"""The question that commands ask about results: which deadline, how often, how sure, from how many boots."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, get_args

from rtrun.kinds.lateness import Of
from rtrun.plan.quantities import read_probability, read_time_ns
from rtrun.plan.question import NO_DEADLINE, Question, may_follow, read_bursts, read_tolerance

if TYPE_CHECKING:
    from rtrun.judgement.study import Study

T = TypeVar("T")
CONFIDENCE = NO_DEADLINE.confidence


def argument(read: Callable[[str], T]) -> Callable[[str], T]:
    """Let argparse print what is wrong with a value, in the words of its reader."""

    def read_argument(text: str) -> T:
        try:
            return read(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return read_argument


time_argument = argument(read_time_ns)
probability_argument = argument(read_probability)


def add_question(parser: argparse.ArgumentParser) -> None:
    """The deadline, the probability of missing it, the confidence; by default the goal of the campaign."""
    goal = "default: the goal of the campaign, else"
    add_of(parser, "default: that of the campaign's goal, else lateness")
    parser.add_argument(
        "--tolerate",
        type=argument(read_tolerance),
        metavar="MISSES",
        help=f"misses that do not count, as '2 in a row' or '3 of 100' [{goal} none]",
    )
    parser.add_argument(
        "--deadline", type=time_argument, metavar="TIME", help=f"deadline with its unit [{goal} figures alone]"
    )
    parser.add_argument(
        "--probability", type=probability_argument, metavar="P", help=f"P(miss) that must not be reached [{goal} 1e-6]"
    )
    parser.add_argument(
        "--confidence", type=probability_argument, metavar="C", help=f"of every interval [{goal} {CONFIDENCE}]"
    )
    parser.add_argument(
        "--bursts",
        type=argument(read_bursts),
        metavar="N",
        help=f"misses in a row that a proof has to cover, even if none was seen; 1: misses come singly [{goal} those "
        "of a stall of 10 ms]",
    )


def add_of(parser: argparse.ArgumentParser, default: str) -> None:
    """Which values of the cyclic timer the deadline applies to."""
    parser.add_argument(
        "--of",
        dest="measure",
        choices=get_args(Of),
        help=f"what the deadline of the cyclic timer is of; all else is late [{default}]",
    )


def add_confidence(parser: argparse.ArgumentParser) -> None:
    """The confidence of every interval."""
    parser.add_argument(
        "--confidence",
        type=probability_argument,
        default=CONFIDENCE,
        metavar="C",
        help=f"of every interval [{CONFIDENCE}]",
    )


def question(args: argparse.Namespace, results: Path) -> Question:
    """The question in the arguments; what they leave open comes from the campaign's goal, else from `NO_DEADLINE`."""
    from rtfiles.output import print_note
    from rtrun.results.goal_file import read_goal

    goal = read_goal(results)
    before = goal.question if goal else NO_DEADLINE
    given = {
        "of": args.measure,
        "tolerance": args.tolerate,
        "deadline_ns": args.deadline,
        "probability": args.probability,
        "confidence": args.confidence,
        "bursts": args.bursts,
    }
    asked = replace(before, **{key: value for key, value in given.items() if value})
    if goal and not may_follow(before, asked):
        print_note(
            f"rtrun: measured for P({before.miss}): the answer to another question, chosen after looking, is less sure "
            "than it says"
        )
    return asked


def ask(args: argparse.Namespace, *, bounds: bool = True) -> "Study":
    """Examine the results that the arguments name."""
    from rtrun.judgement.study import study

    return study(args.results, question(args, args.results), bounds=bounds)
