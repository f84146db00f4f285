"""Were two sets of runs measured in turn, so that a drift over the campaign affects both alike?"""

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray


def is_interleaved(starts_a: Sequence[str], starts_b: Sequence[str]) -> bool:
    """Whether runs that began at these times (ISO 8601, anything else where not known) were measured in turn.

    They were if there are at least two runs a side, and the mean start times differ by no more than the standard
    deviation of that difference in random order. A steady drift then shifts the two sets by no more than the standard
    error that the drift itself adds to the shift, so a test that ignores the order of runs keeps its level.
    """
    a, b = seconds(starts_a), seconds(starts_b)
    if a is None or b is None or min(a.size, b.size) < 2:
        return False
    spread_s = float(np.concatenate((a, b)).std(ddof=1)) * (1 / a.size + 1 / b.size) ** 0.5
    return bool(abs(a.mean() - b.mean()) <= spread_s)


def seconds(starts: Sequence[str]) -> NDArray[np.float64] | None:
    """Times of ISO 8601 (UTC where they name no zone) in seconds, shape (n,); None where one is not a time."""
    try:
        times = [datetime.fromisoformat(start) for start in starts]
    except ValueError:
        return None
    return np.array([(time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp() for time in times])
