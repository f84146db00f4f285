"""``rtgen kernel``: a PREEMPT_RT kernel built from the fragment of a machine."""

import argparse

HELP = "build a PREEMPT_RT kernel from a machine's fragment"
EXAMPLES = (
    "rtgen kernel build --machine qemu-armv7",
    "rtgen kernel build --machine pandaboard-es --kernel 6.1",
)
FAILS = "an option does not hold"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``build``."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = "build a pinned kernel of Debian with PREEMPT_RT (five minutes on two idle cores, then cached)"
    build = commands.add_parser("build", help=text, description=text)
    build.add_argument("--machine", required=True, help="a machine of kconfig/machines.yml, or a board listed there")
    build.add_argument("--kernel", help="a version of kconfig/sources.yml, as 7.2 (default: the first there)")


def run(args: argparse.Namespace) -> int:
    """0 when the kernel is built, 1 when its options do not hold."""
    from rtfiles.output import print_line
    from rtgen import kernel
    from rtgen.commands.kconfig import report
    from rtgen.kconfig import data as kconfig

    data = kconfig.load()
    machine = data.fragment_of(args.machine)
    verdict = kernel.plan(data, machine, args.kernel)
    if report(verdict):
        return 1
    folder = kernel.build(data, machine, verdict, args.kernel)
    print_line(f"{folder}:")
    for file in sorted(folder.rglob("*")):
        if file.is_file() and file.relative_to(folder).parts[0] != "modules":
            print_line(f"  {file.relative_to(folder)}  {file.stat().st_size / 1024:.0f} KiB")
    modules = list((folder / "modules").rglob("*.ko"))
    print_line(f"  modules  {len(modules)} of them" if modules else "  no modules: everything is built in")
    return 0
