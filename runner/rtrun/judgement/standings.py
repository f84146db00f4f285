"""How far each group of a campaign is from its answer, which steers the rounds of a goal."""

from collections.abc import Callable
from pathlib import Path

from rtrun.analysis.standing import Standing
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Known, Study, study
from rtrun.plan.goal import Goal
from rtrun.results.record import is_closed


def standings(study: Study) -> tuple[Standing, ...]:
    """The standing of each group of a study, groups of similar boards before those of each board."""
    times_s = {record.run: record.duration_s for record in study.records}
    return tuple(_standing(group, study, times_s) for group in study.answers)


def evaluator(results: Path, goal: Goal) -> Callable[[], tuple[Standing, ...]]:
    """Return a function that reads the answers of a campaign from its results so far. It reads a closed run only
    once."""
    known: Known = {}

    def evaluate() -> tuple[Standing, ...]:
        if not any(is_closed(folder) for folder in results.iterdir()):
            return ()
        return standings(study(results, goal.question, bounds=False, known=known))

    return evaluate


def _standing(group: Group, study: Study, times_s: dict[str, float]) -> Standing:
    observed_by = tuple(dict.fromkeys(record.observed_by for record in group.records if record.observed_by))
    return Standing(
        label=study.name(group),
        short=study.short_name(group),
        runs=group.runs,
        verdict=group.verdict,
        undecidable=group.undecidable,
        has_deadline=group.question is not None,
        measured_s=sum(times_s.get(run, 0.0) for run in group.runs),
        boards=frozenset(group.boards),
        observed_by=observed_by,
        stream=group.label if observed_by else "",
    )
