"""The question that report, gate and claims ask of results: which deadline, how often, how sure."""

import argparse
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rtrun.report.study import Study

_UNITS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


def time_ns(text: str) -> int:
    """Read a time with its unit, as 400us or 1.5ms, into ns."""
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)(ns|us|ms|s)", text)
    if not found or float(found[1]) <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no time above 0 with its unit, as 400us or 1.5ms")
    return round(float(found[1]) * _UNITS[found[2]])


def share(text: str) -> float:
    """Read a probability, both ends excluded."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no number between 0 and 1, as 1e-6 or 0.95")
    return value


def add_question(parser: argparse.ArgumentParser) -> None:
    """The deadline, the probability of missing it, the confidence."""
    parser.add_argument(
        "--deadline", type=time_ns, default=400_000, metavar="TIME", help="deadline with its unit [400us, the thesis']"
    )
    parser.add_argument(
        "--probability", type=share, default=1e-6, metavar="P", help="P(miss) that must not be reached [1e-6]"
    )
    add_confidence(parser)


def add_confidence(parser: argparse.ArgumentParser) -> None:
    """The confidence of every interval and verdict."""
    parser.add_argument("--confidence", type=share, default=0.95, metavar="C", help="of every interval [0.95]")


def ask(args: argparse.Namespace, *, bounds: bool = True) -> "Study":
    """Examine what the arguments name."""
    from rtrun.report.study import study

    return study(
        args.results,
        deadline_ns=args.deadline,
        probability=args.probability,
        confidence=args.confidence,
        bounds=bounds,
    )
