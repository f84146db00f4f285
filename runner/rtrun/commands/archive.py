"""rtrun archive: keep runs of many months and boards in one place."""

import argparse

from rtrun.commands._arguments import add_results

NAME = "archive"
HELP = "keep runs of many months and boards as Parquet files, in a folder or an object store"
EXAMPLES = (
    "rtrun archive add results/brakes --to archive",
    "rtrun archive add results/brakes --to s3://lab/archive --commit 1a2b3c4",
)
FAILS = "a run was refused"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to do, the results, the archive, and what the results do not hold."""
    parser.add_argument("action", choices=["add"], help="add the runs of RESULTS that the archive does not have")
    add_results(parser, files=False)
    parser.add_argument(
        "--to",
        required=True,
        metavar="ARCHIVE",
        help="folder or address, as s3://bucket/archive; a new one is made where nothing is",
    )
    parser.add_argument("--samples", action="store_true", help="keep every value too, not only histograms")
    parser.add_argument("--commit", metavar="ID", help="commit under test")
    parser.add_argument("--image", metavar="NAME", help="image under test")
    parser.add_argument(
        "--package",
        action="append",
        default=[],
        type=_package,
        metavar="NAME=VERSION",
        help="package under test and its version, may be repeated",
    )


def _package(text: str) -> tuple[str, str]:
    name, equals, version = text.partition("=")
    if not (name and equals and version):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VERSION")
    return name, version


def run(args: argparse.Namespace) -> int:
    """Add runs. 0: every run is in the archive, 1: some were refused."""
    from rtfiles.output import print_line, print_status
    from rtrun.archive.extra import check_extra

    check_extra()
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
