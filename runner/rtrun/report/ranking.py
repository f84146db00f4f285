"""Which middleware keeps the deadline best: groups that differ in nothing but the middleware, the best one first."""

from collections.abc import Sequence

from rtfiles.output import counted
from rtfiles.quantities import time_us
from rtrun.judgement.digest import pool_figures
from rtrun.judgement.groups import Group, format_parameters
from rtrun.judgement.study import Study
from rtrun.judgement.verdicts import severity, verdict_line
from rtrun.plan.suites import middleware_of
from rtrun.report.tables import Table
from rtrun.targets.inspection.platform import Platform

_QUANTILES = (50.0, 99.0, 99.99)


def ranking(study: Study) -> Table:
    """A row for each middleware of each comparison; none where there is but one, or an emulated board's times."""
    groups = () if study.platform is Platform.EMULATED else study.groups
    compared = [alike for alike in _alike_but_for_the_middleware(groups) if len(alike) > 1]
    rows = [_row(place, group) for alike in compared for place, group in enumerate(sorted(alike, key=_rank), start=1)]
    return Table(
        id="ranking",
        title="Middlewares ranked",
        columns=(
            "what",
            "rank",
            "middleware",
            "answer",
            "late",
            "P(late) at most",
            "median us",
            "p99 us",
            "p99.99 us",
            "max us",
        ),
        rows=rows,
        outcome=f"{counted(len(compared), 'comparison')} of middlewares",
        numbers=4,
        notes=(
            "Ranked by the answer, then by the upper end of the interval of P(late), then by p99. Neighbours may have "
            "changed places by chance: rtrun compare --by middleware says which of two differ.",
        ),
    )


def _alike_but_for_the_middleware(groups: Sequence[Group]) -> list[list[Group]]:
    alike: dict[tuple[str, ...], list[Group]] = {}
    for group in groups:
        if group.n and group.verdict and "middleware" in group.parameters:
            alike.setdefault((group.target, _what(group)), []).append(group)
    return list(alike.values())


def _what(group: Group) -> str:
    """What was measured, whatever through."""
    others = {key: value for key, value in group.parameters.items() if key != "middleware"}
    return f"{group.suite.removesuffix('_tests')} {format_parameters(others)}"


def _rank(group: Group) -> tuple[float, ...]:
    assert group.verdict is not None
    line = verdict_line(group)
    p99_ns = pool_figures(group.digests).percentiles_ns.get(99.0)
    return (-severity(line.answer, None)[0], group.verdict.upper, float("inf") if p99_ns is None else p99_ns)


def _row(place: int, group: Group) -> tuple[str, ...]:
    assert group.verdict is not None
    figures, verdict = pool_figures(group.digests), group.verdict
    return (
        _what(group) if place == 1 else "",
        str(place),
        middleware_of(group.suite, group.parameters),
        verdict_line(group).answer,
        f"{verdict.misses} of {verdict.n}",
        f"{verdict.upper:.2g}",
        *(time_us(figures.percentiles_ns.get(quantile)) for quantile in _QUANTILES),
        time_us(figures.max_ns),
    )
