"""rtrun gate: pass (exit status 0) or fail (1) a campaign, for CI."""

import argparse
from pathlib import Path

from rtrun.commands._question import add_question, ask

NAME = "gate"
HELP = "pass (exit 0) only if every group of runs proves the deadline, else fail (exit 1)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The results, the question, where JUnit XML goes."""
    parser.add_argument("results", type=Path, help="folder of runs, run directory, .log or .npy of a suite")
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
    add_question(parser)


def run(args: argparse.Namespace) -> int:
    """Print one line a case. Raises UsageError when there is nothing to judge."""
    from rtfiles import atomic
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line
    from rtrun.report.answers import print_answers
    from rtrun.report.formats import junit
    from rtrun.report.gate import gate
    from rtrun.report.terminal import print_banner
    from rtrun.target.platform import Platform

    analysed = ask(args, bounds=False)
    judged = gate(analysed, assume_independent=args.assume_independent, platform=Platform(args.platform))
    print_banner(analysed.platform)
    print_line("passed" if judged.passed else "failed")
    print_answers(judged.cases, judged=True)
    if args.junit:
        try:
            atomic.write_text(args.junit, junit(judged))
        except OSError as error:
            raise UsageError(f"{args.junit}: {error.strerror}") from error
    return 0 if judged.passed else 1
