"""rtgen explain: show a profile with everything that follows from it."""

import argparse

from rtgen.commands import DEFAULT_PROFILE, add_json

HELP = "show layers, kernels, fragments and files of a profile"
EXAMPLES = (
    "rtgen explain",
    "rtgen explain mine.yml",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("profile", nargs="?", default=DEFAULT_PROFILE, help=f"name or file (….yml) [{DEFAULT_PROFILE}]")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    import yaml

    from rtfiles.output import print_json, print_text
    from rtgen.layer.render import resolve
    from rtgen.profile import load_profile, profile_path

    profile, release = load_profile(args.profile)
    explained = resolve(profile_path(args.profile).stem, profile, release)
    if args.json:
        print_json({**explained, "schema": 1})
    else:
        print_text(yaml.safe_dump(explained, sort_keys=False, width=120, allow_unicode=True))
    return 0
