"""Shared by commands that query an archive: its argument, the deadline, and its courses."""

import argparse
from typing import TYPE_CHECKING

from rtrun.archive import NO_DEADLINE
from rtrun.commands._question import add_of, time_argument
from rtrun.kinds.lateness import LATENESS

if TYPE_CHECKING:
    from rtrun.archive.courses import Course
    from rtrun.archive.runs import Archive
    from rtrun.archive.store import Store


def add_archive(parser: argparse.ArgumentParser) -> None:
    """The archive."""
    parser.add_argument("archive", metavar="ARCHIVE", help="folder or address, as s3://bucket/archive")


def add_deadline(parser: argparse.ArgumentParser) -> None:
    """The deadline, and the series that it applies to."""
    add_of(parser, LATENESS)
    parser.add_argument(
        "--deadline",
        type=time_argument,
        metavar="TIME",
        help="with its unit, as 1ms; misses of it count [none: quantiles alone]",
    )


def reach(address: str) -> "Store":
    """Open the archive at an address. Raises as `check_extra` and `open_archive` do."""
    from rtrun.archive.extra import check_extra

    check_extra()
    from rtrun.archive.store import open_archive

    return open_archive(address)


def read_courses(args: argparse.Namespace) -> "list[Course]":
    """Read every course of the archive. Raises as `read_whole` does."""
    archive = read_whole(args)
    from rtrun.archive.courses import courses

    return courses(archive, deadline_ns=args.deadline, measure=args.measure)


def read_whole(args: argparse.Namespace) -> "Archive":
    """Read the archive; print a remark on runs that do not count, and on how to ask where no deadline is given.

    Raises UsageError as `check_extra`, `open_archive` and `read_archive` do, InfrastructureError.
    """
    from rtfiles.output import counted, print_note
    from rtrun.archive.runs import read_archive

    archive = read_archive(reach(args.archive))
    for words, number in archive.ignored.items():
        print_note(f"rtrun: {counted(number, 'run')} ignored: {words}")
    if not args.deadline:
        print_note(f"rtrun: {NO_DEADLINE}")
    return archive
