"""Shared by commands that query an archive: its argument, the deadline, and its courses."""

import argparse
from typing import TYPE_CHECKING

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
    """The deadline, by default that of the thesis, and the series that it applies to."""
    add_of(parser, LATENESS)
    parser.add_argument("--deadline", type=time_argument, metavar="TIME", help="deadline with its unit [400us]")


def reach(address: str) -> "Store":
    """Open the archive at an address. Raises as `check_extra` and `open_archive` do."""
    from rtrun.archive.extra import check_extra

    check_extra()
    from rtrun.archive.store import open_archive

    return open_archive(address)


def read_courses(args: argparse.Namespace) -> "tuple[list[Course], int]":
    """Read every course of the archive, and the deadline in ns that misses are counted against.

    Raises UsageError as `check_extra`, `open_archive` and `read_archive` do, InfrastructureError.
    """
    archive, deadline_ns = read_with_deadline(args)
    from rtrun.archive.courses import courses

    return courses(archive, deadline_ns=deadline_ns, of=args.of), deadline_ns


def read_with_deadline(args: argparse.Namespace) -> "tuple[Archive, int]":
    """Read the archive, and the deadline in ns. Prints a remark on runs that do not count.

    Raises as `read_courses` does.
    """
    from rtfiles.output import counted, print_note
    from rtrun.archive.runs import read_archive
    from rtrun.plan.question import THESIS

    archive = read_archive(reach(args.archive))
    for words, number in archive.ignored.items():
        print_note(f"rtrun: {counted(number, 'run')} ignored: {words}")
    return archive, args.deadline or THESIS.limit_ns
