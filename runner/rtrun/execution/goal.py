"""Measure until the answer is certain: the results of finished runs decide which runs come next.

The results are the only memory: a campaign that was stopped continues in the same round.
"""

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtfiles.errors import UsageError
from rtrun.analysis.standing import Standing
from rtrun.execution.allotment import NextRound, Round
from rtrun.plan.goal import Goal
from rtrun.plan.rounds import boot_of_round, plan_round, rounds_for, rounds_of_boot, run_in_round
from rtrun.plan.run import Run
from rtrun.results.record import RunStatus, is_closed, verify

# A run that fails this many times in its round will not succeed: its group is given up.
TRIES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What the rounds need from the results: a finished run's boot (None: not finished), answers, seconds spent so
    far."""

    boot_of: Callable[[Run], str | None]
    has_failed: Callable[[Run], bool]
    """Whether a run was measured to its end but did not succeed."""
    evaluate: Callable[[], Sequence[Standing]]
    spent_s: Callable[[], float]


def read_findings(results: Path, evaluate: Callable[[], Sequence[Standing]], spent_s: Callable[[], float]) -> Findings:
    """Read the findings from a results folder. A run that was found finished is not checked again."""
    boots: dict[str, str] = {}

    def boot_of(run: Run) -> str | None:
        if run.name not in boots:
            try:
                record = verify(results / run.name)
            except UsageError:
                return None
            if record.status is not RunStatus.OK:
                return None
            boots[run.name] = str(record.target.boot_id or "")
        return boots[run.name]

    def has_failed(run: Run) -> bool:
        return boot_of(run) is None and is_closed(results / run.name)

    return Findings(boot_of=boot_of, has_failed=has_failed, evaluate=evaluate, spent_s=spent_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """The standing of a group (None: nothing is measured), and the time to its answer if misses continue at the rate
    seen.

    `left_s` includes the time between runs, as far as it was seen; None: no time is long enough.
    """

    group: Run
    standing: Standing | None
    left_s: float | None


def rounds(
    groups: Sequence[Run],
    goal: Goal,
    seed: int,
    measurements: Mapping[str, int],
    findings: Findings,
    report_progress: Callable[[Sequence[Progress], float], None],
    boards: int = 1,
) -> NextRound:
    """Plan what to measure next, until every group has its answer or the time is over.

    `measurements` is how many measurements without a miss make a proof, by the name of the group. A board asks for its
    next round when the runs of its last one are closed; several `boards` measure different rounds at the same time. A
    group with a final answer leaves the rounds; so does a group whose run failed `TRIES` times. `report_progress` is
    called before each new round and at the end, once for each state of the answers, with the seconds spent so far.
    """
    boot_rounds = rounds_of_boot(groups, measurements, goal.boots)
    lowest = highest = _latest_round(groups, findings)
    tries: Counter[str] = Counter()
    given_up: set[str] = set()
    reported: Mapping[str, Standing] | None = None

    def unfinished(number: int, open_groups: Sequence[Run]) -> list[Run]:
        return [run for run in plan_round(open_groups, number, seed) if findings.boot_of(run) is None]

    def next_round(taken: Collection[str], begun: Collection[str]) -> Round | None:
        nonlocal lowest, highest, reported
        for group in groups:
            runs = [run_in_round(group, number) for number in range(lowest, highest + 1)]
            if any(tries[run.name] >= TRIES and run.name not in taken and findings.has_failed(run) for run in runs):
                given_up.add(group.name)
        standings = standings_of(groups, findings.evaluate())
        open_groups = [
            group for group in groups if group.name not in given_up and not _is_final(standings.get(group.name))
        ]
        while open_groups and not unfinished(lowest, open_groups):
            lowest += 1
        # What an earlier call left on the board comes first: two runs at once would disturb each other.
        begun_rounds = {_round_of(name, group) for name in set(begun) - set(taken) for group in open_groups} - {0}
        left = [n for n in begun_rounds if any(run.name in begun for run in unfinished(n, open_groups))]
        number, todo = min(left, default=lowest), list[Run]()
        while open_groups and not todo:
            todo = [run for run in unfinished(number, open_groups) if run.name not in taken]
            number += not todo
        if len(todo) == len(open_groups) and standings != reported:
            spent_s = findings.spent_s()
            reported = standings
            report_progress(_progress(groups, standings, measurements, boot_rounds, spent_s, boards), spent_s)
        if len(todo) == len(open_groups) and (
            not todo or findings.spent_s() + sum(run.expected_s for run in todo) > goal.at_most_ns / 1e9
        ):
            return None
        for run in todo:
            # A board that was lost together with the run does not count as a failure of the run.
            tries[run.name] = tries[run.name] + 1 if findings.has_failed(run) else 1
        highest = max(highest, number)
        return Round(
            runs=tuple(todo),
            used_boots=_used_boots(groups, number, highest, boot_rounds, findings) if goal.boots > 1 else frozenset(),
        )

    return next_round


def stopped_by_time(groups: Sequence[Run], standings: Sequence[Standing], failed: Collection[str]) -> list[str]:
    """The groups that have no answer, after the rounds ended, though none of their runs is among the `failed` ones."""
    reached = standings_of(groups, standings)
    return [
        group.name
        for group in groups
        if not _is_final(reached.get(group.name)) and not any(_round_of(run, group) for run in failed)
    ]


def _is_final(standing: Standing | None) -> bool:
    return standing is not None and standing.is_final


def standings_of(groups: Sequence[Run], standings: Sequence[Standing]) -> dict[str, Standing]:
    """The standing of each group by the group's name; if its runs are not pooled, that of the latest run.

    Runs of a campaign are not pooled when the target's kernel changed in between, nor when their boards are not alike.
    Each such board needs its own answer, and so does each observed stream with a deadline: while one of them has no
    answer, its standing is that of the group.
    """
    latest: dict[str, dict[tuple[str, frozenset[str]], tuple[int, Standing]]] = {}
    for standing in standings:
        for group in groups:
            number = max((_round_of(run, group) for run in standing.planned), default=0)
            measured = latest.setdefault(group.name, {})
            key = standing.stream, standing.boards
            if standing.has_deadline and number > measured.get(key, (0,))[0]:
                measured[key] = number, standing
    chosen = {}
    for name, measured in latest.items():
        # The standing of several boards together replaces those of the single boards.
        single = [
            (number, standing)
            for (stream, boards), (number, standing) in measured.items()
            if not any(
                stream == other and boards < others and number <= measured[other, others][0]
                for other, others in measured
            )
        ]
        if single:
            chosen[name] = max(single, key=lambda pair: (not pair[1].is_final, pair[0]))[1]
    return chosen


def _round_of(run: str, group: Run) -> int:
    """The round that a run of this name belongs to; 0 when it is of another group."""
    if run == group.name:
        return 1
    number = run.removeprefix(f"{group.name}-r")
    return int(number) if number != run and number.isdecimal() else 0


def _latest_round(groups: Sequence[Run], findings: Findings) -> int:
    number = 1
    while any(findings.boot_of(run_in_round(group, number + 1)) is not None for group in groups):
        number += 1
    return number


def _used_boots(
    groups: Sequence[Run], number: int, highest: int, boot_rounds: int, findings: Findings
) -> frozenset[str]:
    """The boots of the rounds up to `highest` that must not share a boot with this round."""
    others = [
        other
        for other in range(1, highest + 1)
        if boot_of_round(other, boot_rounds) != boot_of_round(number, boot_rounds)
    ]
    boots = {findings.boot_of(run_in_round(group, other)) for other in others for group in groups}
    return frozenset(boot for boot in boots if boot)


def _progress(
    groups: Sequence[Run],
    standings: Mapping[str, Standing],
    measurements: Mapping[str, int],
    boot_rounds: int,
    spent_s: float,
    boards: int,
) -> list[Progress]:
    counts = {group.name: len(standings[group.name].runs) for group in groups if group.name in standings}
    measured_s = sum(counts.get(group.name, 0) * group.expected_s for group in groups)
    overhead_s = max(0.0, spent_s * boards - measured_s) / max(1, sum(counts.values()))
    progress = []
    for group in groups:
        standing = standings.get(group.name)
        number = runs_left(group, standing, measurements[group.name], boot_rounds)
        left_s = None if number is None else number * (group.expected_s + overhead_s) / boards
        progress.append(Progress(group=group, standing=standing, left_s=left_s))
    return progress


def runs_left(group: Run, standing: Standing | None, measurements: int, boot_rounds: int) -> int | None:
    """How many more runs bring a group to its answer if misses continue at the rate seen; None if no number does."""
    verdict = standing.verdict if standing else None
    if standing is not None and standing.is_final:
        return 0
    if standing is None or verdict is None or not verdict.n:
        return None if group.subject.makes_streams else rounds_for(group, measurements)
    if verdict.change is not None or verdict.decided_after is None:
        return None
    _, further = verdict.decided_after
    return max(verdict.boots_missing * boot_rounds, math.ceil(further * len(standing.runs) / verdict.n))
