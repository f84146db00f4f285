"""The quantities of a series: the words that tables have for them, their names in files, and where they are found.

A time is called min, mean, std, max or, as a percentile, p99.9. Tables write it with its unit; files have it in
microseconds, as min_us.
"""

import dataclasses
import math
from typing import Any

from rtrun.analysis.figures import PERCENTILES, Figures
from rtrun.results.series import Header

LOST = {"missing": "missing", "out_of_order": "out of order", "duplicate": "again", "not_fired": "not fired"}
"""What is in no figure: the words of tables, by the names of files."""


def identity(header: Header) -> dict[str, Any]:
    """What a series is of, by the names of files."""
    return {name: getattr(header, name) for name in ("suite", "output", "series", "parameters")}


def times_ns(figures: Figures) -> dict[str, float | None]:
    """Every time of a series by its word, in the order of files; None where it is not known."""
    percentiles_ns = {f"p{percent:g}": figures.percentiles_ns.get(percent) for percent in PERCENTILES}
    ends_ns = {"min": figures.min_ns, "mean": figures.mean_ns, "std": figures.std_ns}
    return {**ends_ns, **percentiles_ns, "max": figures.max_ns}


def lost(header: Header) -> dict[str, int]:
    """How many measurements are in no figure, by the names of files."""
    return {name: getattr(header, name) for name in LOST}


def us(value_ns: float | None) -> float | None:
    """A time in the unit of files."""
    return None if value_ns is None else value_ns / 1000


def as_data(value: Any) -> Any:
    """A value as JSON takes it: numbers that are not finite are null, and percentiles are called by their words."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: as_data(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {f"p{key:g}" if isinstance(key, float) else str(key): as_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_data(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
