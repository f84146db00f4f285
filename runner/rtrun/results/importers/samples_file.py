"""``<output>.samples.npy`` and ``.json``: another program's values in order, and what its format left out."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from rtfiles import atomic
from rtfiles.config import Config, parse, read_json
from rtfiles.errors import UsageError
from rtrun.kinds.limits import TIME_MAX_NS, PeriodNs
from rtrun.kinds.values import Int64s
from rtrun.results.importers.origin import NOWHERE, FileOrigin
from rtrun.results.samples import read_rows

ENDING = ".samples.json"
ROWS_ENDING = ".samples.npy"
_COLUMN = "latency_ns"


class _SamplesFile(Config):
    schema_number: Literal[1] = Field(alias="schema")
    source: str
    period_ns: PeriodNs | None
    left_out: list[str]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ImportedSamples:
    """One thread's values in order, shape (n,), int64; the other fields are those of `Imported`."""

    source: str
    name: str
    values_ns: Int64s
    period_ns: float | None
    left_out: tuple[str, ...]
    parameters: dict[str, str | int | None]
    unit_ns: int | None = None
    origin: FileOrigin = NOWHERE


def write_samples(folder: Path, imported: ImportedSamples) -> None:
    """Write both files; the same samples give the same bytes. Raises UsageError if they could not be read back."""
    data = {
        "schema": 1,
        "source": imported.source,
        "period_ns": imported.period_ns,
        "left_out": list(imported.left_out),
    }
    parse(data, _SamplesFile, imported.name)
    np.save(folder / f"{imported.name}{ROWS_ENDING}", imported.values_ns[:, np.newaxis], allow_pickle=False)
    atomic.write_text(folder / f"{imported.name}{ENDING}", json.dumps(data, indent=1, allow_nan=False) + "\n")


def read_imported_samples(path: Path) -> ImportedSamples:
    """Read the files by their json, mapping the values. Raises UsageError that names the file and what is wrong."""
    file = read_json(path, _SamplesFile)
    name = path.name.removesuffix(ENDING)
    rows_path = path.with_name(f"{name}{ROWS_ENDING}")
    values = read_rows(rows_path, [_COLUMN])[:, 0]
    if values.size and not -TIME_MAX_NS <= int(values.min()) <= int(values.max()) <= TIME_MAX_NS:
        raise UsageError(f"{rows_path}: a value beyond {TIME_MAX_NS} ns")
    return ImportedSamples(
        source=file.source,
        name=name,
        values_ns=values,
        period_ns=file.period_ns,
        left_out=tuple(file.left_out),
        parameters={},
    )
