"""``rtrun run``: measure a campaign on a target."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rtrun.commands._arguments import add_campaign, add_json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rtrun.commands._boards import TargetFile
    from rtrun.plan.campaign import Campaign
    from rtrun.plan.run import Run
    from rtrun.results.record import RunStatus

HELP = "measure a campaign on a target; goes on where an earlier call stopped"
EXAMPLES = (
    "rtrun run brakes.yml --target board.yml",
    "rtrun run brakes.yml -k 'cyclic and not fq1000' --target a.yml --target b.yml",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_campaign(parser)
    parser.add_argument(
        "--target",
        type=Path,
        default=[],
        action="append",
        metavar="TARGET",
        help="TARGET.yml, or [USER@]HOST[:PORT]; given several times: "
        " the boards share the campaign, whichever is free measures what comes next",
    )
    parser.add_argument(
        "--targets",
        default=[],
        action="append",
        metavar="labgrid:TAG=VALUE",
        help="every place with these tags of the labgrid coordinator (LG_COORDINATOR)",
    )
    parser.add_argument(
        "--lg-env", type=Path, metavar="FILE", help="labgrid's environment file; alone: the places that it names"
    )
    parser.add_argument("--results", type=Path, metavar="FOLDER", help="default: results/<name of the campaign>")
    parser.add_argument("--fresh", action="store_true", help="begin anew in results/<name>-<n>, keep what is there")
    parser.add_argument("--collect-only", action="store_true", help="list the runs, and which are finished; no target")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, print the results and the next command. 0: every run is ok, 3: a run or the target failed."""
    import shlex

    from rtfiles.invocation import as_called
    from rtfiles.output import beside_the_answer, print_json, print_line
    from rtrun.commands._boards import print_failed, read_targets
    from rtrun.plan.campaign import read_campaign
    from rtrun.plan.selection import select
    from rtrun.results import run_directory
    from rtrun.results.latest import default_results, set_latest

    campaign, runs = read_campaign(args.campaign)
    chosen = select(runs, args.expression)
    results: Path = args.results or default_results(campaign.name)
    if args.fresh:
        results = run_directory.unused_results(results)
    if args.collect_only:
        return _list_runs(chosen, len(runs), results, as_json=args.json)
    targets = read_targets(args.target, args.targets, args.lg_env)
    if args.fresh:
        results = run_directory.make_new_results(results)
    else:
        run_directory.make_results(results)
    set_latest(results)
    with beside_the_answer(args.json):
        if campaign.until is None:
            statuses = _measure(campaign, runs, chosen, targets, args, results)
        else:
            from rtrun.commands._until import measure_until

            statuses = measure_until(args.campaign, campaign, campaign.until, runs, chosen, targets, results)
        status = print_failed(statuses)
    if args.json:
        print_json({"schema": 1, "campaign": campaign.name, "results": str(results), "runs": statuses})
    elif status == 0:
        print_line(f"next: {as_called('rtrun')} report {shlex.quote(str(results))}")
    return status


def _list_runs(chosen: "Sequence[Run]", planned: int, results: Path, *, as_json: bool) -> int:
    from rtfiles.output import print_json, print_line
    from rtrun.results.record import is_finished

    is_done = {run.name: is_finished(results / run.name) for run in chosen}
    if as_json:
        print_json({"schema": 1, "runs": [{"run": name, "is_finished": done} for name, done in is_done.items()]})
        return 0
    for name, done in is_done.items():
        print_line(f"{name}  finished" if done else name)
    print_line(f"{len(chosen)} of {planned} runs, {sum(is_done.values())} of them finished in {results}")
    return 0


def _measure(
    campaign: "Campaign",
    runs: "Sequence[Run]",
    chosen: "Sequence[Run]",
    targets: "Sequence[TargetFile]",
    args: argparse.Namespace,
    results: Path,
) -> "dict[str, RunStatus]":
    """Measure each chosen run that is not finished, and print the table of everything measured."""
    from rtfiles.errors import InfrastructureError
    from rtfiles.output import console, print_line
    from rtrun.commands._boards import measure_on
    from rtrun.execution import campaign_runner, progress
    from rtrun.plan.campaign import variants_of
    from rtrun.report import terminal
    from rtrun.results.observed import remarks_of
    from rtrun.results.reading import read_runs
    from rtrun.results.record import RunStatus

    try:
        with progress.showing(chosen, console()) as shown:
            names = [target.name for target in targets]
            unfinished = {run.name for _, run in campaign_runner.find_unfinished(results, campaign.name, runs, *names)}
            if unfinished.isdisjoint(run.name for run in chosen):
                shown.note(f"all {len(chosen)} runs are finished in {results}; --fresh measures again beside them")
                statuses = {run.name: RunStatus.OK for run in chosen}
            else:
                variants = variants_of(campaign, args.campaign.parent)
                statuses = measure_on(targets, campaign.name, runs, results, shown, variants=variants, chosen=chosen)
    except (KeyboardInterrupt, InfrastructureError):
        done = campaign_runner.count_finished(results, chosen)
        kept = f"{done} of {len(chosen)} runs are finished and kept in {results}; the same command goes on there"
        print_line(kept)
        raise
    console().print(terminal.answer_of_runs(read_runs(results)))
    for line in remarks_of(results / run.name for run in chosen):
        print_line(line)
    return statuses
