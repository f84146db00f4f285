"""Ranks, and the correlation of ranks."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtrun.analysis.chance.distributions import student_below


def ranks(values: ArrayLike) -> NDArray[np.float64]:
    """The rank of each value from 1 up; equal values have the mean of their ranks."""
    _, place, counts = np.unique(np.asarray(values), return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - (counts - 1) / 2)[place], np.float64)


def rank_correlation(first: ArrayLike, second: ArrayLike) -> tuple[float, float]:
    """Spearman's correlation of two series of one length, and its two-sided p (Student's t, n - 2 degrees of freedom).

    Both are NaN for fewer than 3 values, and where all of one series are equal.
    """
    a, b = (ranked - ranked.mean() for ranked in (ranks(first), ranks(second)))
    scale = float(np.sqrt((a @ a) * (b @ b)))
    if scale == 0 or a.size < 3:
        return float("nan"), float("nan")
    r = min(1.0, max(-1.0, float(a @ b) / scale))
    if abs(r) == 1:
        return r, 0.0
    t = r * np.sqrt((a.size - 2) / ((1 + r) * (1 - r)))
    return r, 2 * student_below(-abs(float(t)), a.size - 2)
