"""rtrun site: static pages about an archive."""

import argparse
from pathlib import Path

from rtrun.commands._archive import add_archive, add_deadline, read_whole
from rtrun.commands._arguments import add_json
from rtrun.commands._question import add_confidence, argument
from rtrun.targets.address import check_server

HELP = "write static pages about an archive: every scenario's state and course, and figures for Grafana"
EXAMPLES = (
    "rtrun site archive --output public",
    "rtrun site archive --output public --deadline 300us",
)


_NOT_ASKED = "Which boards are offline or in quarantine is not known: no labgrid coordinator was asked (--coordinator)."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    parser.add_argument(
        "--output", type=Path, required=True, metavar="FOLDER", help="folder of the pages, made where missing"
    )
    add_deadline(parser)
    add_confidence(parser)
    parser.add_argument(
        "--coordinator",
        type=argument(check_server),
        metavar="HOST:PORT",
        help="of a labgrid farm whose places are on the page of boards, too [LG_COORDINATOR, where that is set]",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Write the pages. Raises OSError when a page cannot be written.

    Raises InfrastructureError where a coordinator does not answer; the pages are then written without its data.
    """
    import os

    from rtfiles.errors import InfrastructureError, UsageError
    from rtfiles.output import print_json, print_line

    archive = read_whole(args)
    from rtrun.archive.courses import courses
    from rtrun.archive.fleet import ask_farm, boards_of
    from rtrun.archive.site import write_site
    from rtrun.archive.trends import trends

    known = courses(archive, deadline_ns=args.deadline, measure=args.measure)
    farm, missing, failure = None, _NOT_ASKED, None
    if coordinator := args.coordinator or os.environ.get("LG_COORDINATOR"):
        try:
            farm, missing = ask_farm(coordinator), ""
        except (InfrastructureError, UsageError) as error:  # UsageError: labgrid is not installed
            missing = f"Which boards are offline or in quarantine is not known: {error}"
            failure = error
    args.output.mkdir(parents=True, exist_ok=True)
    written = write_site(
        args.output,
        args.archive,
        known,
        trends(known, confidence=args.confidence),
        boards_of(archive.runs, farm),
        farm=missing,
        deadline_ns=args.deadline,
        confidence=args.confidence,
    )
    if args.json:
        print_json({"schema": 1, "files": [str(path) for path in written], "farm_not_known": missing or None})
    else:
        print_line(str(written[0]))
    if failure:
        raise failure
    return 0
