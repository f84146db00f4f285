"""``<output>.histogram.json``: counts that another program measured, and what its format left out."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rtfiles.config import Config, read_json
from rtfiles.errors import UsageError
from rtfiles.untrusted import MIB
from rtrun.analysis.histogram import Histogram
from rtrun.results.importers.counts import MAX_BINS, check_bins

ENDING = ".histogram.json"
MAX_BYTES = 64 * MIB
_LIMIT_NS = 1 << 61

Natural = Annotated[int, Field(ge=0)]


class _File(Config):
    schema_number: Literal[1] = Field(alias="schema")
    source: str
    bin_ns: Annotated[int, Field(ge=1)]
    values_ns: list[int]
    counts: list[Annotated[int, Field(ge=1)]]
    overflow: Natural
    overflow_from_ns: int | None
    max_ns: int | None
    mean_ns: float | None = None
    period_ns: float | None
    left_out: list[str]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Imported:
    """One thread's histogram; ``name`` tells the threads of one file apart.

    ``left_out`` says, a sentence each, what the format does not tell; ``parameters`` are those it does.
    """

    source: str
    name: str
    histogram: Histogram
    period_ns: float | None
    left_out: tuple[str, ...]
    parameters: dict[str, str | int | None]


def histogram_text(imported: Imported) -> str:
    """The file's text; the same histogram gives the same bytes."""
    bins = imported.histogram
    data = {
        "schema": 1,
        "source": imported.source,
        "bin_ns": bins.bin_ns,
        "values_ns": bins.values_ns.tolist(),
        "counts": bins.counts.tolist(),
        "overflow": bins.overflow,
        "overflow_from_ns": bins.overflow_from_ns,
        "max_ns": bins.max_ns,
        "mean_ns": bins.mean_ns,
        "period_ns": imported.period_ns,
        "left_out": list(imported.left_out),
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def read_histogram(path: Path) -> Imported:
    """Read it back. Raises UsageError that names the file and what is wrong in it."""
    file = read_json(path, _File, max_bytes=MAX_BYTES, max_items=2 * MAX_BINS + 1000)
    check_bins(path, len(file.values_ns))
    if len(file.values_ns) != len(file.counts):
        raise UsageError(f"{path}: {len(file.values_ns)} values_ns, but {len(file.counts)} counts")
    if any(not -_LIMIT_NS < value < _LIMIT_NS for value in (*file.values_ns, *file.counts)):
        raise UsageError(f"{path}: a number beyond {_LIMIT_NS} cannot be")
    values = np.array(file.values_ns, dtype=np.int64)
    if values.size and (np.diff(values) < file.bin_ns).any():
        raise UsageError(f"{path}: values_ns: must rise by at least bin_ns, {file.bin_ns}")
    return Imported(
        source=file.source,
        name=path.name.removesuffix(ENDING),
        histogram=Histogram(
            values_ns=values,
            counts=np.array(file.counts, dtype=np.int64),
            bin_ns=file.bin_ns,
            overflow=file.overflow,
            overflow_from_ns=file.overflow_from_ns,
            max_ns=file.max_ns,
            mean_ns=file.mean_ns,
        ),
        period_ns=file.period_ns,
        left_out=tuple(file.left_out),
        parameters={},
    )
