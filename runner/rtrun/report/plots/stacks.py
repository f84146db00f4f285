"""The picture of layers put upon one another: the mean of the lowest one, then what each layer above adds to it."""

import itertools
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from rtfiles.quantities import signed, time
from rtrun.report.layers import LayerBar

_COLOURS = 8  # of the page, 0 to 7
# A bar longer than most by this factor does not set the scale: it would make the others invisible.
_LONGER = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class StackPart:
    """One layer of a bar: places are percentages of the picture's width; the ends of the interval come last."""

    text: str
    colour: int
    left: float
    width: float
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Stack:
    """The bar of a chain of layers, from the lowest up."""

    name: str
    parts: tuple[StackPart, ...]
    is_cut: bool
    """The bar, or an interval in it, extends beyond the picture."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Stacks:
    """The bars of all chains on one scale."""

    bars: tuple[Stack, ...]
    width: str
    """The time that the whole width stands for."""


def stacked(chains: Sequence[Sequence[LayerBar]]) -> Stacks | None:
    """A bar for each chain of layers; None without chains."""
    if not chains:
        return None
    width_us = _width_us(chains) or 1.0
    return Stacks(bars=tuple(_stack(chain, width_us) for chain in chains), width=time(1000 * width_us))


def _begins_us(chain: Sequence[LayerBar]) -> list[float]:
    """Where each layer of a bar begins, and where the last one ends."""
    return [*itertools.accumulate((bar.us for bar in chain), initial=0.0)]


def _end_us(chain: Sequence[LayerBar]) -> float:
    """Where a bar ends, including its intervals."""
    return max(begin + max(bar.us, bar.high_us) for begin, bar in zip(_begins_us(chain), chain, strict=False))


def _width_us(chains: Sequence[Sequence[LayerBar]]) -> float:
    limit_us = _LONGER * statistics.median(max(_begins_us(chain)) for chain in chains)
    return max((end for chain in chains if (end := _end_us(chain)) <= limit_us), default=limit_us)


def _stack(chain: Sequence[LayerBar], width_us: float) -> Stack:
    def place(us: float) -> float:
        return 100 * min(max(us, 0.0), width_us) / width_us

    parts = []
    for number, (begin_us, bar) in enumerate(zip(_begins_us(chain), chain, strict=False)):
        left, right = sorted((place(begin_us), place(begin_us + bar.us)))
        text = f"{bar.short} {time(1000 * bar.us)}"
        if number:
            between = f"{signed(1000 * bar.low_us)} to {signed(1000 * bar.high_us)}"
            text = f"{bar.short} {signed(1000 * bar.us)} ({between})"
        parts.append(
            StackPart(
                text=text,
                colour=number % _COLOURS,
                left=left,
                width=right - left,
                low=place(begin_us + bar.low_us) if number else None,
                high=place(begin_us + bar.high_us) if number else None,
            )
        )
    return Stack(name=chain[-1].label, parts=tuple(parts), is_cut=_end_us(chain) > width_us)
