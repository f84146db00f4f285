"""rtgen doctor: whether this host can build an image with BitBake."""

import argparse
from pathlib import Path

from rtgen.commands import DEFAULT_PROFILE, add_json

HELP = "check whether this host can build an image with BitBake"
EXAMPLES = (
    "rtgen doctor",
    "rtgen doctor /builds --profile scarthgap-base",
)
FAILS = "a finding prevents a build"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", nargs="?", type=Path, default=Path(), help="where the build will be [this folder]")
    parser.add_argument(
        "--profile", default=DEFAULT_PROFILE, help=f"of the image: name or file (….yml) [{DEFAULT_PROFILE}]"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """0 if nothing prevents a build, 1 otherwise."""
    from dataclasses import asdict

    from rtfiles.errors import UsageError
    from rtfiles.output import print_json, print_line
    from rtgen import doctor
    from rtgen.profile import load_profile

    if not args.folder.is_dir():
        raise UsageError(f"{args.folder}: not a folder")
    build = doctor.load_build(load_profile(args.profile)[0])
    needs = doctor.load_needs()
    host = doctor.inspect(args.folder, needs)
    findings = doctor.judge(host, needs, build)
    fatal = sum(finding.fatal for finding in findings)
    if args.json:
        facts = {
            "build": build.model_dump(),
            "free_bytes": host.free_bytes,
            "memory_bytes": host.memory_bytes,
            "free_memory_bytes": host.free_memory_bytes,
        }
        print_json({"schema": 1, "can_build": not fatal, "findings": [asdict(finding) for finding in findings]} | facts)
        return int(fatal > 0)
    if fatal:
        print_line(f"This host cannot build an image yet: {fatal} to mend.")
    else:
        print_line("This host can build an image." if not findings else "This host can build an image, but read this.")
    for finding in findings:
        print_line(f"  {'mend' if finding.fatal else 'note'}: {finding.what}")
        print_line(f"        {finding.remedy}")
    counted = f"{build.recipes or 'uncounted'} recipes in {build.tasks or 'uncounted'} tasks"
    how = "measured" if build.measured else "by estimate"
    print_line(
        f"A first build of {args.profile}: {counted}; {how} {build.gib} GiB "
        f"({build.rm_work_gib} GiB with kas/rm-work.yml) and {build.hours} hours on two idle CPUs."
    )
    print_line(
        f"Here: {host.free_bytes / doctor.GIB:.0f} GiB of disk free, {host.free_memory_bytes / doctor.GIB:.1f} of "
        f"{host.memory_bytes / doctor.GIB:.1f} GiB of memory free."
    )
    print_line(
        f"Looked at: {len(needs.programs)} programs, locale, user, user namespaces, path, "
        f"disk, memory, open files ({host.open_files}), proxies."
    )
    return int(fatal > 0)
