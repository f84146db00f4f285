"""Rows of numbers that grow for hours: the newest are in memory, the others in an unnamed file."""

import os
import tempfile
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO

import numpy as np

from rtrun.kinds.values import Int64s
from rtrun.results.columns import PIECE_ROWS, NoRoom, collected, kept_in

# An hour of 10000 messages a second with their callbacks takes 2.5 GiB.
BYTES_MAX = 8 * 2**30  #: the file of an observation's values; with more it ends
ROWS_MAX = 2**26  #: values of one stream of an observation; with more it ends
"""The rows of one stream: reading it takes a bit or a byte of memory for each row."""
IN_MEMORY_BYTES_MAX = 32 * 2**20  #: values that are not in that file yet
_EXTENTS_MAX = 2**21  #: parts of the file of an observation's values; with more it ends
_EXTENT_BYTES_LEAST = 512


class RowStore:
    """All rows of an observation. `folder` is where the file is; None: where temporary files are.

    The file is made when the first rows go there, and vanishes with the store.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self._tables: list[Rows] = []
        self._file: IO[bytes] | None = None
        self._end = self._extents = 0

    def rows(self, width: int = 1) -> "Rows":
        """New rows, each of `width` numbers."""
        table = Rows(self, width)
        self._tables.append(table)
        return table

    def ease(self) -> None:
        """Write rows to the file if too many are in memory.

        Raises NoRoom if there are more than may be kept, or if the disk refuses them; no row is lost.
        """
        if sum(len(rows.tail) for rows in self._tables) * 8 <= IN_MEMORY_BYTES_MAX:
            return
        for rows in self._tables:
            if len(rows.tail) * 8 >= _EXTENT_BYTES_LEAST:
                rows.spool(self._write(rows.tail))
                self._extents += 1
                if len(rows) > ROWS_MAX:
                    raise NoRoom(f"more than {ROWS_MAX} values of one stream")
        if self._end > BYTES_MAX or self._extents > _EXTENTS_MAX:
            raise NoRoom(f"more values than are kept of one observation: {self._end >> 20} MiB")

    def _write(self, values: "array[int]") -> int:
        """Write numbers to the file; return where they are in it."""
        with kept_in(self.folder):
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0, dir=self.folder)  # noqa: SIM115
            at, left = self._end, memoryview(values).cast("B")
            while left:
                written = os.pwrite(self._file.fileno(), left, at)
                at, left = at + written, left[written:]
        place, self._end = self._end, at
        return place

    def fill(self, into: Int64s, at: int) -> None:
        """Read numbers from the file, from a place on. Raises NoRoom if that fails."""
        assert self._file is not None
        left = into.data.cast("B")
        with kept_in(self.folder):
            while left:
                read = os.preadv(self._file.fileno(), [left], at)
                if not read:
                    raise OSError(0, "the file of its values is shorter than it was")
                at, left = at + read, left[read:]

    def put(self, at: int, value: int) -> None:
        """Change a number at a place of the file."""
        assert self._file is not None
        with kept_in(self.folder):
            os.pwrite(self._file.fileno(), array("q", [value]).tobytes(), at)


class Rows:
    """Rows of one thing, each of `width` numbers; `add` takes the numbers of one or several rows."""

    __slots__ = ("_offsets", "_spooled", "_starts", "_store", "add", "tail", "width")

    def __init__(self, store: RowStore, width: int) -> None:
        self._store = store
        self.width = width
        self.tail: array[int] = array("q")
        """What is in memory."""
        self.add: Callable[[Iterable[int]], None] = self.tail.extend
        self._spooled = 0
        # For each part in the file: its first row, and its place.
        self._starts: array[int] | None = None
        self._offsets: array[int] | None = None

    def __len__(self) -> int:
        return self._spooled + len(self.tail) // self.width

    def spool(self, place: int) -> None:
        """All rows in memory were written to the file at a place: drop them from memory."""
        if self._starts is None or self._offsets is None:
            self._starts, self._offsets = array("q"), array("q")
        self._starts.append(self._spooled)
        self._offsets.append(place)
        self._spooled = len(self)
        del self.tail[:]

    def _place(self, row: int) -> tuple[int, int]:
        """The place of a row in the file, and the first row after its part."""
        assert self._starts is not None and self._offsets is not None
        part = bisect_right(self._starts, row) - 1
        end = self._starts[part + 1] if part + 1 < len(self._starts) else self._spooled
        return self._offsets[part] + (row - self._starts[part]) * self.width * 8, end

    def put(self, row: int, column: int, value: int) -> None:
        """Change a number."""
        if row >= self._spooled:
            self.tail[(row - self._spooled) * self.width + column] = value
        else:
            self._store.put(self._place(row)[0] + 8 * column, value)

    def read(self, begin: int = 0, end: int | None = None) -> Int64s:
        """A copy of the rows from `begin` to before `end`; int64 of shape (n, width)."""
        end = len(self) if end is None else min(end, len(self))
        copied = np.empty((max(end - begin, 0), self.width), np.int64)
        row = begin
        while row < min(end, self._spooled):
            at, until = self._place(row)
            until = min(until, end)
            self._store.fill(copied[row - begin : until - begin].reshape(-1), at)
            row = until
        if row < end:
            words = self.tail[(row - self._spooled) * self.width : (end - self._spooled) * self.width]
            copied[row - begin :] = np.frombuffer(words, np.int64).reshape(-1, self.width)
        return copied

    def __getitem__(self, row: int) -> int:
        """The first number of a row."""
        row = row + len(self) if row < 0 else row
        return int(self.read(row, row + 1)[0, 0])

    def first_after(self, value: int) -> int:
        """The first row whose first number is higher; the rows must be in the order of these."""
        low, high = 0, len(self)
        while low < high:
            middle = (low + high) // 2
            low, high = (low, middle) if self[middle] > value else (middle + 1, high)
        return low

    def between(self, begin: int, end: int) -> Int64s:
        """The first numbers from `begin` to before `end`, int64 (n,); the rows must be in the order of these."""
        return self.read(self.first_after(begin - 1), self.first_after(end - 1))[:, 0]

    def pieces(self) -> Iterator[Int64s]:
        """All rows, some at a time; int64 of shape (n, width)."""
        for begin in range(0, len(self), PIECE_ROWS):
            yield self.read(begin, begin + PIECE_ROWS)

    def columns(self) -> tuple[Int64s, ...]:
        """All columns; int64 (n,). Raises NoRoom."""
        return collected(self._store.folder, (tuple(piece.T) for piece in self.pieces()), self.width)

    def in_order(self, column: int) -> Iterator[Int64s]:
        """All rows sorted by a column, some at a time; rows with the same number keep their order.

        A row waits in memory only while later rows may sort before it.
        """
        least = np.array([piece[:, column].min() for piece in self.pieces()], np.int64)
        later = np.append(np.minimum.accumulate(least[::-1])[::-1], np.iinfo(np.int64).max)
        waiting = np.empty((0, self.width), np.int64)
        for number, piece in enumerate(self.pieces()):
            waiting = np.concatenate((waiting, piece))
            waiting = waiting[np.argsort(waiting[:, column], kind="stable")]
            count = int(np.searchsorted(waiting[:, column], later[number + 1], side="right"))
            yield waiting[:count]
            waiting = waiting[count:]
