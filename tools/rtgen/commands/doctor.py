"""rtgen doctor: whether this host can build an image with BitBake."""

import argparse
from pathlib import Path

from rtgen.commands import add_json

HELP = "check whether this host can build an image with BitBake"
EXAMPLES = (
    "rtgen doctor",
    "rtgen doctor /builds",
)
FAILS = "a finding prevents a build"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", nargs="?", type=Path, default=Path(), help="where the build will be [this folder]")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """0 if nothing prevents a build, 1 otherwise."""
    from dataclasses import asdict

    from rtfiles.errors import UsageError
    from rtfiles.output import print_json, print_line
    from rtgen import doctor

    if not args.folder.is_dir():
        raise UsageError(f"{args.folder}: not a folder")
    needs = doctor.load_needs()
    host = doctor.inspect(args.folder, needs)
    findings = doctor.judge(host, needs)
    fatal = sum(finding.fatal for finding in findings)
    if args.json:
        print_json({"schema": 1, "can_build": not fatal, "findings": [asdict(finding) for finding in findings]})
        return int(fatal > 0)
    if fatal:
        print_line(f"This host cannot build an image yet: {fatal} to mend.")
    else:
        print_line("This host can build an image." if not findings else "This host can build an image, but read this.")
    for finding in findings:
        print_line(f"  {'mend' if finding.fatal else 'note'}: {finding.what}")
        print_line(f"        {finding.remedy}")
    print_line(
        f"Looked at: {len(needs.programs)} programs, locale, user, user namespaces, path, "
        f"disk ({host.free_bytes / doctor.GIB:.0f} GiB free), memory ({host.memory_bytes / doctor.GIB:.0f} GiB), "
        f"open files ({host.open_files}), proxies."
    )
    return int(fatal > 0)
