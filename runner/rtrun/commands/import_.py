"""rtrun import: results of other programs, made into run directories."""

import argparse
from pathlib import Path

NAME = "import"
HELP = "make run directories of 2014 logs and of histograms of cyclictest, jitterdebugger and rtla timerlat"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The files, where they go, what they were measured on."""
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="a log, or what one of the programs wrote")
    parser.add_argument("--out", type=Path, default=Path("results/imported"), metavar="DIR", help="[results/imported]")
    parser.add_argument(
        "--platform",
        choices=["hardware", "virtual", "emulated"],
        default="hardware",
        help="what they were measured on [hardware]",
    )


def run(args: argparse.Namespace) -> int:
    """Import every file; one that cannot be read does not stop the others. Raises UsageError naming those."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line
    from rtrun.results.importers.adopt import adopt
    from rtrun.target.platform import Platform

    refused = []
    for path in args.files:
        try:
            for folder, left_out in adopt(path, args.out, platform=Platform(args.platform)):
                print_line(str(folder))
                for text in left_out:
                    print_line(f"    not known: {text}")
        except UsageError as error:
            refused.append(str(error))
    if refused:
        raise UsageError("\n".join(refused))
    return 0
