"""Do events come at a fixed distance, or evenly anywhere? Bursts count once."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import chi_squared_above, smirnov_above
from rtrun.kinds.values import Int64s


def burst_peaks(positions: Sequence[int], loops: int) -> Int64s:
    """Ascending places of events, one for each burst: events nearer than 1/500 of the run to the one before are left
    out."""
    places = np.sort(np.asarray(positions, dtype=np.int64))
    return places[np.diff(places, prepend=-loops) > loops // 500]


def evenly_spread_p(places: NDArray[np.float64]) -> float:
    """The p-value that places, as parts of 1, are spread evenly: two-sided test of Kolmogorov and Smirnov.

    Twice the exact one-sided p (Birnbaum & Tingey 1951). Above 0.1 it is too high; below, it is exact to 1 in 10^4,
    because both sides are seldom so far off.
    """
    ordered = np.sort(places)
    steps = np.arange(ordered.size + 1) / ordered.size
    farthest = max(float((steps[1:] - ordered).max()), float((ordered - steps[:-1]).max()))
    return min(1.0, 2 * smirnov_above(farthest, ordered.size))


def find_period(runs: Sequence[tuple[Int64s, int]]) -> tuple[int, float]:
    """The period that best fits the events of several runs, (places, loops) each, and the p-value of having none.

    Rayleigh's test (Mardia & Jupp 2000, section 6.3.1) with an unknown phase in each run: the sum over runs of 2 k R^2
    is chi-squared with two degrees of freedom a run. Periods of 1, 2, 5, 10, ... and powers of two, from 10 loops to a
    fourth of the shortest run, are tried; the p-value is corrected after Bonferroni.
    """
    most = min(loops for _, loops in runs) // 4
    decimal = {step * 10**power for step in (1, 2, 5) for power in range(1, 8)}
    periods = sorted(period for period in decimal | {2**power for power in range(4, 24)} if 10 <= period <= most)
    counted = [places for places, _ in runs if places.size >= 3]
    if not periods or not counted:
        return 0, 1.0
    p_values = []
    for period in periods:
        statistic = sum(2 * abs(np.exp(2j * np.pi * places / period).sum()) ** 2 / places.size for places in counted)
        p_values.append(chi_squared_above(float(statistic), 2 * len(counted)))
    best = int(np.argmin(p_values))
    return periods[best], min(1.0, p_values[best] * len(periods))
