"""The table of worst cases by extreme value theory."""

from rtfiles.output import counted
from rtfiles.quantities import grouped, time
from rtrun.analysis.tails.extreme_values import Bound
from rtrun.analysis.tails.worst_case import disagreement
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.report.tables import Table


def worst_cases(study: Study) -> Table:
    """The bounds of each group; without rows where no bound may be given."""
    rows: list[tuple[str, ...]] = []
    for group in study.groups if _given_bounds(study) else ():
        if group.no_bound:
            rows.append((group.label, "-", "refused", group.no_bound))
        rows += [(group.label, bound.method, *_bound(bound)) for bound in group.bounds]
        if (text := disagreement(group.bounds)) is not None:
            rows.append((group.label, "-", "doubtful", text))
    return Table(
        id="worst-case",
        title="Worst case by extreme value theory",
        columns=(
            "suite and parameters",
            "method",
            f"level exceeded once in {grouped(1 / study.question.probability)}",
            "found",
        ),
        rows=rows,
        outcome=_bounds_outcome(study),
        notes=("A bound is printed only where every assumption was tested and held.",),
        how="worst-case",
    )


def _given_bounds(study: Study) -> list[tuple[float, Group]]:
    """The upper ends of the bounds that may be given, with their groups."""
    return [
        (bound.high_ns, group)
        for group in study.groups
        for bound in group.bounds
        if bound.refused is None and bound.high_ns is not None
    ]


def _bounds_outcome(study: Study) -> str:
    """In how many scenarios a bound may be given, and the highest bound."""
    given = _given_bounds(study)
    highest_ns, label = max(((high_ns, group.label) for high_ns, group in given), default=(0.0, ""))
    scenarios = len({group.key for _, group in given})
    return f"a bound in {scenarios} of {len(study.groups)} scenarios, the highest {time(highest_ns)} for {label}"


def _bound(bound: Bound) -> tuple[str, str]:
    if bound.refused is not None or bound.level_ns is None or bound.low_ns is None or bound.high_ns is None:
        return "refused", bound.refused or "no level"
    return (
        f"{time(bound.level_ns)} ({100 * bound.confidence:g} % CI {time(bound.low_ns)} to {time(bound.high_ns)})",
        ", ".join(
            [
                f"shape {bound.shape:.3f}",
                counted(bound.points, "point"),
                *(f"{c.name} p = {c.p_value:.2g}" for c in bound.checks if c.p_value is not None),
            ]
        ),
    )
