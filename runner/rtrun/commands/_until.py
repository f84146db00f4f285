"""``rtrun run`` of a campaign with a goal: rounds until every group has its answer or the time is over."""

from collections.abc import Callable, Sequence
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.output import counted, print_line, print_note
from rtfiles.quantities import duration
from rtrun.analysis.chance.further import plan_groups
from rtrun.commands._boards import TargetFile, measure_on
from rtrun.commands.verdict import print_answers
from rtrun.execution import campaign_runner
from rtrun.execution.allotment import NextRound
from rtrun.execution.goal import Progress, read_findings, rounds, stopped_by_time
from rtrun.execution.progress import RoundProgress
from rtrun.judgement.standings import evaluator
from rtrun.judgement.study import study
from rtrun.plan.campaign import Campaign, variants_of
from rtrun.plan.goal import Goal
from rtrun.plan.run import Run
from rtrun.report.standings import progress_line
from rtrun.results.goal_file import write_goal
from rtrun.results.observed import remarks_of
from rtrun.results.record import RunStatus, is_closed

ReportProgress = Callable[[Sequence[Progress], float], None]


def measure_until(
    file: Path,
    campaign: Campaign,
    goal: Goal,
    groups: Sequence[Run],
    chosen: Sequence[Run],
    targets: Sequence[TargetFile],
    results: Path,
) -> dict[str, RunStatus]:
    """Measure the chosen groups, and print the progress after each round and the answers at the end.

    Returns the status of each measured run. Whatever the answers are, the campaign was measured as planned:
    `rtrun gate` judges them.
    """
    best = plan_groups(goal.question, {group.name: group.period_ns for group in groups})
    if best is None:
        raise UsageError(f"{file}: until: no number of measurements proves P(miss) below {goal.probability:g}")
    for config in (target.config for target in targets):
        if goal.boots > 1 and config.kind == "ssh" and config.restart is None:
            raise UsageError(
                f"{file}: until.boots: asks for {goal.boots} boots, but the file of target {config.name} does not say "
                "how to restart it: add restart: [systemctl, reboot], or whatever restarts it"
            )
    measurements = best[1]
    evaluate = evaluator(results, goal)

    def plan(spent_s: Callable[[], float], report_progress: ReportProgress) -> NextRound:
        write_goal(results, goal)
        findings = read_findings(results, evaluate, spent_s)
        return rounds(chosen, goal, campaign.seed or 0, measurements, findings, report_progress, len(targets))

    def print_progress(progress: Sequence[Progress], spent_s: float) -> None:
        if all(group.standing is None for group in progress):
            return
        print_line(f"-- {duration(spent_s)} of at most {duration(goal.at_most_ns / 1e9)}")
        for group in progress:
            print_line(f"   {progress_line(group, goal)}")

    statuses: dict[str, RunStatus] = {}
    names = [target.name for target in targets]
    if not campaign_runner.has_rounds(
        results, campaign.name, groups, lambda spent_s: plan(spent_s, lambda *_: None), *names
    ):
        print_note(f"rtrun: nothing is left to measure in {results}; --fresh measures again beside it")
    else:
        try:
            statuses = measure_on(
                targets,
                campaign.name,
                groups,
                results,
                RoundProgress(),
                chosen=chosen,
                variants=variants_of(campaign, file.parent),
                rounds=lambda spent_s: plan(spent_s, print_progress),
            )
        except (KeyboardInterrupt, InfrastructureError):
            print_line(f"what was measured is kept in {results}; the same command goes on there")
            raise
    if not any(is_closed(folder) for folder in results.iterdir()):
        raise UsageError(
            f"{file}: until.at_most: {duration(goal.at_most_ns / 1e9)} were over before a run was finished, "
            "allow more: the start of the target counts too"
        )
    print_answers(study(results, goal.question, bounds=False))
    for line in remarks_of(sorted(folder for folder in results.iterdir() if is_closed(folder))):
        print_line(line)
    failed = [name for name, status in statuses.items() if status is not RunStatus.OK]
    if unanswered := stopped_by_time(chosen, evaluate(), failed):
        print_line(
            f"{file}: until.at_most: {duration(goal.at_most_ns / 1e9)} are over, and {len(unanswered)} of "
            f"{counted(len(chosen), 'group')} {'has' if len(unanswered) == 1 else 'have'} no answer: allow more, and "
            "the same command goes on; what was measured counts"
        )
    return statuses
