"""The question that commands ask of results: which deadline, how often, how sure, from how many boots."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rtrun.plan.quantities import read_probability, read_time_ns

if TYPE_CHECKING:
    from rtrun.report.study import Study

T = TypeVar("T")
CONFIDENCE = 0.95


def _argument(read: Callable[[object], T]) -> Callable[[str], T]:
    """Let argparse say what is wrong with a value, in the words of the one who reads it."""

    def read_argument(text: str) -> T:
        try:
            return read(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return read_argument


time_argument = _argument(read_time_ns)
probability_argument = _argument(read_probability)


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Is P(miss) of this deadline below `probability`, at this confidence, on at least so many boots?"""

    deadline_ns: int
    probability: float
    confidence: float
    boots: int


def add_question(parser: argparse.ArgumentParser) -> None:
    """The deadline, the probability of missing it, the confidence; by default the goal of the campaign."""
    goal = "default: the goal of the campaign, else"
    parser.add_argument(
        "--deadline", type=time_argument, metavar="TIME", help=f"deadline with its unit [{goal} 400us, the thesis']"
    )
    parser.add_argument(
        "--probability", type=probability_argument, metavar="P", help=f"P(miss) that must not be reached [{goal} 1e-6]"
    )
    parser.add_argument(
        "--confidence", type=probability_argument, metavar="C", help=f"of every interval [{goal} {CONFIDENCE}]"
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
    """What the arguments ask; what they leave open is the goal of the campaign, or else the thesis' question."""
    from rtrun.report.study import DEADLINE_NS, PROBABILITY
    from rtrun.results.goal_file import read_goal

    goal = read_goal(results)
    return Question(
        deadline_ns=args.deadline or (goal.deadline_ns if goal else DEADLINE_NS),
        probability=args.probability or (goal.probability if goal else PROBABILITY),
        confidence=args.confidence or (goal.confidence if goal else CONFIDENCE),
        boots=goal.boots if goal else 1,
    )


def ask(args: argparse.Namespace, *, bounds: bool = True) -> "Study":
    """Examine what the arguments name."""
    from rtrun.report.study import study

    asked = question(args, args.results)
    return study(
        args.results,
        deadline_ns=asked.deadline_ns,
        probability=asked.probability,
        confidence=asked.confidence,
        boots=asked.boots,
        bounds=bounds,
    )
