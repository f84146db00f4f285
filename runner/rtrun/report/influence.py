"""What other nodes add to the paths of a topology, as a table."""

import statistics
from collections.abc import Sequence

from rtfiles.output import counted
from rtfiles.quantities import signed, time
from rtrun.analysis.comparison.layers import INFLUENCE_QUANTILES, LATE, Added, figure_of
from rtrun.judgement.groups import Group
from rtrun.judgement.influence import Influence, alone_of
from rtrun.kinds.known import called
from rtrun.plan.topology.others import OTHER_NODES
from rtrun.report.tables import Table

_ROUNDING = 1e-9
_FIGURES = ("mean", *INFLUENCE_QUANTILES, LATE)


def table(found: Sequence[Influence], confidence: float) -> Table:
    """Rows for each path: one of it alone, and one for each set of other nodes with what these add."""
    rows = []
    for alone in alone_of(found):
        rows.append((_path(alone), "nothing", str(alone.n), *(_alone(alone, figure) for figure in _FIGURES)))
        beside = [effect for effect in found if effect.alone.key == alone.key]
        rows += [("", effect.other_nodes, str(effect.beside.n), *_cells(effect)) for effect in beside]
    return Table(
        id="influence",
        title="What independent nodes add",
        columns=("measured", "beside it", "n", *_FIGURES),
        rows=rows,
        outcome=_outcome(found),
        numbers=range(2, 3 + len(_FIGURES)),
        notes=(
            "Alone: the medians of the runs. Beside others: what that adds, ± half of its "
            f"{100 * confidence:g} % confidence interval. Periods that the first node skipped are in no n.",
            *(
                dict.fromkeys(
                    f"refused: {effect.attribution.refused}" for effect in found if effect.attribution.refused
                )
            ),
        ),
        how="comparison",
    )


def _path(group: Group) -> str:
    through = f" through {group.parameters.get('middleware')}"
    return f"{called(group.series) or group.series} {group.parameters['path']} -> {group.parameters['sink']}{through}"


def _alone(group: Group, figure: str) -> str:
    late_ns = group.question.limit_ns if group.question else 0
    if figure == LATE:
        return "-" if not late_ns else f"{_middle(group, figure, late_ns):.2g}"
    enough = figure == "mean" or min(run.n for run in group.blocks) * (1 - INFLUENCE_QUANTILES[figure]) >= 1
    return time(round(_middle(group, figure, late_ns))) if enough else "-"


def _middle(group: Group, figure: str, late_ns: int) -> float:
    return statistics.median(figure_of(run, figure, late_above_ns=late_ns) for run in group.blocks)


def _cells(effect: Influence) -> tuple[str, ...]:
    added = {part.figure: part for part in effect.attribution.added}
    return tuple(_cell(added[figure]) if figure in added else "-" for figure in _FIGURES)


def _cell(added: Added) -> str:
    half = (added.high - added.low) / 2
    if added.figure == LATE:
        # Where all runs are equal, for example without late values, the differences between runs are not known.
        alike = "none late" if not added.added else f"{added.added:+.2g} in all runs"
        return f"{added.added:+.2g} ± {half:.2g}" if half > _ROUNDING else alike
    return f"{signed(added.added)} ± {time(round(half))}"


def _outcome(found: Sequence[Influence]) -> str:
    """The other nodes that add most to a median beyond doubt."""
    medians = [(effect, added) for effect in found for added in effect.attribution.added if added.figure == "median"]
    seen = [(effect, added) for effect, added in medians if added.low > 0]
    if not medians:
        return "too few runs to say what other nodes add"
    if not seen:
        return f"none of {counted(len(medians), 'comparison')} shows that other nodes add to a median"
    effect, most = max(seen, key=lambda pair: pair[1].added)
    return (
        f"{len(seen)} of {counted(len(medians), 'comparison')} show that other nodes add to the median; most is "
        f"{signed(most.added)}, of {effect.beside.parameters[OTHER_NODES]}"
    )
