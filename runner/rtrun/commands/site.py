"""rtrun site: static pages about an archive."""

import argparse
from pathlib import Path

from rtrun.commands._archive import add_archive, add_deadline, read_courses
from rtrun.commands._question import add_confidence

NAME = "site"
HELP = "write static pages about an archive: every scenario's state and course, and figures for Grafana"
EXAMPLES = (
    "rtrun site archive --output public",
    "rtrun site archive --output public --deadline 300us",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The archive, the folder, the deadline, the confidence."""
    add_archive(parser)
    parser.add_argument(
        "--output", type=Path, required=True, metavar="FOLDER", help="folder of the pages, made where missing"
    )
    add_deadline(parser)
    add_confidence(parser)


def run(args: argparse.Namespace) -> int:
    """Write the pages. Raises OSError when one cannot be written."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line

    known, deadline_ns = read_courses(args)
    from rtrun.archive.site import write_site
    from rtrun.archive.trends import trends

    if not known:
        raise UsageError(f"{args.archive}: no run in it has a time, so there is no course to show")
    args.output.mkdir(parents=True, exist_ok=True)
    written = write_site(
        args.output,
        args.archive,
        known,
        trends(known, confidence=args.confidence),
        deadline_ns=deadline_ns,
        confidence=args.confidence,
    )
    print_line(str(written[0]))
    return 0
