"""``rtgen kconfig``: render and verify kernel fragments."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rtfiles import atomic
from rtfiles.errors import UsageError
from rtfiles.output import print_json, print_line, print_text
from rtgen.commands import add_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rtgen.kconfig.data import Data
    from rtgen.kconfig.verify import Verification

HELP = "render PREEMPT_RT kernel fragments, and verify that they take effect"
EXAMPLES = (
    "rtgen kconfig render --check",
    "rtgen kconfig verify --machine pandaboard-es --config /boot/config",
)
FAILS = "a fragment differs, or an option does not hold"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``render`` and ``verify``."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = "write kconfig/fragments/<machine>-<kernel>.cfg from kconfig/options"
    render = commands.add_parser("render", help=text, description=text)
    render.add_argument("--machine", help="one of kconfig/machines.yml (default: every machine)")
    render.add_argument("--kernel", help="3.4, 6.1, ... (default: every version)")
    render.add_argument(
        "--check", action="store_true", help="write nothing, show differences; exit status 1 if there are any"
    )
    add_json(render)
    text = "compare the .config that the kernel makes from a fragment, or a finished .config, with kconfig/options"
    verify = commands.add_parser("verify", help=text, description=text)
    verify.add_argument("--machine", help="one of kconfig/machines.yml (default with --source: every machine)")
    verify.add_argument(
        "--source", metavar="TREE", help="a kernel tree, a Kconfig-only tree, or 'debian', which downloads one"
    )
    verify.add_argument("--fragment", type=Path, metavar="FILE", help="use this fragment instead of the rendered one")
    verify.add_argument(
        "--config", type=Path, metavar="FILE", help="a finished .config, a /boot/config-*, a copy of /proc/config.gz"
    )
    add_json(verify)
    verify.add_argument(
        "--kernel", metavar="VERSION", help="compare with the data of this version (default: its own, or the nearest)"
    )


def run(args: argparse.Namespace) -> int:
    """0 if everything is right, 1 for an outdated fragment or an option that does not hold."""
    return _render(args) if args.action == "render" else _verify(args)


def _render(args: argparse.Namespace) -> int:
    import difflib

    from rtgen.checkout import checkout
    from rtgen.kconfig import data as kconfig
    from rtgen.kconfig.render import fragment_path, render

    checkout()
    data = kconfig.load()
    machines = [args.machine] if args.machine else list(data.machines)
    fragments, difference = [], ""
    for machine in machines:
        for kernel in [args.kernel] if args.kernel else data.kernels_of(machine):
            text, path = render(data, machine, kernel), fragment_path(data, machine, kernel)
            name = str(path.relative_to(data.folder.parent))
            before = path.read_text(encoding="utf-8") if path.is_file() else ""
            fragments.append({"fragment": name, "state": "unchanged" if before == text else "written"})
            if not args.check:
                path.parent.mkdir(parents=True, exist_ok=True)
                atomic.write_text(path, text)
            elif before != text:
                fragments[-1]["state"] = "differs"
                present, wanted = before.splitlines(keepends=True), text.splitlines(keepends=True)
                difference += "".join(difflib.unified_diff(present, wanted, name, f"{name} (rendered)"))
    if args.json:
        print_json({"schema": 1, "fragments": fragments, "difference": difference})
    elif difference:
        print_text(difference)
    elif args.check:
        print_line(f"{len(fragments)} fragments are as rendered")
    else:
        for fragment in fragments:
            print_line(f"{fragment['fragment']}: {fragment['state']}")
    return int(bool(difference))


def _verify(args: argparse.Namespace) -> int:
    from rtgen.kconfig import data as kconfig

    data = kconfig.load()
    if bool(args.source) == bool(args.config):
        raise UsageError("kconfig verify: give either --source TREE or --config FILE")
    if args.config:
        return _verify_config(args, data)
    if args.fragment and not args.machine:
        raise UsageError("kconfig verify: --fragment FILE needs --machine, for the bases it is put on")
    from rtgen.kconfig import debian_source
    from rtgen.kconfig.tree import open_tree
    from rtgen.kconfig.verify import load_fragment, rendered, verify_tree

    given = load_fragment(args.fragment) if args.fragment else None
    tree = debian_source.open_debian(data) if args.source == "debian" else open_tree(Path(args.source))
    basis = data.basis(tree.kernel, args.kernel)
    known = [name for name in data.machines if basis.rt_of in data.kernels_of(name)]
    verdicts: list[Verification] = []
    for name in [args.machine] if args.machine else known:
        fragment, origin = (rendered(data, name, basis), None) if given is None else (given, str(args.fragment))
        for base in data.machine(name).bases:
            verdicts.append(verify_tree(data, tree, name, base, fragment, origin, args.kernel))
            if not args.json:
                report(verdicts[-1])
    return end(verdicts, as_json=args.json)


def _verify_config(args: argparse.Namespace, data: "Data") -> int:
    from rtgen.kconfig.fragment import read_text
    from rtgen.kconfig.verify import verify_config

    if not args.machine or args.fragment:
        raise UsageError("kconfig verify: --config FILE takes --machine, and no --fragment")
    data.machine(args.machine)
    verdict = verify_config(data, args.machine, read_text(args.config), str(args.config), args.kernel)
    if not args.json:
        report(verdict)
    return end([verdict], as_json=args.json)


def end(verdicts: "Sequence[Verification]", *, as_json: bool) -> int:
    """Print the verdicts for programs, if that is asked for; return the exit status."""
    from dataclasses import asdict

    if as_json:
        subjects = [
            {
                "subject": verdict.subject,
                "checked": verdict.checked,
                "do_not_hold": [asdict(item) for item in verdict.mismatches],
            }
            for verdict in verdicts
        ]
        print_json({"schema": 1, "subjects": subjects})
    return int(any(verdict.mismatches for verdict in verdicts))


def report(verdict: "Verification") -> None:
    """Print a verdict."""
    count = len(verdict.mismatches)
    if not count:
        print_line(f"{verdict.subject}: all {verdict.checked} options hold")
        return
    print_line(f"{verdict.subject}: {count} of {verdict.checked} options do not hold")
    for item in verdict.mismatches:
        print_line(f"  {item.symbol}: wanted {item.want}, is {item.got}: {item.reason}")
