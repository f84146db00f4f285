"""``rtrun influence``: what independent nodes add to the times along the paths of a topology."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtrun.commands._arguments import add_json, add_target
from rtrun.commands._question import time_argument

if TYPE_CHECKING:
    from rtrun.judgement.study import Study

HELP = "what independent nodes add to the times along the paths of a topology: measured beside them and alone, in turn"
EXAMPLES = (
    "rtrun influence braking.yml --of other_nodes --target board.yml",
    "rtrun influence braking.yml --of other_nodes --target board.yml --nodes 1,8 --kinds busy --cpu 0 --cpu 1",
)
KINDS = ("idle", "busy", "publishing")


def _numbers(text: str) -> list[int]:
    try:
        numbers = [int(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not all(1 <= number <= 99 for number in numbers):
        raise argparse.ArgumentTypeError(f"takes numbers from 1 to 99 with commas between, as 1,2,4, got {text!r}")
    return numbers


def _kinds(text: str) -> list[str]:
    kinds = text.split(",")
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise argparse.ArgumentTypeError(f"takes {', '.join(KINDS)}, several with commas between, got {unknown[0]!r}")
    return kinds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topology", type=Path, metavar="TOPOLOGY", help="a topology file")
    parser.add_argument(
        "--of", required=True, choices=("other_nodes",), help="whose influence: that of nodes beside it"
    )
    add_target(parser)
    parser.add_argument("--nodes", type=_numbers, default=[1, 2, 4], metavar="N,N", help="how many [1,2,4]")
    parser.add_argument("--kinds", type=_kinds, default=list(KINDS), metavar="KIND,KIND", help=f"[{','.join(KINDS)}]")
    parser.add_argument(
        "--cpu", type=int, action="append", default=[], metavar="N", help="where they run; several: each in turn [any]"
    )
    parser.add_argument("--middleware", default="roscpp", metavar="NAME", help="through what [roscpp]")
    parser.add_argument(
        "--for", type=time_argument, default=10 * 10**9, dest="for_ns", metavar="TIME", help="of each run [10s]"
    )
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="runs of each, 3 at least [5]")
    parser.add_argument("--results", type=Path, metavar="FOLDER", help="[results/influence-<name of the topology>]")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure what is not measured yet, and print the table. 0: measured, 3: a run or the target failed."""
    from rtfiles.errors import UsageError
    from rtfiles.output import beside_the_answer, console, print_json, print_line
    from rtrun.commands._boards import TargetFile, measure_made
    from rtrun.judgement.influence import influences
    from rtrun.judgement.study import study
    from rtrun.plan.question import NO_DEADLINE
    from rtrun.plan.topology.reading import read_topology
    from rtrun.report import influence
    from rtrun.report.terminal import print_banner
    from rtrun.results import run_directory
    from rtrun.results.latest import set_latest
    from rtrun.results.record import RunStatus
    from rtrun.targets.config import read_target

    if args.repeats < 3:
        raise UsageError("--repeats: 3 at least: fewer runs do not tell how much one differs from the next")
    topology = read_topology(args.topology).topology
    results: Path = args.results or Path("results") / f"influence-{topology.name}"
    target = TargetFile(config=read_target(args.target), folder=args.target.parent)
    run_directory.make_results(results)
    set_latest(results)
    with beside_the_answer(args.json):
        statuses = measure_made(_campaign(args, topology.name), target, results)
    bad = [f"{name}: {status}" for name, status in statuses.items() if status is not RunStatus.OK]
    measured: Study = study(results, NO_DEADLINE, bounds=False)
    found = influence.table(influences(measured), measured.question.confidence)
    if args.json:
        print_json({"schema": 1, "platform": str(measured.platform), found.id: found.as_data()})
    else:
        print_banner(measured.platform, measured.preempt_rt)
        print_line(f"{found.title}: {found.outcome}.")
        console().print(found)
        for line in (*found.notes, *bad):
            print_line(line)
    return 3 if bad else 0


def _campaign(args: argparse.Namespace, name: str) -> dict[str, Any]:
    """A campaign in the form of its file: the topology alone and next to others, interleaved."""
    where = [f" on {cpu}" for cpu in args.cpu] or [""]
    others = [f"{number} {kind}{on}" for kind in args.kinds for on in where for number in args.nodes]
    return {
        "schema": 1,
        "name": f"influence-{name}",
        "topology": str(args.topology.absolute()),
        "for": f"{args.for_ns}ns",
        "order": "interleaved",
        "seed": 1,
        "runs": [{"middleware": args.middleware, "other_nodes": ["", *others], "repeats": args.repeats}],
    }
