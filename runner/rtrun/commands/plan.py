"""``rtrun plan``: every run of a campaign and how long it takes, without a target."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rtrun.commands._question import probability_argument

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rtrun.plan.campaign import Run
    from rtrun.plan.goal import Goal

NAME = "plan"
HELP = "print every run of a campaign and how long it takes, without a target"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what `plan` takes."""
    parser.add_argument("campaign", type=Path, metavar="CAMPAIGN.yml")
    parser.add_argument(
        "--assume-rate",
        type=probability_argument,
        metavar="P",
        help="with a goal (until): how long it takes if so many measurements miss the deadline",
    )


def run(args: argparse.Namespace) -> int:
    """Print the plan. Raises UsageError for a rate without a goal."""
    from rtfiles.errors import UsageError
    from rtfiles.output import print_line
    from rtrun.plan.campaign import read_campaign

    campaign, runs = read_campaign(args.campaign)
    if args.assume_rate is not None and campaign.until is None:
        raise UsageError(f"{args.campaign}: --assume-rate: the campaign has no goal (until), so its length is known")
    for each in runs:
        settling = f" + {each.settle_s:g} s for the load to settle" if each.settle_s else ""
        print_line(f"{each.name}  {each.expected_s:.1f} s{settling}")
    measuring_s = sum(each.expected_s for each in runs)
    settling_s = sum(each.settle_s for each in runs)
    settling = f", {settling_s:.0f} s for loads to settle" if settling_s else ""
    print_line(f"{len(runs)} runs, {measuring_s:.0f} s of measuring ({measuring_s / 3600:.1f} h){settling}")
    if campaign.until:
        for line in _goal_lines(campaign.until, runs, args.assume_rate):
            print_line(line)
    return 0


def _goal_lines(goal: "Goal", groups: "Sequence[Run]", rate: float | None) -> list[str]:
    """How long the goal takes in the best case, and at a rate of misses."""
    from rtrun.analysis.deadline import plan_measurements
    from rtrun.plan.rounds import outlook, rounds_a_boot

    at_most_h = goal.at_most_ns / 3.6e12
    lines = [
        f"until P(miss) of {goal.deadline_ns / 1000:g} us is proven or refuted to be below {goal.probability:g}, "
        f"confidence {goal.confidence:g}, in at most {at_most_h:.3g} h: each round repeats these runs"
    ]
    best = plan_measurements(probability=goal.probability, confidence=goal.confidence)
    for name, assumed in (("without a miss", 0.0), (f"if {rate} of all measurements miss it", rate)):
        if assumed is None:
            continue
        planned = plan_measurements(probability=goal.probability, confidence=goal.confidence, rate=assumed)
        if planned is None or best is None:
            lines.append(f"{name}: no number of measurements is likely to decide it")
            continue
        answer, measurements = planned
        a_boot = rounds_a_boot(groups, best[1], goal.boots)
        expected = outlook(groups, measurements, boots=goal.boots, a_boot=a_boot)
        restarts = f" and {expected.boots - 1} restarts" if goal.boots > 1 else ""
        longer = ", longer than at_most" if expected.measuring_s / 3600 > at_most_h else ""
        chance = " nine times in ten" if assumed else ""
        lines.append(
            f"{name}: {answer} after {expected.rounds} rounds{chance}, {expected.measuring_s:.0f} s of measuring "
            f"({expected.measuring_s / 3600:.1f} h){restarts}{longer}"
        )
    return lines
