"""``rtrun build-suites``: the measuring programs, built on a target by its own compiler."""

import argparse
from pathlib import Path

from rtrun.commands._arguments import add_target

HELP = "build the suites on a target, with its own compiler and ROS, for its campaigns"
EXAMPLES = (
    "rtrun build-suites recipes-tests --target board.yml",
    "rtrun build-suites meta-rt-tests/recipes-tests --target board.yml",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sources", type=Path, metavar="FOLDER", help="recipes-tests, the sources of the suites")
    add_target(parser)


def run(args: argparse.Namespace) -> int:
    """Build, and print the build tools. 0: done, 2: wrong target file, 3: the target cannot build them."""
    from rtfiles.output import noting_duration, print_line, print_status
    from rtrun.commands._link import linked
    from rtrun.targets import building
    from rtrun.targets.config import read_target

    config = read_target(args.target)
    print_status(f"building the suites on {config.name}")
    with noting_duration(f"building the suites on {config.name}"), linked(config, args.target.parent) as link:
        built_with = building.build(link, args.sources)
    print_status("")
    for name, value in built_with.items():
        print_line(f"{name} {value}")
    return 0
