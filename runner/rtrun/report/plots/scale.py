"""How a plot's value axis is divided: evenly, or logarithmically where an even axis would hide most of the data."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtfiles.quantities import grouped
from rtrun.analysis.histogram import Histogram

Floats = NDArray[np.float64]
# An even axis stays as long as the central 99.8 % of the values take this share of it.
_VISIBLE_SHARE = 0.25
_CENTRAL = (0.001, 0.999)


class Division(Enum):
    """LINEAR, LOG for values above zero, or SIGNED: the logarithm of 1 us + |value|, to both sides of zero."""

    LINEAR = "linear"
    LOG = "log"
    SIGNED = "signed"


@dataclass(frozen=True, kw_only=True)
class Scale:
    """A value axis from `low_us` to `high_us`."""

    division: Division
    low_us: float
    high_us: float

    def place(self, values_us: Any) -> Floats:
        """Where values, in us, lie on the axis; the axis is logarithmic itself for LOG, else its unit is this place."""
        values = np.asarray(values_us, dtype=np.float64)
        return np.sign(values) * np.log10(1 + np.abs(values)) if self.division is Division.SIGNED else values

    def edges_us(self, count: int) -> Floats:
        """Ascending edges of about so many bins of equal width on the axis, in whole us, as histograms have them."""
        low, high = math.floor(self.low_us), math.floor(self.high_us) + 1
        if self.division is Division.LINEAR:
            step = max(1, math.ceil((high - low) / count))
            return np.arange(low, high + step, step, dtype=np.float64)
        if self.division is Division.LOG:
            edges = np.geomspace(max(low, 1), max(high, 2), count + 1)
        else:
            first, last = self.place([low, high]).tolist()
            places = np.linspace(first, last, count + 1)
            edges = np.sign(places) * (10 ** np.abs(places) - 1)
        return np.unique(np.concatenate(([low], np.floor(edges), [high]))).astype(np.float64)

    def axis(self, title: str) -> dict[str, Any]:
        """The axis as plotly takes it."""
        axis: dict[str, Any] = {"title": {"text": title}}
        if self.division is Division.LOG:
            return axis | {"type": "log", "minorloglabels": "none"}
        if self.division is Division.SIGNED:
            most = math.ceil(math.log10(1 + max(abs(self.low_us), abs(self.high_us))))
            decades = [10.0**k for k in range(1, most + 1)]
            ticks = [-tick for tick in reversed(decades)] + [0.0] + decades
            ticks = [tick for tick in ticks if self.low_us * 1.1 <= tick <= self.high_us * 1.1]
            return axis | {
                "tickvals": rounded(self.place(ticks)),
                "ticktext": [grouped(tick) for tick in ticks],
            }
        return axis


def scale_of(histogram: Histogram, limit_us: float | None) -> Scale:
    """The axis for these values, one at least, and a limit that is drawn with them, if there is one."""
    below = np.cumsum(histogram.counts)
    ranks = np.ceil(np.array(_CENTRAL) * below[-1]).astype(np.int64)
    first, last = histogram.values_ns[np.searchsorted(below, np.clip(ranks, 1, below[-1]))] / 1000
    limits = () if limit_us is None else (limit_us,)
    low = min((float(histogram.values_ns[0]) / 1000, *limits))
    high = max((float(histogram.values_ns[-1] + histogram.bin_ns) / 1000, *limits))
    division = Division.LINEAR
    if last - first < _VISIBLE_SHARE * (high - low):
        division = Division.LOG if low >= 1 else Division.SIGNED
    return Scale(division=division, low_us=low, high_us=high)


def rounded(values: Any, digits: int = 6) -> list[float]:
    """Plain numbers with so many significant digits, for a page that stays small."""
    return [float(f"{value:.{digits}g}") for value in np.asarray(values, dtype=np.float64).tolist()]
