"""What all the histogram formats share: counts of bins checked, plain JSON read with limits."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rtfiles.errors import UsageError
from rtrun.analysis.histogram import Histogram

NO_ORDER = "the order of the measurements: bursts and trends cannot be seen"
_LIMIT = 1 << 53


def load(path: Path, text: str) -> dict[str, Any]:
    """The JSON object in a text. Raises UsageError naming the file."""
    try:
        data = json.loads(text, parse_constant=lambda name: _refuse(name))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: not JSON: {error}") from error
    if not isinstance(data, dict):
        raise UsageError(f"{path}: expected a JSON object")
    return data


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is no number")


def whole(path: Path, where: str, value: object) -> int:
    """A whole number from 0 on. Raises UsageError naming file and place."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _LIMIT:
        raise UsageError(f"{path}: {where}: expected a whole number from 0 on, got {str(value)[:40]!r}")
    return value


def bins_of(path: Path, where: str, data: object) -> dict[int, int]:
    """Bins from a JSON mapping of value to count."""
    if not isinstance(data, dict):
        raise UsageError(f"{path}: {where}: expected a mapping of value to count")
    found: dict[int, int] = {}
    for key, count in data.items():
        if not (key.isascii() and key.isdigit() and len(key) <= 15):
            raise UsageError(f"{path}: {where}: {key[:40]!r} is no bin")
        found[int(key)] = whole(path, f"{where}.{key}", count)
    return found


def histogram(
    bins: Mapping[int, int], *, unit_ns: int, width: int, overflow: int, overflow_from: int, max_value: int | None
) -> Histogram:
    """A histogram from bins in units of `unit_ns`, each `width` units wide."""
    filled = sorted((value, count) for value, count in bins.items() if count)
    return Histogram(
        values_ns=np.array([value * unit_ns for value, _ in filled], dtype=np.int64),
        counts=np.array([count for _, count in filled], dtype=np.int64),
        bin_ns=unit_ns * width,
        overflow=overflow,
        overflow_from_ns=overflow_from * unit_ns if overflow else None,
        max_ns=None if max_value is None else max_value * unit_ns,
    )
