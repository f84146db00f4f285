"""Which middleware keeps the deadline best: groups that differ only in the middleware, the best one first."""

from collections.abc import Sequence
from dataclasses import dataclass

from rtfiles.output import counted
from rtfiles.quantities import grouped, rounded_up, time
from rtrun.analysis.deadline import Verdict
from rtrun.analysis.figures import Figures
from rtrun.judgement.digest import pool_figures
from rtrun.judgement.groups import Group
from rtrun.judgement.study import Study
from rtrun.judgement.verdicts import severity, verdict_line
from rtrun.plan.short_names import format_parameters
from rtrun.plan.suites import middleware_of
from rtrun.report.quantities import times_ns
from rtrun.report.tables import Table
from rtrun.targets.inspection.platform import Platform


def ranking(study: Study) -> Table:
    """A row for each middleware of each comparison; none for a single middleware, or for an emulated board's times."""
    groups = () if study.platform is Platform.EMULATED else study.groups
    compared = [[*map(_ranked, alike)] for alike in _alike_but_for_the_middleware(groups) if len(alike) > 1]
    rows = [_row(place, ranked) for alike in compared for place, ranked in enumerate(sorted(alike, key=_rank), start=1)]
    return Table(
        id="ranking",
        title="Middlewares ranked",
        columns=("what", "rank", "middleware", "answer", "late", "P(late) at most", "max", "p99.99", "p99", "median"),
        rows=rows,
        outcome=f"{counted(len(compared), 'comparison')} of middlewares",
        numbers=range(4, 10),
        notes=(
            "Ranked by the answer, then by the upper end of the interval of P(late), then by p99. Neighbours may have "
            "changed places by chance: rtrun compare --by middleware says which of two differ.",
        ),
    )


@dataclass(frozen=True, kw_only=True)
class _Ranked:
    """The values that rank a middleware."""

    group: Group
    verdict: Verdict
    answer: str
    figures: Figures


def _alike_but_for_the_middleware(groups: Sequence[Group]) -> list[list[tuple[Group, Verdict]]]:
    alike: dict[tuple[str, ...], list[tuple[Group, Verdict]]] = {}
    for group in groups:
        if group.n and group.verdict and "middleware" in group.parameters:
            alike.setdefault((group.target, _what(group)), []).append((group, group.verdict))
    return list(alike.values())


def _what(group: Group) -> str:
    """What was measured, without the middleware."""
    others = {key: value for key, value in group.parameters.items() if key != "middleware"}
    return f"{group.suite.removesuffix('_tests')} {format_parameters(others)}"


def _ranked(judged: tuple[Group, Verdict]) -> _Ranked:
    group, verdict = judged
    answer, figures = verdict_line(group).answer, pool_figures(group.digests)
    return _Ranked(group=group, verdict=verdict, answer=answer, figures=figures)


def _rank(ranked: _Ranked) -> tuple[float, ...]:
    p99_ns = ranked.figures.percentiles_ns.get(99.0)
    return (-severity(ranked.answer, None)[0], ranked.verdict.upper, float("inf") if p99_ns is None else p99_ns)


def _row(place: int, ranked: _Ranked) -> tuple[str, ...]:
    times = times_ns(ranked.figures)
    return (
        _what(ranked.group) if place == 1 else "",
        str(place),
        middleware_of(ranked.group.suite, ranked.group.parameters),
        ranked.answer,
        f"{grouped(ranked.verdict.misses)} of {grouped(ranked.verdict.n)}",
        rounded_up(ranked.verdict.upper),
        *(time(times[name]) for name in ("max", "p99.99", "p99", "p50")),
    )
