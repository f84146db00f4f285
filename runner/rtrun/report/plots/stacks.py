"""The picture of layers put upon one another: the mean of the lowest one, then what each layer above adds to it."""

from collections.abc import Sequence
from dataclasses import dataclass

from rtfiles.quantities import signed, time
from rtrun.report.layers import LayerBar

_COLOURS = 8  # of the page, 0 to 7


@dataclass(frozen=True, kw_only=True, slots=True)
class StackPart:
    """One layer of a bar: places are percentages of the picture's width, those of the interval's ends last."""

    text: str
    colour: int
    left: float
    width: float
    low: float | None
    high: float | None


def stacked(chains: Sequence[Sequence[LayerBar]]) -> list[tuple[str, list[StackPart]]]:
    """A bar for each chain of layers: its name, and its parts from the lowest layer on."""
    longest = max((sum(max(bar.us, 0.0, bar.high_us) for bar in chain) for chain in chains), default=0.0) or 1.0
    return [(chain[-1].label, _parts(chain, 100 / longest)) for chain in chains]


def _parts(chain: Sequence[LayerBar], percent: float) -> list[StackPart]:
    begin_us, parts = 0.0, []
    for place, bar in enumerate(chain):
        ends = (begin_us, begin_us + bar.us)
        told = f"{bar.short} {time(1000 * bar.us)}"
        if place:
            between = f"{signed(1000 * bar.low_us)} to {signed(1000 * bar.high_us)}"
            told = f"{bar.short} {signed(1000 * bar.us)} ({between})"
        parts.append(
            StackPart(
                text=told,
                colour=place % _COLOURS,
                left=percent * min(ends),
                width=percent * abs(bar.us),
                low=percent * (begin_us + bar.low_us) if place else None,
                high=percent * (begin_us + bar.high_us) if place else None,
            )
        )
        begin_us = ends[1]
    return parts
