"""How an axis is divided so that it shows all values and most of them can be told apart."""

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtrun.analysis.histogram import Histogram

Floats = NDArray[np.float64]
# The central 98 % of the values are their bulk. The axis is even where the bulk takes at least this share of it.
_BULK = (0.01, 0.99)
_EVEN_SHARE = 0.2
# On less than this share of a logarithmic axis, the values of the bulk cannot be told apart.
_SEEN_SHARE = 0.1


class Division(Enum):
    """LINEAR; LOG, for values above zero; STRETCHED: even around the middle, logarithmic towards both ends."""

    LINEAR = "linear"
    LOG = "log"
    STRETCHED = "stretched"


@dataclass(frozen=True, kw_only=True, slots=True)
class Scale:
    """An axis from `low` to `high`; a stretched one is even for about `spread` to both sides of its `middle`."""

    division: Division
    low: float
    high: float
    middle: float = 0.0
    spread: float = 1.0

    def at(self, values: ArrayLike) -> Floats:
        """Where values lie on the axis: 0 is its low end, 1 its high one, and nothing lies beyond them."""
        low, high = self._place(np.array([self.low, self.high])).tolist()
        places = (self._place(np.asarray(values, dtype=np.float64)) - low) / ((high - low) or 1.0)
        return np.asarray(np.clip(places, 0.0, 1.0))

    def values_at(self, places: ArrayLike) -> Floats:
        """The values at these places, from 0 to 1."""
        low, high = self._place(np.array([self.low, self.high])).tolist()
        inner = low + np.asarray(places, dtype=np.float64) * (high - low)
        if self.division is Division.LOG:
            return np.asarray(10.0**inner)
        return np.asarray(inner if self.division is Division.LINEAR else self.middle + self.spread * np.sinh(inner))

    def _place(self, values: Floats) -> Floats:
        if self.division is Division.LOG:
            return np.asarray(np.log10(np.maximum(values, self.low)))
        if self.division is Division.STRETCHED:
            return np.asarray(np.arcsinh((values - self.middle) / self.spread))
        return values

    def edges(self, count: int, step: float) -> Floats:
        """Ascending edges of at most so many bins of equal width on the axis, each a multiple of `step`."""
        low, high = math.floor(self.low / step), math.floor(self.high / step) + 1
        if self.division is Division.LINEAR:
            width = max(1, math.ceil((high - low) / count))
            return np.arange(low, high + width, width, dtype=np.float64) * step
        inner = np.floor(self.values_at(np.linspace(0.0, 1.0, count + 1)) / step)
        return np.unique(np.concatenate(([low], inner[(inner > low) & (inner < high)], [high]))) * step


def scale_of(histogram: Histogram, limit_ns: float | None = None) -> Scale:
    """The axis, in ns, for these values (at least one), and for a limit if their bulk can then still be seen."""
    below = np.cumsum(histogram.counts)
    ranks = np.ceil(np.array([_BULK[0], 0.5, _BULK[1]]) * below[-1]).astype(np.int64)
    first, middle, last = histogram.values_ns[np.searchsorted(below, np.clip(ranks, 1, below[-1]))].tolist()
    low, high = float(histogram.values_ns[0]), float(histogram.values_ns[-1] + histogram.bin_ns)
    last += histogram.bin_ns
    ends = [(low, high)] if limit_ns is None else [(min(low, limit_ns), max(high, limit_ns)), (low, high)]
    for low, high in ends:
        even = Scale(division=Division.LINEAR, low=low, high=high)
        if last - first >= _EVEN_SHARE * (high - low):
            return even
        logarithmic = replace(even, division=Division.LOG)
        if low > 0 and float(np.diff(logarithmic.at([first, last]))[0]) >= _SEEN_SHARE:
            return logarithmic
    spread = max((last - first) / 2, 1.0)
    return replace(even, division=Division.STRETCHED, middle=float(middle), spread=spread)
