"""``<output>.histogram.json``: counts that another program measured, and what its format left out."""

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from rtfiles.config import Config, parse, read_json
from rtfiles.untrusted import MIB
from rtrun.analysis.histogram import Histogram
from rtrun.kinds.limits import COUNT_MAX, TIME_MAX_NS, Count, MeanNs, PeriodNs, TimeNs
from rtrun.results.importers.counts import MAX_BINS
from rtrun.results.importers.origin import NOWHERE, FileOrigin

ENDING = ".histogram.json"
MAX_BYTES = 64 * MIB  #: a histogram of an imported file


class _File(Config):
    schema_number: Literal[1] = Field(alias="schema")
    source: str
    bin_ns: Annotated[int, Field(ge=1, le=TIME_MAX_NS)]
    values_ns: Annotated[list[TimeNs], Field(max_length=MAX_BINS)]
    counts: list[Annotated[int, Field(ge=1, le=COUNT_MAX)]]
    overflow: Count
    overflow_from_ns: TimeNs | None
    max_ns: TimeNs | None
    mean_ns: MeanNs | None = None
    period_ns: PeriodNs | None
    left_out: list[str]
    undecidable: str = ""

    @model_validator(mode="after")
    def _belong_together(self) -> "_File":
        if len(self.values_ns) != len(self.counts):
            raise ValueError(f"{len(self.values_ns)} values_ns, but {len(self.counts)} counts")
        if any(after - before < self.bin_ns for before, after in pairwise(self.values_ns)):
            raise ValueError(f"values_ns: must rise by at least bin_ns, {self.bin_ns}")
        if sum(self.counts) + self.overflow > COUNT_MAX:
            raise ValueError(f"counts: more than {COUNT_MAX} measurements")
        return self


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Imported:
    """One thread's histogram; ``name`` distinguishes the threads of a file.

    ``left_out`` has a sentence for each thing that the format does not state; ``parameters`` are only those that it
    states. ``unit_ns`` is the unit of the file's numbers; None: its format defines it. ``undecidable`` is the reason
    why no answer can rest on the values, "" where one can.
    """

    source: str
    name: str
    histogram: Histogram
    period_ns: float | None
    left_out: tuple[str, ...]
    parameters: dict[str, str | int | None]
    unit_ns: int | None = None
    origin: FileOrigin = NOWHERE
    undecidable: str = ""


def histogram_text(imported: Imported) -> str:
    """The text of the file; the same histogram gives the same bytes. Raises UsageError if it could not be read back."""
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
        **({"undecidable": imported.undecidable} if imported.undecidable else {}),
    }
    parse(data, _File, imported.name)
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def read_histogram(path: Path) -> Imported:
    """Read such a file. Raises UsageError that names the file and what is wrong in it."""
    file = read_json(path, _File, max_bytes=MAX_BYTES, max_items=2 * MAX_BINS + 1000)
    return Imported(
        source=file.source,
        name=path.name.removesuffix(ENDING),
        histogram=Histogram(
            values_ns=np.array(file.values_ns, dtype=np.int64),
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
        undecidable=file.undecidable,
    )
