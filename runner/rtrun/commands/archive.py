"""rtrun archive: keep runs of many months and boards in one place."""

import argparse

from rtrun.commands._archive import add_archive
from rtrun.commands._arguments import add_results
from rtrun.commands._question import time_argument

NAME = "archive"
HELP = "keep runs of many months and boards as Parquet files, in a folder or an object store"
EXAMPLES = (
    "rtrun archive add results/brakes --to archive",
    "rtrun archive compact s3://lab/archive",
)
FAILS = "a run was refused"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to do, and what each of that takes."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    add = actions.add_parser("add", help="add the runs of RESULTS that the archive does not have")
    add_results(add, files=False)
    add.add_argument(
        "--to",
        required=True,
        metavar="ARCHIVE",
        help="folder or address, as s3://bucket/archive; a new one is made where nothing is",
    )
    add.add_argument("--samples", action="store_true", help="keep every value too, not only histograms")
    add.add_argument("--commit", metavar="ID", help="commit under test")
    add.add_argument("--image", metavar="NAME", help="image under test")
    add.add_argument(
        "--package",
        action="append",
        default=[],
        type=_package,
        metavar="NAME=VERSION",
        help="package under test and its version, may be repeated",
    )
    add.set_defaults(act=_add)
    compact = actions.add_parser("compact", help="put the files of single runs together, so that an answer takes less")
    add_archive(compact)
    compact.add_argument(
        "--grace",
        type=time_argument,
        metavar="TIME",
        help="how long files stay whose runs are in newer ones, for those who read them [24h]",
    )
    compact.set_defaults(act=_compact)


def _package(text: str) -> tuple[str, str]:
    name, equals, version = text.partition("=")
    if not (name and equals and version):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VERSION")
    return name, version


def run(args: argparse.Namespace) -> int:
    """Do it. 1: runs were refused."""
    from rtrun.archive.extra import check_extra

    check_extra()
    return int(args.act(args))


def _add(args: argparse.Namespace) -> int:
    from rtfiles.output import print_line, print_status
    from rtrun.archive.adding import add_results, find_runs
    from rtrun.archive.store import make_archive
    from rtrun.archive.tables import Origin

    source = find_runs(args.results)  # no archive is made of nothing
    origin = Origin(commit=args.commit, image=args.image, packages=dict(args.package))
    done = add_results(
        source,
        make_archive(args.to),
        origin,
        samples=args.samples,
        on_added=lambda count, total: print_status(f"{count} of {total} runs"),
    )
    print_status("")
    print_line(f"{len(done.added)} runs added, {len(done.present)} were there before, {len(done.refused)} refused")
    for text in done.refused:
        print_line(f"refused  {text}")
    for text in done.notes:
        print_line(f"without measurements  {text}")
    return 1 if done.refused else 0


def _compact(args: argparse.Namespace) -> int:
    from datetime import UTC, datetime, timedelta

    from rtfiles.output import counted, print_line
    from rtrun.archive.compacting import GRACE, compact
    from rtrun.archive.store import make_archive, open_archive

    open_archive(args.archive)
    grace = timedelta(microseconds=args.grace / 1000) if args.grace else GRACE
    done = compact(make_archive(args.archive), grace=grace, now=datetime.now(UTC))
    print_line(f"{counted(done.packed, 'file')} put into {done.packs}, {done.removed} removed")
    if done.waiting:
        print_line(f"{counted(done.waiting, 'file')} with the same runs can be removed when the grace is over")
    return 0
