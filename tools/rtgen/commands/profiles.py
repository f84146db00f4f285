"""rtgen profiles: list the profiles that come with rtgen."""

import argparse

from rtgen.commands import add_json

HELP = "list the profiles"
EXAMPLES = (
    "rtgen profiles",
    "rtgen explain scarthgap-jazzy",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    from rtfiles.output import print_json, print_line
    from rtgen.commands import DEFAULT_PROFILE
    from rtgen.profile import load_profile, profile_names

    summaries = {name: load_profile(name)[0].summary for name in profile_names()}
    if args.json:
        profiles = [{"profile": name, "summary": summary} for name, summary in summaries.items()]
        print_json({"schema": 1, "default": DEFAULT_PROFILE, "profiles": profiles})
        return 0
    width = max(map(len, summaries))
    for name, summary in summaries.items():
        print_line(f"{name:{width}}  {summary}{' (default)' if name == DEFAULT_PROFILE else ''}")
    return 0
