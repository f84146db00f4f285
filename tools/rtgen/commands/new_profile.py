"""rtgen new-profile: copy a profile as the start of another one."""

import argparse
import os
from pathlib import Path

from rtgen.commands import DEFAULT_PROFILE, add_json

HELP = "copy a profile to a file of your own, to edit"
EXAMPLES = (
    "rtgen new-profile mine.yml",
    "rtgen new-profile mine.yml --from scarthgap-jazzy",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="file to write, ending in .yml; must not exist")
    parser.add_argument(
        "--from", dest="origin", default=DEFAULT_PROFILE, metavar="PROFILE", help=f"[{DEFAULT_PROFILE}]"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    from rtfiles import atomic
    from rtfiles.errors import UsageError
    from rtfiles.invocation import as_called
    from rtfiles.output import print_json, print_line
    from rtgen.profile import load_profile, profile_path

    if args.file.suffix != ".yml":
        raise UsageError(f"{args.file}: the name of a profile's file ends in .yml")
    if os.path.lexists(args.file):
        raise UsageError(f"{args.file}: exists, choose another name")
    if not args.file.parent.is_dir():
        raise UsageError(f"{args.file.parent}: no such folder")
    load_profile(args.origin)  # an invalid profile is not copied
    text = profile_path(args.origin).read_text(encoding="utf-8")
    atomic.write_text(args.file, f"# Derived from {args.origin}.\n{text}")
    if args.json:
        print_json({"schema": 1, "file": str(args.file), "from": args.origin})
        return 0
    next_command = f"{as_called('rtgen')} render --profile {args.file} --output DIR"
    print_line(f"{args.file}: a copy of {args.origin}; edit it, then: {next_command}")
    return 0
