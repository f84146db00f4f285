"""rtrun compare: what changed from one folder of runs to another."""

import argparse
from pathlib import Path

from rtrun.commands._question import add_question, time_ns

NAME = "compare"
HELP = "compare two folders of runs: what shifted, and how sure that is"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The two sets, the margin, the question."""
    parser.add_argument("a", type=Path, help="folder of runs, run directory, .log or .npy: before")
    parser.add_argument("b", type=Path, help="the same: after")
    parser.add_argument(
        "--margin", type=time_ns, metavar="TIME", help="a shift that is of no concern, as 5us [5 %% of A's figure]"
    )
    parser.add_argument("--json", action="store_true", help="print JSON, for programs")
    add_question(parser)


def run(args: argparse.Namespace) -> int:
    """Print the answer for every group that both sets have. Raises UsageError when there is none."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_text
    from rtrun.report import compare

    found = compare.compare_sets(
        args.a,
        args.b,
        deadline_ns=args.deadline,
        probability=args.probability,
        confidence=args.confidence,
        margin_ns=args.margin,
    )
    if not found.changes:
        if found.ambiguous:
            raise UsageError("\n".join(found.ambiguous))
        raise UsageError(f"{args.a} and {args.b} have no suite with the same parameters in common")
    if args.json:
        print_text(compare.as_json(found))
    else:
        print_text(compare.as_text(found))
    return 0
