"""The rounds of a campaign that has a goal: one run of every group whose answer is open, in a balanced order.

A group is a planned run of the campaign. Its run in a round is that run repeated, and the round's number is the repeat.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from rtrun.plan.run import RESTART_S, SET_UP_S, Run, interleave

# Start-up values are in no verdict: at most two a run (thesis 4.2).
STARTUP_VALUES = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlook:
    """How long a campaign takes: rounds, boots of the target, seconds of measuring alone and in total with restarts."""

    rounds: int
    boots: int
    measuring_s: float
    total_s: float


def run_in_round(group: Run, number: int) -> Run:
    """The run of a group in a round; the first round has number 1."""
    return group if number == 1 else replace(group, name=f"{group.name}-r{number}", repeat=number)


def plan_round(groups: Iterable[Run], number: int, seed: int) -> tuple[Run, ...]:
    """The runs of a round in their order, one per group; an even round is the round before it, reversed."""
    groups = list(groups)
    numbers = {number, number - (number % 2 == 0)}
    runs = interleave([run_in_round(group, round_number) for round_number in numbers for group in groups], seed)
    return tuple(run for run in runs if run.repeat == number)


def measurements_of(group: Run) -> int:
    """How many measurements one run of a group adds to its verdict. At least 1."""
    return max(1, int(group.parameters.get("repetitions") or 0) - STARTUP_VALUES)


def rounds_for(group: Run, measurements: int) -> int:
    """How many rounds give a group this many measurements."""
    return math.ceil(measurements / measurements_of(group))


def rounds_of_boot(groups: Sequence[Run], measurements: Mapping[str, int], boots: int) -> int:
    """How many rounds to measure on one boot, so that these measurements of each group are spread over this many boots.

    At least 1: if fewer rounds than boots would do, each round has a boot of its own. The same goes if it is not known
    how much a run will observe.
    """
    if any(group.subject.makes_streams for group in groups):
        return 1
    return max(1, max(rounds_for(group, measurements[group.name]) for group in groups) // boots)


def boot_of_round(number: int, boot_rounds: int) -> int:
    """The boot that a round is measured on, counted from 0."""
    return (number - 1) // boot_rounds


def joined_s(groups: Sequence[Run], rounds: int, *, boots: int, boot_rounds: int) -> float:
    """How long one boot measures the shortest group within this many rounds, all its runs joined, in seconds."""
    return min(group.expected_s for group in groups) * (boot_rounds if boots > 1 else rounds)


def outlook(groups: Sequence[Run], measurements: Mapping[str, int], *, boots: int, boot_rounds: int) -> Outlook:
    """How long it takes until each group has its measurements, on at least this many boots of `boot_rounds` rounds.

    A group leaves the rounds once it has its measurements.
    """
    least = (boots - 1) * boot_rounds + 1
    rounds = {group.name: max(least, rounds_for(group, measurements[group.name])) for group in groups}
    most = max(rounds.values())
    restarts = boot_of_round(most, boot_rounds) if boots > 1 else 0
    return Outlook(
        rounds=most,
        boots=restarts + 1,
        measuring_s=sum(rounds[group.name] * group.expected_s for group in groups),
        total_s=SET_UP_S + sum(rounds[group.name] * group.total_s for group in groups) + restarts * RESTART_S,
    )
