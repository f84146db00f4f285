"""Were two sets of runs measured in turn, so that what drifts over a campaign lies in both alike?"""

from collections.abc import Sequence

import numpy as np

# Of all pairs of runs, one of each set, so large a part at least must be in either order.
_LEAST_PART = 0.25


def is_interleaved(starts_a: Sequence[str], starts_b: Sequence[str]) -> bool:
    """Whether runs that began at these times (ISO 8601, "" where not known) were measured in turn.

    Two runs a side at least, and the first of a pair is of either set in a quarter of all pairs or more (the statistic
    of Mann & Whitney 1947; ties count half): a steady drift then moves the two sets by nearly the same.
    """
    if min(len(starts_a), len(starts_b)) < 2 or "" in (*starts_a, *starts_b):
        return False
    a, b = np.array(starts_a)[:, None], np.array(starts_b)[None, :]
    part = float(np.mean(np.where(a == b, 0.5, a < b)))
    return _LEAST_PART <= part <= 1 - _LEAST_PART
