"""``rtgen suites``: the measuring programs."""

import argparse
from pathlib import Path

from rtgen.commands import add_json

HELP = "build the measuring programs for this machine or a board"
EXAMPLES = (
    "rtgen suites build",
    "rtgen suites build --on board.yml",
)

PLACE = Path("build/suites")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare ``build --machine NAME --suite SUITE --ros2 PREFIX --on TARGET.yml``."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    build = actions.add_parser("build", help=f"build them into {PLACE}/MACHINE")
    build.add_argument("--machine", help="host, or a board of rtgen board (default: host)")
    build.add_argument(
        "--suite", help="Debian's suite that the board was built from, as trixie (default: this machine's own)"
    )
    build.add_argument(
        "--ros2", type=Path, metavar="PREFIX", help="of this machine, as /opt/ros/jazzy: build the programs on it, too"
    )
    build.add_argument(
        "--on", type=Path, metavar="TARGET.yml", help="build them there, with the target's own compiler and ROS"
    )
    add_json(build)


def run(args: argparse.Namespace) -> int:
    """Build the suites; print what could not be built, and their folder or what a target built with."""
    import json

    from rtfiles.errors import UsageError
    from rtfiles.output import beside_the_answer, noting_duration, print_json, print_line, print_note
    from rtgen.suites import HOST, build, build_on

    if args.on:
        if args.json:
            raise UsageError("--json goes without --on: rtrun build-suites says what a target built with")
        if args.machine or args.suite or args.ros2:
            raise UsageError("--on goes without --machine, --suite and --ros2: the target has what it has")
        return build_on(args.on)
    machine = args.machine or HOST
    with beside_the_answer(args.json), noting_duration(f"building the suites for {machine}"):
        folder = build(machine, PLACE, args.suite, args.ros2 and args.ros2.resolve())
    not_built = json.loads((folder / "build.json").read_text())["not_built"]
    if args.json:
        print_json({"schema": 1, "machine": machine, "folder": str(folder), "not_built": not_built})
        return 0
    for name, needed in not_built.items():
        print_note(f"{name} is not among them: it needs {' and '.join(needed)}")
    print_line(str(folder))
    return 0
