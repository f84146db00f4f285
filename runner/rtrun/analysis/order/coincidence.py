"""Which of many quantities were unusual in the time intervals with the highest values?"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import normal_quantiles

ALPHA = 0.01
# The lowest p-value that n intervals allow is 1 / n.
LEAST_INTERVALS = 100
# A tenth of the intervals counts as late: those with the highest values.
LATE_PART = 10
# What is usual is the median of an interval and its neighbours, so many on each side.
NEIGHBOURS = 10

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class Coincidence:
    """A quantity (its row) that was unusual in the late intervals: its median in these, and in the others.

    `p_value` is the probability that any of all quantities coincides as strongly by chance.
    """

    row: int
    late: float
    otherwise: float
    p_value: float


def find_coincidences(quantities: Floats, highest: Floats) -> tuple[Coincidence, ...]:
    """The quantities (m, n) that are higher or lower than usual in the intervals with the highest of `highest` (n,).

    Each quantity is replaced by normal scores of its distances from the median of the neighbourhood, so neither a
    common drift nor its unit matters. The statistic is the sum of the scores over the late intervals, the highest
    weighted most. If nothing coincides, the late intervals may as well be shifted against the quantities in a circle. A
    shift keeps the dependence of each series on its own past; all n shifts are tried. The largest statistic of all
    quantities at each shift gives p-values that hold for all of them together (Westfall & Young 1993, Resampling-Based
    Multiple Testing, section 2.3). Most significant first.
    """
    rows, n = quantities.shape
    if n < LEAST_INTERVALS or rows == 0:
        return ()
    late = np.zeros(n)
    late[np.argsort(highest, kind="stable")[n - n // LATE_PART :]] = np.arange(1, n // LATE_PART + 1)
    scores = np.array([_scores(row) for row in quantities])
    # Entry (j, s): the statistic of quantity j with the late intervals shifted by s.
    shifted = np.fft.irfft(np.fft.rfft(scores, axis=1) * np.conj(np.fft.rfft(late)), n=n, axis=1)
    statistics = np.abs(shifted)
    highest_by_chance = statistics[:, 1:].max(axis=0)
    found = []
    for row in range(rows):
        reached = np.count_nonzero(highest_by_chance >= statistics[row, 0] - 1e-9)
        p_value = (1 + int(reached)) / n
        if p_value <= ALPHA:
            found.append(
                Coincidence(
                    row=row,
                    late=float(np.median(quantities[row, late > 0])),
                    otherwise=float(np.median(quantities[row, late == 0])),
                    p_value=p_value,
                )
            )
    return tuple(sorted(found, key=lambda coincidence: (-statistics[coincidence.row, 0], coincidence.row)))


def _scores(values: Floats) -> Floats:
    """Normal scores of the values beyond the median around them, of mean 0 and variance 1; zeros for a constant."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, NEIGHBOURS, mode="reflect"), 2 * NEIGHBOURS + 1)
    _, inverse, counts = np.unique(values - np.median(windows, axis=1), return_inverse=True, return_counts=True)
    # Equal values share the mean of their ranks.
    scores = normal_quantiles((np.cumsum(counts) - (counts - 1) / 2) / (values.size + 1))[inverse]
    deviation = float(np.std(scores))
    return np.asarray((scores - scores.mean()) / deviation) if deviation > 0 else np.zeros(values.size)
