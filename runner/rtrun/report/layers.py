"""What each layer adds: the table, and the picture of layers put upon one another."""

from collections.abc import Sequence
from dataclasses import dataclass

from rtfiles.output import counted
from rtfiles.quantities import signed
from rtrun.analysis.comparison.layers import LATE, QUANTILES, Added
from rtrun.judgement.groups import Group
from rtrun.judgement.layers import LayerPair, chains
from rtrun.plan.middleware.description import NONE
from rtrun.plan.suites import middleware_of
from rtrun.report.tables import Table

TABLE = "layers"
_FIGURES = ("mean", *QUANTILES, LATE)


def table(pairs: Sequence[LayerPair], confidence: float) -> Table:
    """A row for each pair of layers, with what the upper one adds to each figure and its interval."""
    return Table(
        id=TABLE,
        title="What each layer adds",
        columns=("layer", "layer above", *(f"adds to {figure}" for figure in _FIGURES), "how"),
        rows=[_row(pair) for pair in pairs],
        outcome=f"{counted(len(pairs), 'pair')} of layers compared",
        notes=(
            f"In brackets: {100 * confidence:g} % confidence intervals.",
            "Means are added up from layer to layer; quantiles and P(late) of layers do not add up.",
        ),
        how="comparison",
    )


def _row(pair: LayerPair) -> tuple[str, ...]:
    added = {part.figure: part for part in pair.attribution.added}
    how = f"refused: {pair.attribution.refused}" if pair.attribution.refused else pair.attribution.added[0].method
    cells = (_cell(added[figure]) if figure in added else "-" for figure in _FIGURES)
    return (pair.below.label, pair.above.label, *cells, how)


def _cell(added: Added) -> str:
    if added.figure == LATE:
        return f"{added.added:+.2g} ({added.low:+.2g} to {added.high:+.2g})"
    return f"{signed(added.added)} ({signed(added.low)} to {signed(added.high)})"


@dataclass(frozen=True, kw_only=True)
class LayerBar:
    """One layer of a stack: the mean of the lowest layer, or what a higher one adds, with its interval, in us."""

    label: str
    short: str
    us: float
    low_us: float
    high_us: float


def stacks(pairs: Sequence[LayerPair]) -> tuple[tuple[LayerBar, ...], ...]:
    """Each chain of layers, from the lowest up."""
    return tuple(
        (
            LayerBar(label=chain[0].below.label, short=_short(chain[0].below), us=mean, low_us=mean, high_us=mean),
            *map(_bar, chain),
        )
        for chain in chains(pairs)
        if (mean := _mean_us(chain[0].below)) is not None
    )


def _bar(pair: LayerPair) -> LayerBar:
    (mean,) = (part for part in pair.attribution.added if part.figure == "mean")
    return LayerBar(
        label=pair.above.label,
        short=_short(pair.above),
        us=mean.added / 1000,
        low_us=mean.low / 1000,
        high_us=mean.high / 1000,
    )


def _short(group: Group) -> str:
    """The middleware of a layer, or the tool of the system."""
    middleware = middleware_of(group.suite, group.parameters)
    return group.suite if middleware == NONE else middleware


def _mean_us(group: Group) -> float | None:
    blocks = [run for run in group.blocks if run.n]
    total = sum(run.n for run in blocks)
    return sum(float(run.sums_ns.sum()) for run in blocks) / total / 1000 if total else None
