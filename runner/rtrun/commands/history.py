"""rtrun history: the course of every quantile and of P(miss), from an archive."""

import argparse
from typing import TYPE_CHECKING, get_args

from rtrun.archive import By
from rtrun.commands._archive import add_archive, add_deadline, read_whole
from rtrun.commands._arguments import add_json

if TYPE_CHECKING:
    from rtrun.archive.queries import Point

HELP = "show how quantiles and P(miss) of each scenario went, by time, kernel, board or commit"
EXAMPLES = (
    "rtrun history archive",
    "rtrun history archive --by kernel --deadline 300us",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    parser.add_argument(
        "--by", choices=get_args(By), default="day", help="what a row is of; boards and kernels stay apart [day]"
    )
    add_deadline(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print a table for each scenario."""
    from itertools import groupby

    from rtfiles.output import print_json, print_line

    archive = read_whole(args)
    from rtrun.archive.history import as_data, print_course
    from rtrun.archive.queries import figures

    points = figures(archive, args.by, deadline_ns=args.deadline, measure=args.measure)
    if args.json:
        print_json(as_data(points, by=args.by, deadline_ns=args.deadline))
        return 0

    def course(point: "Point") -> tuple[str, str, str]:
        return point.scenario, point.parameters, point.platform

    for _, members in groupby(points, course):
        print_course(list(members), by=args.by, deadline_ns=args.deadline)
        print_line()
    return 0
