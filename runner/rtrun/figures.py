"""The figures of one series: how many, how low, how high, and where.

A percentile is a value that occurred: the smallest one such that at least that share of all values is not above it
(the inverse of the empirical distribution function, definition 1 in Hyndman and Fan, "Sample Quantiles in Statistical
Packages", The American Statistician 50 (1996) 361-365). The 99.9th percentile of fewer than 1000 values thus is
their maximum.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Int64s = npt.NDArray[np.int64]

PERCENTILE_METHOD = "inverted_cdf"
LISTED = 10  # values in the lists of the highest and the lowest, as the programs print them
PER_MILLE = {"p50_us": 500, "p90_us": 900, "p99_us": 990, "p999_us": 999}


@dataclass(frozen=True, kw_only=True, slots=True)
class Ranked:
    """A value and the index of its measurement; None when the source does not tell it."""

    value_us: float
    index: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Figures:
    """Figures of one series in microseconds; the numbers are None and the lists empty when n is 0.

    `resolution_ns` is 1 for figures of samples and 1000 for figures of a log's bins. `top` falls from the highest,
    `lowest` rises from the lowest value; equal values stand in the order of their index.
    """

    n: int
    min_us: float | None
    mean_us: float | None
    max_us: float | None
    p50_us: float | None
    p90_us: float | None
    p99_us: float | None
    p999_us: float | None
    top: tuple[Ranked, ...]
    lowest: tuple[Ranked, ...]
    missing: int
    out_of_order: int
    duplicate: int
    not_fired: int
    resolution_ns: int

    def as_json(self) -> dict[str, Any]:
        """The figures under their own names, and how the percentiles were taken."""
        return asdict(self) | {"percentile_method": PERCENTILE_METHOD}


def figures(
    values_ns: Int64s,
    index: Int64s | None = None,
    *,
    missing: int = 0,
    out_of_order: int = 0,
    duplicate: int = 0,
    not_fired: int = 0,
) -> Figures:
    """Figures of the values of a series, shape (n,), nanoseconds.

    `index`, shape (n,), names the measurement of each value; without it a value's position does.
    """
    index = np.arange(len(values_ns)) if index is None else index
    rising = np.lexsort((index, values_ns))
    falling = np.lexsort((index, -values_ns))[:LISTED]

    def ranked(order: npt.NDArray[np.intp]) -> tuple[Ranked, ...]:
        return tuple(Ranked(value_us=int(values_ns[i]) / 1000, index=int(index[i])) for i in order)

    values, counts = np.unique(values_ns, return_counts=True)
    return _figures(
        values,
        counts,
        1,
        top=ranked(falling),
        lowest=ranked(rising[:LISTED]),
        missing=missing,
        out_of_order=out_of_order,
        duplicate=duplicate,
        not_fired=not_fired,
    )


def figures_of_bins(
    value_us: Int64s,
    count: Int64s,
    *,
    top: tuple[Ranked, ...] = (),
    lowest: tuple[Ranked, ...] = (),
    missing: int = 0,
    out_of_order: int = 0,
    duplicate: int = 0,
    not_fired: int = 0,
) -> Figures:
    """Figures of a histogram: `value_us` rising, `count` above 0, both of shape (bins,).

    They are as coarse as the bins, 1 us. `top` and `lowest` are the lists that the log prints, best first, of the same
    values; they lend their indices, and a value beyond the end of a list has none.
    """
    return _figures(
        value_us,
        count,
        1000,
        top=_indexed(value_us[::-1], count[::-1], top),
        lowest=_indexed(value_us, count, lowest),
        missing=missing,
        out_of_order=out_of_order,
        duplicate=duplicate,
        not_fired=not_fired,
    )


def _indexed(value_us: Int64s, count: Int64s, printed: tuple[Ranked, ...]) -> tuple[Ranked, ...]:
    """The first values of the bins in the order given, each with the index at its place in the printed list."""
    values = np.repeat(value_us[:LISTED], np.minimum(count[:LISTED], LISTED))[:LISTED]
    indices = [entry.index for entry in printed[:LISTED]] + [None] * LISTED
    return tuple(Ranked(value_us=float(value), index=index) for value, index in zip(values, indices, strict=False))


def _figures(values: Int64s, counts: Int64s, resolution_ns: int, **rest: Any) -> Figures:
    """Figures of distinct values, rising, in units of `resolution_ns`; `rest` are the fields that are known already."""
    n = int(counts.sum())
    numbers: dict[str, Any] = dict.fromkeys(("min_us", "mean_us", "max_us", *PER_MILLE))
    if n:
        low, high = int(values[0]), int(values[-1])
        # Around the minimum, so that large values lose no digits in the sum.
        mean = low + float(np.dot((values - low).astype(np.float64), counts)) / n
        numbers = {"min_us": low, "mean_us": mean, "max_us": high}
        up_to = np.cumsum(counts)
        for name, per_mille in PER_MILLE.items():
            numbers[name] = int(values[np.searchsorted(up_to, -(-n * per_mille // 1000))])
        numbers = {name: value * resolution_ns / 1000 for name, value in numbers.items()}
    return Figures(n=n, resolution_ns=resolution_ns, **numbers, **rest)
