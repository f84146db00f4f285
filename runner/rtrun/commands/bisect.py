"""rtrun bisect: which commit or package version to measure next."""

import argparse
import sys
from pathlib import Path

from rtrun.commands._archive import add_archive, add_deadline, read_courses
from rtrun.commands._arguments import add_json
from rtrun.commands._question import add_confidence

HELP = "propose the commit or version to measure next, to find the one that made a scenario worse"
EXAMPLES = (
    "rtrun bisect archive --order commits.txt",
    "rtrun bisect archive --by kernel --order kernels.txt",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    parser.add_argument(
        "--by",
        default="commit",
        metavar="FACT",
        help="commit, image, kernel, or 'package NAME' [commit]",
    )
    parser.add_argument(
        "--order",
        type=Path,
        required=True,
        metavar="FILE",
        help="every commit or version, one a line, oldest first, as git rev-list --reverse HEAD prints; - reads stdin",
    )
    add_deadline(parser)
    add_json(parser)
    add_confidence(parser)


def run(args: argparse.Namespace) -> int:
    """Print a line for each figure that got worse: between which versions, and what to measure next."""
    from rtfiles.errors import UsageError
    from rtfiles.output import counted, print_json, print_line
    from rtfiles.untrusted import read_text

    text = sys.stdin.read() if args.order == Path("-") else read_text(args.order, max_bytes=1 << 26)
    order = list(dict.fromkeys(filter(None, map(str.strip, text.splitlines()))))
    known = read_courses(args)
    from rtrun.archive.bisection import find_suspects

    if not any(run.facts.get(args.by) in order for course in known for run in course.runs):
        raise UsageError(
            f"{args.order}: {counted(len(order), 'line')}, but no {args.by} of a run in {args.archive} among them: "
            f"rtrun archive add takes it with --{args.by.partition(' ')[0]}"
        )
    suspects = [
        suspect for course in known for suspect in find_suspects(course, args.by, order, confidence=args.confidence)
    ]
    if args.json:
        found = [
            {
                "course": suspect.course.label,
                "figure": suspect.figure,
                "good": suspect.good,
                "bad": suspect.bad,
                "not_measured": suspect.between,
                "measure_next": suspect.proposal,
            }
            for suspect in suspects
        ]
        print_json({"schema": 1, "by": args.by, "worse": found})
        return 0
    if not suspects:
        print_line("nothing got worse, as far as these versions are measured")
    for suspect in suspects:
        print_line(f"{suspect.course.label}: {suspect.figure} got worse between {suspect.good} and {suspect.bad}")
        if suspect.proposal:
            print_line(f"    measure {suspect.proposal}: {len(suspect.between)} between them are not measured")
        else:
            print_line(f"    {suspect.bad} is the first one that is worse")
    return 0
