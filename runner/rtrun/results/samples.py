"""Reader of a suite's samples: ``<output>.npy`` with the ``<output>.json`` next to it.

Both are untrusted: their sizes are limited, the npy is never unpickled, and rows and counts must agree.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from rtfiles.config import read_json
from rtfiles.errors import UsageError
from rtrun.kinds.known import called
from rtrun.kinds.lateness import Measure
from rtrun.kinds.values import IndexedValues, Int64s
from rtrun.plan.suites import described_suites, kind_of, suite
from rtrun.results.output import Record

MAX_NPY_BYTES = 4 << 30  #: a file of samples that is read
# An npy without rows is only its header: this size for a few columns, as the format rounds it up to 64 bytes.
EMPTY_BYTES = 128
_LEAD = b"\x93NUMPY\x01\x00"
_HEADER = re.compile(
    r"\{\s*'descr':\s*'(?P<dtype>[^'\\]{1,40})',\s*'fortran_order':\s*(?P<fortran>True|False),"
    r"\s*'shape':\s*\((?P<shape>(?:[0-9]{1,18}, ?)*[0-9]{0,18})\),?\s*\}\s*",
    re.ASCII,
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """The samples of one run of a program.

    `series` are measured, reported, difference, measured_2014 and difference_2014 (one-shot), lateness, jitter and grid
    (cyclic), or latency (communication, ordered by sequence number); the first is the main one of the suite. `columns`,
    each of shape (rows,), are mapped from the file, in the order of suites.yml.
    """

    path: Path
    record: Record
    columns: dict[str, Int64s]
    series: dict[str, IndexedValues]

    def judged(self, asked: Measure | None) -> IndexedValues:
        """The series that a question is about. Raises UsageError when the suite does not measure it."""
        try:
            measure = suite(self.record.suite).judged(asked)
        except UsageError as error:
            raise UsageError(f"{self.path}: {self.record.suite} {error}") from None
        return next(values for name, values in self.series.items() if called(name) == measure)


def read_samples(path: Path, record: Record | None = None) -> Samples:
    """Read an output by its json or its npy; the other file must be next to it. `record` is the json, if already read.

    Raises UsageError that names the file, or both files where they disagree.
    """
    json_path, npy_path = path.with_suffix(".json"), path.with_suffix(".npy")
    record = record or read_json(json_path, Record)
    kind = kind_of(record.suite)
    if kind is None:
        raise UsageError(f"{json_path}: suite: unknown suite {record.suite!r}, known: {', '.join(described_suites())}")
    counts = record.counts
    if counts.known > counts.asked:
        raise UsageError(
            f"{json_path}: counts: {counts.asked} asked for, but {counts.known} measured + not fired + missing"
        )
    names = suite(record.suite).columns
    if record.columns != [*names]:
        raise UsageError(f"{json_path}: columns: {', '.join(record.columns)}, must be {', '.join(names)}")
    rows = read_rows(npy_path, names)
    columns = {name: rows[:, place] for place, name in enumerate(names)}
    series = kind.series(columns, record.stated, npy_path)
    return Samples(path=npy_path, record=record, columns=columns, series=series)


def read_rows(path: Path, names: Sequence[str]) -> Int64s:
    """Map the rows, shape (rows, columns), of an npy with these columns. Raises UsageError."""
    if path.exists() and not path.is_file():
        raise UsageError(f"{path}: not a regular file")
    try:
        size = path.stat().st_size
        if size > MAX_NPY_BYTES:
            raise UsageError(f"{path}: {size} bytes, samples have at most {MAX_NPY_BYTES}")
        with path.open("rb") as stream:
            header = read_header(stream)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(f"{path}: {error}") from error
    shape = header.shape
    if header.dtype != "<i8":
        raise UsageError(f"{path}: values of type {header.dtype}, must be <i8 (int64)")
    if len(shape) != 2 or shape[1] != len(names):
        raise UsageError(f"{path}: shape {shape}, must be (rows, {len(names)}) of {', '.join(names)}")
    if header.fortran_order:
        raise UsageError(f"{path}: in Fortran order, must be in C order")
    rows, expected = shape[0], header.start_bytes + 8 * shape[0] * shape[1]
    if size != expected:
        raise UsageError(f"{path}: {size} bytes, {rows} rows take {expected}: cut off or not of one piece")
    if rows == 0:
        return np.empty(shape, dtype=np.int64)
    return np.memmap(path, dtype="<i8", mode="r", offset=header.start_bytes, shape=shape)


@dataclass(frozen=True, kw_only=True, slots=True)
class NpyHeader:
    """What the header states; the data begin at `start_bytes`."""

    dtype: str
    fortran_order: bool
    shape: tuple[int, ...]
    start_bytes: int


def read_header(stream: BinaryIO) -> NpyHeader:
    """Read the header of an npy in NumPy format 1.0 from the beginning of a file, without running it as Python.

    Raises ValueError that states what is wrong with it.
    """
    lead = stream.read(10)
    if lead[:8] != _LEAD:
        raise ValueError("not in NumPy format 1.0, whose first bytes are \\x93NUMPY\\x01\\x00")
    start = 10 + int.from_bytes(lead[8:], "little")
    text = stream.read(start - 10).decode("latin-1")
    match = _HEADER.fullmatch(text)
    if not match:
        raise ValueError(f"its header is not that of one plain array: {text[:80]!r}")
    return NpyHeader(
        dtype=match["dtype"],
        fortran_order=match["fortran"] == "True",
        shape=tuple(int(number) for number in match["shape"].split(",") if number.strip()),
        start_bytes=start,
    )
