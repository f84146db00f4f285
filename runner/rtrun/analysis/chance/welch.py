"""The difference of two means with spreads of their own (Welch 1947)."""

import math

import numpy as np
from numpy.typing import NDArray


def standard_error(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, float]:
    """The standard error of the difference of two means, and its degrees of freedom (Welch and Satterthwaite).

    The values have the shapes (u,) and (v,), at least two each.

    Equal values have no error; any number of degrees of freedom then fits, and 1 is returned.
    """
    parts = [float(values.var(ddof=1)) / values.size for values in (a, b)]
    error = math.sqrt(sum(parts))
    if not error:
        return 0.0, 1.0
    degrees = sum(parts) ** 2 / sum(part**2 / (values.size - 1) for part, values in zip(parts, (a, b), strict=True))
    return error, degrees
