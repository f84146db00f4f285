"""``rtgen board``: boards made of Debian's packages."""

import argparse
from pathlib import Path

from rtgen.commands import add_json

HELP = "make a board with a PREEMPT_RT kernel, ROS and SSH, from Debian's packages"
EXAMPLES = (
    "rtgen board machines",
    "rtgen board build --machine qemu-arm64",
)

PLACE = Path("build/board")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``machines`` and ``build`` with its options."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    add_json(actions.add_parser("machines", help="list the machines that a board can be built for"))
    build = actions.add_parser("build", help=f"build it into {PLACE}/MACHINE (network the first time)")
    build.add_argument("--machine", help="one of rtgen board machines; without it the default there")
    build.add_argument(
        "--authorized-key",
        type=Path,
        metavar="FILE",
        help="public keys that may log in, for a card; without it a key that is made beside the image",
    )
    build.add_argument(
        "--suite", help="Debian's suite that packages and kernel come from, as trixie (default: this machine's own)"
    )
    build.add_argument(
        "--kernel",
        default="debian",
        metavar="KIND",
        help="debian: the ready-made one with PREEMPT_RT (default); both: that and the one without; built: the one of "
        "rtgen kernel build, or its version, as 7.2",
    )
    add_json(build)


def run(args: argparse.Namespace) -> int:
    """List the machines, or build the board and print its folder."""
    from rtfiles.output import beside_the_answer, noting_duration, print_json, print_line
    from rtgen.board.build import build
    from rtgen.board.machine import default_machine

    if args.action == "machines":
        _list_machines(as_json=args.json)
        return 0
    machine = args.machine or default_machine()
    with beside_the_answer(args.json), noting_duration(f"building the board {machine}"):
        folder = build(machine, PLACE, args.kernel, login=args.authorized_key, suite=args.suite)
    if args.json:
        print_json({"schema": 1, "machine": machine, "folder": str(folder)})
    else:
        print_line(str(folder))
    return 0


def _list_machines(*, as_json: bool) -> None:
    from rtfiles.output import print_json, print_line
    from rtgen.board.machine import machines

    known = machines()
    if as_json:
        listed = [
            {
                "machine": name,
                "architecture": machine.architecture,
                "summary": machine.summary,
                "is_default": machine.default,
            }
            for name, machine in known.items()
        ]
        print_json({"schema": 1, "machines": listed})
        return
    width = max(map(len, known))
    for name, machine in known.items():
        default = " (default)" if machine.default else ""
        print_line(f"{name:{width}}  {machine.architecture:5}  {machine.summary}{default}")
