"""rtgen explain: show a profile with everything that follows from it."""

import argparse

from rtgen.commands import DEFAULT_PROFILE

HELP = "show layers, kernels, fragments and files of a profile"
EXAMPLES = (
    "rtgen explain",
    "rtgen explain mine.yml",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("profile", nargs="?", default=DEFAULT_PROFILE, help=f"name or file (….yml) [{DEFAULT_PROFILE}]")


def run(args: argparse.Namespace) -> int:
    from rtfiles.output import print_text
    from rtgen.layer.render import resolve
    from rtgen.profile import load_profile, profile_path

    profile, release = load_profile(args.profile)
    print_text(resolve(profile_path(args.profile).stem, profile, release))
    return 0
