"""Is an effect at least as large as claimed? Runs are the units; each has one figure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.chance.distributions import student_below
from rtrun.analysis.chance.welch import standard_error


@dataclass(frozen=True, kw_only=True, slots=True)
class Effect:
    """B minus A of one figure over runs, with its p-values against a claimed effect.

    ``p_above`` is the chance of a shift at least as large if the true shift is the claimed one or less. ``p_below`` is
    the chance of a shift at most as large if the true shift is at least the smallest one that does not refute.
    """

    a_ns: float
    b_ns: float
    p_above: float
    p_below: float


def examine_effect(
    a_ns: NDArray[np.float64], b_ns: NDArray[np.float64], *, sign: int, least_ns: float, refuting_ns: float
) -> Effect:
    """Test one figure of runs, shapes (u,) and (v,), against a claimed effect in the direction of `sign` (1 or -1).

    One-sided tests of Welch (1947): is the shift above `least_ns`, is it below `refuting_ns`?
    """
    shift = sign * float(b_ns.mean() - a_ns.mean())
    error, degrees = standard_error(a_ns, b_ns)

    def chance(distance: float) -> float:
        if error:
            return student_below(-distance / error, degrees)
        return 0.0 if distance > 0 else 1.0

    return Effect(
        a_ns=float(a_ns.mean()),
        b_ns=float(b_ns.mean()),
        p_above=chance(shift - least_ns),
        p_below=chance(refuting_ns - shift),
    )


def holm(p_values: Sequence[float], level: float) -> list[bool]:
    """Which of several hypotheses to reject, so that the chance of any mistake is at most `level` (Holm 1979)."""
    rejected = [False] * len(p_values)
    for rank, index in enumerate(sorted(range(len(p_values)), key=lambda k: p_values[k])):
        if p_values[index] > level / (len(p_values) - rank):
            break
        rejected[index] = True
    return rejected
