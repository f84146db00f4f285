"""Values of one series, as arrays of 64-bit whole numbers."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Int64s = NDArray[np.int64]
Bools = NDArray[np.bool_]
PIECE = 1 << 16  # values that stay in the cache


def no_values() -> Int64s:
    return np.empty(0, np.int64)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class IndexedValues:
    """Values in nanoseconds and the index of each measurement, both of shape (n,).

    `absent`, int64 (a,), ascending, are the loops without a value, numbered together with those that have one: they did
    not fire, are missing or were skipped. `undecidable` is the reason why no answer can rest on the values, or empty.
    """

    values_ns: Int64s
    index: Int64s
    absent: Int64s = field(default_factory=no_values)
    undecidable: str = ""


def pieces(n: int, least: int = PIECE) -> Iterator[slice]:
    """Cut n values into pieces of PIECE, or of `least` if that is more."""
    length = max(PIECE, least)
    return (slice(start, start + length) for start in range(0, n, length))
