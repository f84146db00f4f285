"""rtrun compare: what changed from one folder of runs to another."""

import argparse
from pathlib import Path

from rtrun.commands._arguments import add_json, named_or_latest
from rtrun.commands._question import add_question, question, time_argument

HELP = "compare two folders of runs, or two sides of one campaign: what shifted, and how sure that is"
EXAMPLES = (
    "rtrun compare results/before results/after",
    "rtrun compare --with-last",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "a", type=Path, nargs="?", help="folder of runs, run directory, .log or .npy: before [results/latest]"
    )
    parser.add_argument("b", type=Path, nargs="?", help="the same: after [another side of the campaign in A]")
    parser.add_argument(
        "--with-last",
        action="store_true",
        help="compare A with the same campaign as it was measured before, into a folder next to it: that is before",
    )
    parser.add_argument(
        "--by",
        choices=("variant", "kernel", "trace", "middleware"),
        help="what the two sides of the campaign in A differ in [variant where it has some]",
    )
    parser.add_argument("--sides", nargs=2, default=(), metavar="NAME", help="which two, where A has more")
    parser.add_argument(
        "--margin",
        type=time_argument,
        metavar="TIME",
        help="a shift that is of no concern, as 5us [5 %% of A's figure]",
    )
    add_json(parser)
    add_question(parser)


def run(args: argparse.Namespace) -> int:
    """Print the answer for every group that both sets have. Raises UsageError when there is none."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line, print_text
    from rtrun.judgement.compare import compare_sets, compare_sides
    from rtrun.report.compare import as_json, as_text
    from rtrun.results.latest import measured_before

    if args.with_last and (args.b or args.by or args.sides):
        raise UsageError("--with-last: goes with one folder at most, and without --by and --sides")
    args.a = named_or_latest(args.a)
    if args.with_last:
        args.a, args.b = measured_before(args.a), args.a
    asked = question(args, args.a)
    sides = (str(args.a), str(args.b))
    if args.with_last and not args.json:
        print_line(f"A: {sides[0]}, B: {sides[1]}")
    if args.b is None:
        sides, compared = compare_sides(args.a, args.by, args.sides, asked, margin_ns=args.margin)
        if not args.json:
            print_line(f"A: {sides[0]}, B: {sides[1]}")
    elif args.sides or args.by:
        raise UsageError("--by, --sides: go with one folder, that of a campaign with variants, kernels or traces")
    else:
        compared = compare_sets(args.a, args.b, asked, margin_ns=args.margin)
    if not compared.changes:
        if compared.ambiguous:
            raise UsageError("\n".join(compared.ambiguous))
        raise UsageError(f"{sides[0]} and {sides[1]} have no suite with the same parameters in common")
    if args.json:
        print_text(as_json(compared))
    else:
        print_text(as_text(compared))
    return 0
