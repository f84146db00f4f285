"""Columns of values that may be too large for memory: they are written and read in pieces."""

import contextlib
import mmap
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

import numpy as np

from rtfiles.errors import InfrastructureError
from rtrun.kinds.values import Int64s

PIECE_ROWS = 2**16
"""How many rows are in memory at a time."""


class NoRoom(InfrastructureError):
    """There are more values than may be kept, or the disk is full. The values before are kept."""


@contextlib.contextmanager
def kept_in(folder: Path | None) -> Iterator[None]:
    """Turn a system error about a file in `folder` into NoRoom."""
    try:
        yield
    except OSError as error:
        where = folder or tempfile.gettempdir()
        raise NoRoom(f"{where}: cannot keep what is observed: {error.strerror}") from error


def collected(folder: Path | None, pieces: Iterable[tuple[Int64s, ...]], count: int) -> tuple[Int64s, ...]:
    """Join pieces into `count` columns, each int64 (n,); long columns are kept in unnamed files in `folder`.

    Raises NoRoom where the disk is full.
    """
    files = [_ColumnFile(folder) for _ in range(count)]
    with kept_in(folder):
        for piece in pieces:
            for column, values in zip(files, piece, strict=True):
                column.add(values)
        return tuple(column.values() for column in files)


class _ColumnFile:
    """A column that is built from pieces."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._parts: list[Int64s] = []
        self._count = 0
        self._file: IO[bytes] | None = None

    def add(self, values: Int64s) -> None:
        self._parts.append(values)
        self._count += values.size
        if self._count > PIECE_ROWS:
            self._file = self._file or tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115
            for part in self._parts:
                self._file.write(np.ascontiguousarray(part).data)
            self._parts.clear()

    def values(self) -> Int64s:
        if self._file is None:
            return np.concatenate([np.empty(0, np.int64), *self._parts])
        with self._file:
            self._file.flush()
            return np.memmap(self._file, np.int64, mode="r", shape=(self._count,))


def pieces(*columns: Int64s) -> Iterator[tuple[Int64s, ...]]:
    """Yield columns of equal length piece by piece; pieces of mapped columns do not stay in memory."""
    for begin in range(0, columns[0].size, PIECE_ROWS):
        yield tuple(column[begin : begin + PIECE_ROWS] for column in columns)
        for column in columns:
            if isinstance(mapped := getattr(column, "_mmap", None), mmap.mmap):
                mapped.madvise(mmap.MADV_DONTNEED)
