"""rtgen render: write the layer and kas.yml of a profile, or compare them with it."""

import argparse
from pathlib import Path

from rtgen.commands import DEFAULT_PROFILE, add_json

HELP = "write meta-rt-tests/ and kas.yml from a profile, and what the suites' programs know of suites.yml"
EXAMPLES = (
    "rtgen render --check",
    "rtgen render --profile mine.yml --output ../mine",
)
FAILS = "with --check: something differs"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--profile", default=DEFAULT_PROFILE, help=f"name or file (….yml) [{DEFAULT_PROFILE}]")
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="folder to write to [this repository]")
    parser.add_argument(
        "--check", action="store_true", help="write nothing, show differences; exit status 1 if there are any"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    from rtfiles.output import print_json, print_line, print_note, print_text
    from rtgen.checkout import checkout
    from rtgen.layer import output
    from rtgen.layer.programs import render_programs
    from rtgen.layer.render import render
    from rtgen.profile import load_profile, profile_path

    out = args.output or checkout()
    profile, release = load_profile(args.profile)
    tree = render(profile_path(args.profile).stem, profile, release, prefix=output.prefix_in_git(out))
    if not args.output:
        tree |= render_programs()
    facts = {"schema": 1, "profile": args.profile, "folder": str(out), "files": len(tree)}
    if args.check:
        difference = output.differences(tree, out)
        if args.json:
            print_json(facts | {"difference": difference})
            return int(bool(difference))
        if difference:
            print_text(difference)
            print_note(f"rtgen: {out} is not what profile {args.profile} renders")
            return 1
        print_line(f"{out}: {len(tree)} files, as profile {args.profile} renders them")
        return 0
    done = output.write(tree, out)
    if args.json:
        removed, linked = ([str(path) for path in paths] for paths in (done.removed, done.linked))
        print_json(facts | {"written": done.written, "removed": removed, "linked": linked})
        return 0
    print_line(
        f"{out}: {len(tree)} files of profile {args.profile}, {done.written} written, {len(done.removed)} removed"
    )
    for path in done.removed:
        print_line(f"{path}: removed")
    for path in done.linked:
        print_line(
            f"{path}: now a link to {path.readlink()}; replace it by a copy or a submodule before the folder moves"
        )
    return 0
