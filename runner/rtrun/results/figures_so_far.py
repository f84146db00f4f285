"""What a suite has measured so far: ``<output>.live``, which it overwrites once a second (see docs/formats.md)."""

from collections.abc import Collection
from dataclasses import dataclass

from rtfiles.untrusted import whole_number
from rtrun.kinds.limits import COUNT_MAX, TIME_MAX_NS

ENDING = ".live"


@dataclass(frozen=True, slots=True, kw_only=True)
class FiguresSoFar:
    """How many values there are, at least one; the lowest, the mean and the highest."""

    n: int
    min_ns: int
    mean_ns: int
    max_ns: int


def read_figures(line: str) -> FiguresSoFar | None:
    """Read the line of a file; None where it is not one of a suite, or was read while it was written."""
    try:
        number, *times = line.split()
        low, mean, high = (whole_number(word, lowest=-TIME_MAX_NS, highest=TIME_MAX_NS) for word in times)
        n = whole_number(number, lowest=1, highest=COUNT_MAX)
    except ValueError:
        return None
    return FiguresSoFar(n=n, min_ns=low, mean_ns=mean, max_ns=high) if low <= mean <= high else None


def pooled(parts: Collection[FiguresSoFar]) -> FiguresSoFar:
    """The figures of several outputs together; there is at least one."""
    n = sum(part.n for part in parts)
    return FiguresSoFar(
        n=n,
        min_ns=min(part.min_ns for part in parts),
        mean_ns=sum(part.n * part.mean_ns for part in parts) // n,
        max_ns=max(part.max_ns for part in parts),
    )
