"""rtrun import: results of other programs, converted into run directories."""

import argparse
from pathlib import Path
from typing import Any

from rtrun.commands._arguments import add_json
from rtrun.commands._question import time_argument
from rtrun.plan.quantities import whole_interval_us

HELP = "make run directories of 2014 logs and of what cyclictest, jitterdebugger, rtla timerlat and rteval wrote"
EXAMPLES = (
    "rtrun import cyclictest.hist --platform hardware --board farm-7 --interval 200us",
    "rtrun import 2014.log --platform hardware --results results/2014",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="a log, or what one of the programs wrote")
    parser.add_argument(
        "--results", type=Path, default=Path("results/imported"), metavar="FOLDER", help="[results/imported]"
    )
    parser.add_argument(
        "--platform",
        choices=["hardware", "virtual", "emulated"],
        required=True,
        help="what they were measured on",
    )
    parser.add_argument("--board", default="", metavar="NAME", help="the board that they were measured on")
    parser.add_argument("--kernel", default="", metavar="RELEASE", help="its kernel, as uname -r has it")
    parser.add_argument("--boot", default="", metavar="ID", help="the boot; runs of an unknown one are a boot each")
    parser.add_argument("--start", default="", metavar="TIME", help="when they were begun, as 2026-11-23T10:00:00")
    parser.add_argument(
        "--interval",
        type=time_argument,
        metavar="TIME",
        help="between two wake-ups of a thread, as 200us, where the files do not state it",
    )
    parser.add_argument(
        "--unit", choices=["ns", "us"], help="of their values, where the files do not state it: ns with cyclictest -N"
    )
    parser.add_argument(
        "--names",
        metavar="PATTERN",
        help="read these from the files' names, as '{board}-{kernel}-{start}.txt'; with folders '{board}/{start}.txt'",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Import every file; an unreadable file does not stop the others. Raises UsageError naming such files."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_json, print_line
    from rtrun.results.importers.adopt import adopt
    from rtrun.results.importers.given import UNITS_NS, Given
    from rtrun.results.importers.identity import FIELDS, Identity, read_pattern
    from rtrun.results.latest import set_latest
    from rtrun.results.record import read_record
    from rtrun.targets.inspection.platform import Platform

    where = {name: getattr(args, name) for name in FIELDS}
    try:
        interval_us = whole_interval_us(args.interval) if args.interval else None
    except ValueError as error:
        raise UsageError(f"--interval: {error}") from error
    given = Given(unit_ns=UNITS_NS[args.unit] if args.unit else None, interval_us=interval_us)
    pattern = read_pattern(args.names) if args.names else None
    refused: list[str] = []
    unknown: dict[str, list[str]] = {}
    runs: list[dict[str, Any]] = []
    for path in args.files:
        try:
            identity = Identity(**{**where, **(pattern.read(path) if pattern else {})})
            called = pattern.name_of(path) if pattern else None
            adopted = adopt(
                path, args.results, platform=Platform(args.platform), identity=identity, called=called, given=given
            )
            set_latest(args.results)
            for folder, left_out in adopted:
                record = read_record(folder)
                runs.append(
                    {
                        "run": str(folder),
                        "file": str(path),
                        "status": record.status,
                        "reason": record.reason,
                        "not_known": list(left_out),
                    }
                )
                if args.json:
                    continue
                failed = f": {record.status}: {record.reason}" if record.reason else ""
                print_line(f"{folder}{failed}")
                for text in left_out:
                    unknown.setdefault(text, []).append(folder.name)
        except UsageError as error:
            refused.append(str(error))
    if args.json:
        print_json({"schema": 1, "runs": runs, "refused": refused})
    # Printed once for all files: there may be years of them.
    for text, names in unknown.items():
        print_line(f"    not known of {names[0] if len(names) == 1 else f'{len(names)} runs'}: {text}")
    if refused:
        raise UsageError("\n".join(refused))
    return 0
