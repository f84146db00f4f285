"""Texts of an observation that are kept until it is written, in a file without a name: together they may be long."""

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from rtrun.results.columns import NoRoom, kept_in

# Some thousand traces; one is as long as a trace that is copied from a target may be.
TEXT_BYTES_MAX = 256 * 1024 * 1024
ONE_TEXT_BYTES_MAX = 64 * 1024 * 1024
_PIECE_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class StoredText:
    """A text in a file, from one place to another."""

    file: IO[bytes] | None
    begin: int
    end: int

    def __bool__(self) -> bool:
        return self.end > self.begin

    def pieces(self) -> Iterator[bytes]:
        """The text, some of it at a time. Raises OSError."""
        for at in range(self.begin, self.end, _PIECE_BYTES):
            assert self.file is not None
            self.file.seek(at)
            yield self.file.read(min(_PIECE_BYTES, self.end - at))


class TextStore:
    """Texts in a file in the folder; None: where temporary files are."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._file: IO[bytes] | None = None
        self.end = 0
        """How many bytes all have."""
        self.is_full = False
        """Whether there is no room for more."""

    def add(self, lines: Iterable[str]) -> StoredText:
        """Store a text; an empty one where it is too long, or there is no room for it, on the disk or beside others."""
        begin = self.end
        if self.is_full:
            return StoredText(self._file, begin, begin)
        try:
            with kept_in(self._folder):
                self._file = self._file or tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115
                self._file.seek(begin)
                for line in lines:
                    # What is not kept takes its room, too: it took as long to be made.
                    self.end += self._file.write(line.encode())
                    self.is_full = self.end > TEXT_BYTES_MAX
                    if self.is_full or self.end - begin > ONE_TEXT_BYTES_MAX:
                        return StoredText(self._file, begin, begin)
                self._file.flush()
        except NoRoom:
            self.is_full = True
            return StoredText(self._file, begin, begin)
        return StoredText(self._file, begin, self.end)
