"""``rtrun run``: measure a campaign on a target."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rtrun.commands._arguments import add_campaign

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rtrun.commands._boards import TargetFile
    from rtrun.plan.campaign import Campaign
    from rtrun.plan.run import Run

NAME = "run"
HELP = "measure a campaign on a target; goes on where an earlier call stopped"
EXAMPLES = (
    "rtrun run brakes.yml --target board.yml",
    "rtrun run brakes.yml --target a.yml --target b.yml --results results/nightly",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what `run` takes."""
    add_campaign(parser)
    parser.add_argument(
        "--target",
        type=Path,
        default=[],
        action="append",
        metavar="TARGET.yml",
        help="given several times: the boards share the campaign, whichever is free measures what comes next",
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


def run(args: argparse.Namespace) -> int:
    """Measure, print what came out and the next command. 0: every run is ok, 3: some run failed or the target did."""
    import shlex

    from rtfiles.invocation import as_called
    from rtfiles.output import print_line
    from rtrun.commands._boards import read_targets
    from rtrun.plan.campaign import read_campaign
    from rtrun.results import run_directory

    campaign, runs = read_campaign(args.campaign)
    targets = read_targets(args.target, args.targets, args.lg_env)
    results: Path = args.results or Path("results") / campaign.name
    if args.fresh:
        results = fresh(results)
    run_directory.make_results(results)
    if campaign.until is None:
        status = _measure(campaign, runs, targets, args, results)
    else:
        from rtrun.commands._until import measure_until

        status = measure_until(args.campaign, campaign, campaign.until, runs, targets, results)
    if status == 0:
        print_line(f"next: {as_called('rtrun')} report {shlex.quote(str(results))}")
    return status


def _measure(
    campaign: "Campaign",
    runs: "Sequence[Run]",
    targets: "Sequence[TargetFile]",
    args: argparse.Namespace,
    results: Path,
) -> int:
    """Measure each run that is not finished, and print the table of all."""
    from rtfiles.errors import InfrastructureError
    from rtfiles.output import console, print_line
    from rtrun.commands._boards import measure_on
    from rtrun.execution import campaign_runner, progress
    from rtrun.plan.campaign import variants_of
    from rtrun.report import terminal
    from rtrun.results.observed import said_of
    from rtrun.results.reading import read_runs
    from rtrun.results.record import RunStatus

    statuses: dict[str, RunStatus] = {}
    try:
        with progress.showing(runs, console()) as shown:
            names = [target.name for target in targets]
            if not campaign_runner.find_unfinished(results, campaign.name, runs, *names):
                shown.note(f"all {len(runs)} runs are finished in {results}; --fresh measures again beside them")
                statuses = {each.name: RunStatus.OK for each in runs}
            else:
                variants = variants_of(campaign, args.campaign.parent)
                statuses = measure_on(targets, campaign.name, runs, results, shown, variants=variants)
    except (KeyboardInterrupt, InfrastructureError):
        done = campaign_runner.count_finished(results, runs)
        kept = f"{done} of {len(runs)} runs are finished and kept in {results}; the same command goes on there"
        print_line(kept)
        raise
    measured = read_runs(results)
    console().print(terminal.answer_of_runs(measured), crop=False)
    bad = [f"{name}: {status}" for name, status in statuses.items() if status is not RunStatus.OK]
    for line in (*bad, *said_of(results / each.name for each in runs)):
        print_line(line)
    return InfrastructureError.exit_status if bad else 0


def fresh(results: Path) -> Path:
    """The folder, or the first of its name and a number that is not there."""
    if not results.exists():
        return results
    number = 2
    while (candidate := results.with_name(f"{results.name}-{number}")).exists():
        number += 1
    return candidate
