"""``rtgen kernel``: a PREEMPT_RT kernel built from the fragment of a machine."""

import argparse

from rtgen.commands import add_json

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
    add_json(build)


def run(args: argparse.Namespace) -> int:
    """0 when the kernel is built, 1 when its options do not hold."""
    from rtfiles.output import beside_the_answer, print_json, print_line
    from rtgen import kernel
    from rtgen.commands.kconfig import end, report
    from rtgen.kconfig import data as kconfig

    data = kconfig.load()
    machine = data.fragment_of(args.machine)
    verdict = kernel.plan(data, machine, args.kernel)
    if not args.json:
        report(verdict)
    if verdict.mismatches:
        return end([verdict], as_json=args.json)
    with beside_the_answer(args.json):
        folder = kernel.build(data, machine, verdict, args.kernel)
    files = [file for file in sorted(folder.rglob("*")) if file.is_file()]
    sizes = {
        name: file.stat().st_size
        for file in files
        if not (name := str(file.relative_to(folder))).startswith("modules/")
    }
    modules = len(list((folder / "modules").rglob("*.ko")))
    if args.json:
        print_json({"schema": 1, "machine": machine, "folder": str(folder), "bytes": sizes, "modules": modules})
        return 0
    print_line(f"{folder}:")
    for name, size in sizes.items():
        print_line(f"  {name}  {size / 1024:.0f} KiB")
    print_line(f"  modules  {modules} of them" if modules else "  no modules: everything is built in")
    return 0
