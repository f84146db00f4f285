"""rtrun archive: keep runs of many months and boards in one place."""

import argparse
from typing import TYPE_CHECKING, Any, TypeVar

from rtrun.commands._archive import add_archive
from rtrun.commands._arguments import add_results
from rtrun.commands._question import argument, time_argument
from rtrun.plan.quantities import read_days

if TYPE_CHECKING:
    from datetime import datetime

    from rtrun.archive.notes import NoteHead

    NoteT = TypeVar("NoteT", bound=NoteHead)

HELP = "keep runs of many months and boards as Parquet files, in a folder or an object store"
EXAMPLES = (
    "rtrun archive add results/brakes --to archive",
    "rtrun archive compact s3://lab/archive",
)
FAILS = "a run was refused"
_TOLD_BY = {
    "machine": ("--machine", "boards"),
    "scenario": ("--scenario", "scenarios, as history names them"),
    "kernel_release": ("--kernel", "kernels"),
    "commit": ("--commit", "commits"),
    "image": ("--image", "images"),
    "boot_id": ("--boot", "boots, by their id"),
    "run": ("--run", "runs, by their names"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
    _add_annotate(
        actions.add_parser("annotate", help="say what others should know of runs; without options: list that")
    )
    retain = actions.add_parser("retain", help="say how long a table's rows are kept, for compact to go by")
    add_archive(retain)
    retain.add_argument("table", choices=["samples", "histograms", "runs"], help="runs: all of a run")
    retain.add_argument(
        "age", type=argument(read_days), metavar="AGE", help="since the run was begun, as 90d, or forever"
    )
    _add_who(retain)
    retain.set_defaults(act=_retain)


def _add_annotate(parser: argparse.ArgumentParser) -> None:
    add_archive(parser)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--ignore", action="store_true", help="these runs count in no answer")
    what.add_argument(
        "--accept",
        action="store_true",
        help="the level from --from on is as it should be: what was before counts no more",
    )
    what.add_argument(
        "--known",
        action="store_true",
        help="what got worse up to now, or a board in quarantine, is known: nobody is called for it",
    )
    what.add_argument("--withdraw", metavar="NAME", help="a note that no longer holds, by its name in the list")
    _add_who(parser)
    for name, (option, noun) in _TOLD_BY.items():
        parser.add_argument(
            option, dest=f"of_{name}", type=_pattern, metavar="PATTERN", help=f"which {noun}, as 'board-*' [all]"
        )
    parser.add_argument(
        "--from", dest="begin", type=_moment, metavar="TIME", help="first start, UTC, as 2026-11-24T10:00"
    )
    parser.add_argument(
        "--to", dest="end", type=_moment, metavar="TIME", help="with --ignore: the start from which on not"
    )
    parser.set_defaults(act=_annotate)


def _add_who(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--reason", metavar="TEXT", help="why, for whoever reads it later")
    parser.add_argument("--who", metavar="NAME", help="who says so [the user]")


def _pattern(text: str) -> str:
    if not text:  # from a shell variable that is not set: it would match everything
        raise argparse.ArgumentTypeError("an empty pattern fits nothing: for all of them leave the option out")
    return text


def _moment(text: str) -> "datetime":
    from datetime import datetime

    try:
        return datetime.fromisoformat(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no time, as 2026-11-24 or 2026-11-24T10:00") from error


def _package(text: str) -> tuple[str, str]:
    name, equals, version = text.partition("=")
    if not (name and equals and version):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VERSION")
    return name, version


def run(args: argparse.Namespace) -> int:
    """Run the sub-command. Returns 1 if runs were refused."""
    from rtrun.archive.extra import check_extra

    check_extra()
    return int(args.act(args))


def _add(args: argparse.Namespace) -> int:
    from rtfiles.output import print_line, print_status
    from rtrun.archive.adding import add_results, find_runs
    from rtrun.archive.store import make_archive
    from rtrun.archive.tables import Origin

    source = find_runs(args.results)  # do not make an archive without runs
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


def _note(args: argparse.Namespace, kind: "type[NoteT]", /, **fields: Any) -> "NoteT":
    """A note with its author, its time and its reason."""
    import getpass
    from datetime import UTC, datetime

    from rtfiles.config import parse
    from rtfiles.errors import UsageError

    if not args.reason:
        raise UsageError("--reason: say why, for whoever reads it later")
    try:
        who = args.who or getpass.getuser()
    except (KeyError, OSError) as error:  # a container may run under a number that has no name
        raise UsageError("--who: name yourself, the user that this runs as has no name") from error
    at = datetime.now(UTC).replace(tzinfo=None, microsecond=0)
    return parse({"at": at, "who": who, "reason": args.reason, **fields}, kind, "the note")


def _retain(args: argparse.Namespace) -> int:
    from rtfiles.output import print_line
    from rtrun.archive.notes import RetainNote, add_note, in_words
    from rtrun.archive.store import open_archive

    note = _note(args, RetainNote, table=args.table, days=args.age)
    print_line(in_words(add_note(open_archive(args.archive), note), note))
    return 0


def _annotate(args: argparse.Namespace) -> int:
    from functools import partial

    from rtfiles.errors import UsageError
    from rtfiles.output import counted, print_line
    from rtrun.archive import notes
    from rtrun.archive.runs import read_runs
    from rtrun.archive.store import open_archive

    store = open_archive(args.archive)
    held = notes.read_notes(store).held
    chosen = {name: pattern for name in _TOLD_BY if (pattern := getattr(args, f"of_{name}"))}
    if args.withdraw:
        if args.withdraw not in held:
            raise UsageError(
                f"{args.archive}: no note {args.withdraw!r}: rtrun archive annotate {args.archive} lists them"
            )
        notes.add_note(store, _note(args, notes.WithdrawNote, note=args.withdraw))
        print_line(f"withdrawn: {notes.in_words(args.withdraw, held[args.withdraw])}")
    elif args.accept:
        if args.begin is None or args.end or not {*chosen} <= {"machine", "scenario"}:
            raise UsageError("--accept takes --from TIME, and --machine and --scenario alone beside it")
        accept = _note(args, notes.AcceptNote, **chosen, begin=args.begin)
        number = sum(notes.fits_course(accept, row.machine, row.scenario) for row in read_runs(store))
        if not number:
            raise UsageError(f"{args.archive}: no run is of these boards and scenarios")
        print_line(notes.in_words(notes.add_note(store, accept), accept))
    elif args.known:
        if args.begin or args.end or not chosen or not {*chosen} <= {"machine", "scenario"}:
            raise UsageError("--known takes --machine, --scenario or both, and no time: it is of what is wrong now")
        known = _note(args, notes.KnownNote, **chosen)
        fitting = (row for row in read_runs(store) if notes.fits_course(known, row.machine, row.scenario))
        if "scenario" in chosen and not any(fitting):
            raise UsageError(f"{args.archive}: no run is of these boards and scenarios")
        print_line(notes.in_words(notes.add_note(store, known), known))
    elif args.ignore:
        if not (chosen or args.begin or args.end):
            raise UsageError("--ignore: say which runs, as --machine board-3 --from 2026-11-20")
        ignore = _note(args, notes.IgnoreNote, **chosen, begin=args.begin, end=args.end)
        rows = read_runs(store)
        number = sum(notes.fits_run(ignore, partial(getattr, row), row.start_utc) for row in rows)
        if not number:
            raise UsageError(f"{args.archive}: these are no runs of it")
        print_line(f"{counted(number, 'run')} of {len(rows)}: {notes.in_words(notes.add_note(store, ignore), ignore)}")
    elif chosen or args.begin or args.end or args.reason:
        raise UsageError("say what of these runs: --ignore, --accept or --known")
    else:
        for name, note in held.items():
            print_line(notes.in_words(name, note))
    return 0
