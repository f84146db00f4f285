"""rtrun bisect: which commit or package version to measure next."""

import argparse
import sys
from pathlib import Path

from rtrun.commands._question import add_confidence, time_argument

NAME = "bisect"
HELP = "propose the commit or version to measure next, to find the one that made a scenario worse"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The archive, what is bisected, the order of its versions, the deadline."""
    parser.add_argument("archive", metavar="ARCHIVE", help="folder or address, as s3://bucket/archive")
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
    parser.add_argument("--deadline", type=time_argument, metavar="TIME", help="deadline with its unit [400us]")
    add_confidence(parser)


def run(args: argparse.Namespace) -> int:
    """Print a line for each figure that got worse: between which versions, and what to measure next."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line
    from rtfiles.untrusted import read_text
    from rtrun.archive.extra import check_extra

    check_extra()
    from rtrun.archive.bisection import find_suspects
    from rtrun.archive.courses import courses
    from rtrun.archive.queries import connected
    from rtrun.archive.store import open_archive
    from rtrun.report.study import DEADLINE_NS

    text = sys.stdin.read() if args.order == Path("-") else read_text(args.order, max_bytes=1 << 26)
    order = list(dict.fromkeys(filter(None, map(str.strip, text.splitlines()))))
    with connected(open_archive(args.archive)) as archive:
        known = courses(archive, deadline_ns=args.deadline or DEADLINE_NS)
    if not any(run.facts.get(args.by) in order for course in known for run in course.runs):
        raise UsageError(
            f"{args.order}: none of its {len(order)} lines is the {args.by} of a run in {args.archive}: "
            f"rtrun archive add takes it with --{args.by.partition(' ')[0]}"
        )
    suspects = [one for course in known for one in find_suspects(course, args.by, order, confidence=args.confidence)]
    if not suspects:
        print_line("nothing got worse, as far as these versions are measured")
    for one in suspects:
        print_line(f"{one.course.label}: {one.figure} got worse between {one.good} and {one.bad}")
        if one.proposal:
            print_line(f"    measure {one.proposal}: {len(one.between)} between them are not measured")
        else:
            print_line(f"    {one.bad} is the first one that is worse")
    return 0
