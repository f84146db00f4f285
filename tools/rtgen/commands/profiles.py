"""rtgen profiles: list the profiles that come with rtgen."""

import argparse

HELP = "list the profiles"
EXAMPLES = (
    "rtgen profiles",
    "rtgen explain scarthgap-jazzy",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    del parser


def run(args: argparse.Namespace) -> int:
    from rtfiles.output import print_line
    from rtgen.commands import DEFAULT_PROFILE
    from rtgen.profile import load_profile, profile_names

    del args
    width = max(len(name) for name in profile_names())
    for name in profile_names():
        profile, _ = load_profile(name)
        print_line(f"{name:{width}}  {profile.summary}{' (default)' if name == DEFAULT_PROFILE else ''}")
    return 0
