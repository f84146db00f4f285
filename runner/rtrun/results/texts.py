"""Texts of an observation, kept in an unnamed file until they are written: together they may be long."""

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from rtrun.results.columns import NoRoom, kept_in

# Some thousand traces; one may be as long as a trace that is copied from a target.
TEXT_BYTES_MAX = 256 * 1024 * 1024  #: text of all traces of an observation
ONE_TEXT_BYTES_MAX = 64 * 1024 * 1024  #: text of one of these traces
_PIECE_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class StoredText:
    """A text in a file, from one position to another."""

    file: IO[bytes] | None
    begin: int
    end: int

    def __bool__(self) -> bool:
        return self.end > self.begin

    def pieces(self) -> Iterator[bytes]:
        """The text in pieces. Raises OSError."""
        for at in range(self.begin, self.end, _PIECE_BYTES):
            assert self.file is not None
            self.file.seek(at)
            yield self.file.read(min(_PIECE_BYTES, self.end - at))


class TextStore:
    """Texts in a file in the folder; None: in the folder for temporary files."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._file: IO[bytes] | None = None
        self.end = 0
        """How many bytes all texts have."""
        self.is_full = False
        """Whether there is no more room."""

    def add(self, lines: Iterable[str]) -> StoredText:
        """Store a text; return an empty one if it is too long, or the disk or the store has no room for it."""
        begin = self.end
        if self.is_full:
            return StoredText(self._file, begin, begin)
        try:
            with kept_in(self._folder):
                self._file = self._file or tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115
                self._file.seek(begin)
                for line in lines:
                    # A text that is not kept counts too: making it took as long.
                    self.end += self._file.write(line.encode())
                    self.is_full = self.end > TEXT_BYTES_MAX
                    if self.is_full or self.end - begin > ONE_TEXT_BYTES_MAX:
                        return StoredText(self._file, begin, begin)
                self._file.flush()
        except NoRoom:
            self.is_full = True
            return StoredText(self._file, begin, begin)
        return StoredText(self._file, begin, self.end)
