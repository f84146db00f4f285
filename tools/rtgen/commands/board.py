"""``rtgen board``: the emulated board."""

import argparse
from pathlib import Path

NAME = "board"
HELP = "make an emulated ARM board with a PREEMPT_RT kernel, ROS and SSH, from Debian's packages"

PLACE = Path("build/board")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``build --machine NAME --kernel KIND``."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    build = actions.add_parser("build", help=f"build it into {PLACE}/MACHINE (network the first time)")
    build.add_argument("--machine", help="board to emulate; without it the default of docs/board.md")
    build.add_argument(
        "--kernel",
        choices=("debian", "built"),
        default="debian",
        help="Debian's ready-made one (default), or the one of rtgen kernel build",
    )


def run(args: argparse.Namespace) -> int:
    """Build the board and print its folder."""
    from rtfiles.output import print_line
    from rtgen.board.build import build
    from rtgen.board.machine import machines

    print_line(str(build(args.machine or machines().default, PLACE, built=args.kernel == "built")))
    return 0
