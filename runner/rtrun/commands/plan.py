"""``rtrun plan``: every run of a campaign and how long it takes, without a target."""

import argparse
from pathlib import Path

NAME = "plan"
HELP = "print every run of a campaign and how long it takes, without a target"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what `plan` takes."""
    parser.add_argument("campaign", type=Path, metavar="CAMPAIGN.yml")


def run(args: argparse.Namespace) -> int:
    """Print the plan."""
    from rtfiles.output import print_line
    from rtrun.plan.campaign import read_campaign

    _, runs = read_campaign(args.campaign)
    for each in runs:
        settling = f" + {each.settle_s:g} s for the load to settle" if each.settle_s else ""
        print_line(f"{each.name}  {each.expected_s:.1f} s{settling}")
    measuring_s = sum(each.expected_s for each in runs)
    settling_s = sum(each.settle_s for each in runs)
    settling = f", {settling_s:.0f} s for loads to settle" if settling_s else ""
    print_line(f"{len(runs)} runs, {measuring_s:.0f} s of measuring ({measuring_s / 3600:.1f} h){settling}")
    return 0
