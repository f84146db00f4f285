"""The figures of one series: how many, how low, how high, and where.

A percentile is a value that occurred: the smallest one such that at least that share of all values is not above it
(the inverse of the empirical distribution function, definition 1 in Hyndman and Fan, "Sample Quantiles in Statistical
Packages", The American Statistician 50 (1996) 361-365). The 99.9th percentile of fewer than 1000 values thus is
their maximum.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

from rtrun.analysis.describe import LISTED, Description, Extreme, describe, describe_histogram
from rtrun.analysis.histogram import Histogram, Int64s

PERCENTILE_METHOD = "inverted_cdf"
PERCENT = {"p50_us": 50.0, "p90_us": 90.0, "p99_us": 99.0, "p999_us": 99.9}


@dataclass(frozen=True, kw_only=True, slots=True)
class Ranked:
    """A value and the index of its measurement; None when the source does not tell it."""

    value_us: float
    index: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Figures:
    """Figures of one series in microseconds. None and empty lists: n is 0, or nobody knows.

    `resolution_ns` is 1 for figures of samples and 1000 for figures of a log's bins. `top` falls from the highest,
    `lowest` rises from the lowest value; equal values stand in the order of their measurement.
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


def figures(values_ns: Int64s, index: Int64s | None = None, **lost: int) -> Figures:
    """Figures of the values of a series, shape (n,), nanoseconds.

    `index`, shape (n,), names the measurement of each value; without it a value's position does. `lost` are
    the counts of what is no value: `missing`, `out_of_order`, `duplicate`, `not_fired`.
    """
    return _figures(describe(values_ns, index), **lost)


def figures_of_histogram(
    histogram: Histogram, *, top: tuple[Ranked, ...] = (), lowest: tuple[Ranked, ...] = (), **lost: int
) -> Figures:
    """Figures of a histogram, as coarse as its bins; None where they lie in its overflow, which is only counted.

    `top` and `lowest` are the lists that a log prints, best first, of the same values; they lend their indices, and a
    value beyond the end of a list has none. `lost` as for `figures`.
    """
    said = describe_histogram(histogram)
    return _figures(replace(said, top=_indexed(said.top, top), lowest=_indexed(said.lowest, lowest)), **lost)


def _indexed(extremes: tuple[Extreme, ...], printed: tuple[Ranked, ...]) -> tuple[Extreme, ...]:
    """The extremes, each with the index at its place in the printed list."""
    indices = [entry.index for entry in printed] + [None] * LISTED
    return tuple(replace(extreme, index=index) for extreme, index in zip(extremes, indices, strict=False))


def _figures(
    said: Description, *, missing: int = 0, out_of_order: int = 0, duplicate: int = 0, not_fired: int = 0
) -> Figures:
    numbers = {"min_us": said.min_ns, "mean_us": said.mean_ns, "max_us": said.max_ns}
    numbers |= {name: said.percentiles_ns.get(percent) for name, percent in PERCENT.items()}

    def ranked(extremes: tuple[Extreme, ...]) -> tuple[Ranked, ...]:
        return tuple(Ranked(value_us=each.value_ns / 1000, index=each.index) for each in extremes)

    return Figures(
        n=said.n,
        **{name: None if value is None else value / 1000 for name, value in numbers.items()},
        top=ranked(said.top),
        lowest=ranked(said.lowest),
        missing=missing,
        out_of_order=out_of_order,
        duplicate=duplicate,
        not_fired=not_fired,
        resolution_ns=said.bin_ns,
    )
