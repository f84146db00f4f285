"""rtrun site: static pages about an archive."""

import argparse
from pathlib import Path

from rtrun.commands._question import add_confidence, time_argument

NAME = "site"
HELP = "write static pages about an archive: every scenario's state and course, and figures for Grafana"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The archive, the folder, the deadline, the confidence."""
    parser.add_argument("archive", metavar="ARCHIVE", help="folder or address, as s3://bucket/archive")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder of the pages, made where missing"
    )
    parser.add_argument("--deadline", type=time_argument, metavar="TIME", help="deadline with its unit [400us]")
    add_confidence(parser)


def run(args: argparse.Namespace) -> int:
    """Write the pages. Raises OSError when one cannot be written."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line
    from rtrun.archive.extra import check_extra

    check_extra()
    from rtrun.archive.courses import courses
    from rtrun.archive.queries import connected
    from rtrun.archive.site import write_site
    from rtrun.archive.store import open_archive
    from rtrun.archive.trends import trends
    from rtrun.report.study import DEADLINE_NS

    deadline_ns = args.deadline or DEADLINE_NS
    with connected(open_archive(args.archive)) as archive:
        known = courses(archive, deadline_ns=deadline_ns)
    if not known:
        raise UsageError(f"{args.archive}: no run in it has a time, so there is no course to show")
    args.out.mkdir(parents=True, exist_ok=True)
    written = write_site(
        args.out,
        args.archive,
        known,
        trends(known, confidence=args.confidence),
        deadline_ns=deadline_ns,
        confidence=args.confidence,
    )
    print_line(str(written[0]))
    return 0
