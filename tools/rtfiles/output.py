"""The one writer for everything that the programs print.

Printed text may come from a target, so it must not send commands to the terminal or add lines: `printable` removes such
characters. The reader may go away, and the disk may be full. `surviving_output` lets the program continue without
output, so that a campaign keeps measuring and the exit status stays that of the answer.
"""

import codecs
import contextlib
import io
import os
import shutil
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

from rtfiles.quantities import grouped

if TYPE_CHECKING:
    from rich.console import Console

T = TypeVar("T")
PLAIN_WIDTH = 100  # columns of a table, where the output is not a terminal
WIDTH_MAX = 1000  # columns of a terminal
_quiet = False
_PLAIN = "rtfiles.plain"
_CLOSEST = {"─": "-", "━": "-", "→": "->", "≤": "<=", "≥": ">=", "…": "...", "·": ".", "×": "x", "µ": "u", "±": "+-"}
_CLOSEST["°"] = ""  # of °C


def printable(text: str) -> str:
    """One line of text, with a question mark for every control character and line break."""
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() or character == "\t" else "?" for character in text)


def shortened(text: str, width: int) -> str:
    """The beginning of a text that is wider, with dots where it is cut."""
    return text if len(text) <= width else f"{text[: max(0, width - 3)]}..."


def counted(number: int, noun: str) -> str:
    """A number and its noun, with an s unless the number is 1."""
    return f"{grouped(number)} {noun}{'' if number == 1 else 's'}"


def listed(names: Collection[str], most: int) -> str:
    """Names separated by commas; if there are more than `most`, the first ones and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join([*names][:most]) + more


def print_line(text: str = "") -> None:
    """Print one line of the answer to standard output."""
    print(printable(text), flush=True)


def print_text(text: str) -> None:
    """Print text of several lines, such as a file or JSON, to standard output."""
    print("\n".join(printable(line) for line in text.removesuffix("\n").split("\n")), flush=True)


def print_json(data: Any) -> None:
    """Print plain data for programs. Raises ValueError for a number that JSON cannot represent."""
    import json

    print_text(json.dumps(data, indent=1, allow_nan=False))


def print_bytes(content: bytes) -> None:
    """Print a file unchanged to standard output, for a program to read."""
    sys.stdout.flush()
    sys.stdout.buffer.write(content)
    sys.stdout.buffer.flush()


def print_note(text: str) -> None:
    """Print a remark about the answer, one line, to standard error; nothing within `quietly`."""
    if not _quiet:
        print_error(text)


def print_error(text: str) -> None:
    """Print one line about an error to standard error."""
    print(printable(text), file=sys.stderr, flush=True)


@contextlib.contextmanager
def quietly(asked: bool = True) -> Iterator[None]:
    """Within the context, print only the answer and errors, no remarks or progress; with `asked=False`, everything."""
    global _quiet
    before, _quiet = _quiet, asked
    try:
        yield
    finally:
        _quiet = before


@contextlib.contextmanager
def beside_the_answer(asked: bool = True) -> Iterator[None]:
    """Within the context, print everything to standard error, because a program reads standard output."""
    with contextlib.redirect_stdout(sys.stderr) if asked else contextlib.nullcontext():
        yield


@contextlib.contextmanager
def noting_duration(what: str) -> Iterator[None]:
    """Print how long the body took, unless it fails."""
    start = time.monotonic()
    yield
    print_note(f"{what}: {time.monotonic() - start:.0f} s")


def shows_status() -> bool:
    """Whether `print_status` shows anything: on a terminal, except within `quietly`."""
    return sys.stderr.isatty() and not _quiet


def print_status(text: str) -> None:
    """Show a line that the next one overwrites, only on a terminal; an empty text removes the line."""
    if shows_status():
        # A line that wraps would not be overwritten.
        line = shortened(printable(text), screen_width() - 1)
        print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)


def showing_progress(items: Sequence[T], doing: str) -> Iterator[T]:
    """Yield each item, and show the progress on a terminal; the line disappears after the last item."""
    try:
        for number, item in enumerate(items, start=1):
            print_status(f"{doing} {number} of {len(items)}")
            yield item
    finally:
        print_status("")


def screen_width() -> int:
    """How many columns a line has: COLUMNS, or else what the terminal has, or PLAIN_WIDTH without a terminal."""
    return min(shutil.get_terminal_size((PLAIN_WIDTH, 0)).columns, WIDTH_MAX)


def console() -> "Console":
    """A console for tables and bars, as wide as the screen; plain text without a terminal.

    Lines of text are not broken, not even those that are printed above a bar, so that what they name can be copied.
    It prints text unchanged: text that may come from a target must go through `printable` first.
    """
    from rich.console import Console

    return Console(highlight=False, markup=False, emoji=False, soft_wrap=True, width=screen_width())


@dataclass(kw_only=True, slots=True)
class Losses:
    """The first error in writing standard output or standard error, None if there was none."""

    stdout: OSError | None = None
    stderr: OSError | None = None


class _Survivor(io.RawIOBase):
    """A stream that drops all output after the first failure, and remembers that failure."""

    def __init__(self, stream: Any, losses: Losses, name: str) -> None:
        self._stream, self._losses, self._name = stream, losses, name

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return bool(self._stream.isatty())

    def fileno(self) -> int:
        return int(self._stream.fileno())

    def write(self, data: Any) -> int:
        if getattr(self._losses, self._name) is None:
            try:
                self._stream.write(data)
                self._stream.flush()
            except OSError as error:
                setattr(self._losses, self._name, error)
                # The rest of the buffer goes nowhere; otherwise Python fails on it at exit, with its own status.
                with open(os.devnull, "wb") as nowhere:  # noqa: PTH123
                    os.dup2(nowhere.fileno(), self._stream.fileno())
        return len(data)


@contextlib.contextmanager
def surviving_output() -> Iterator[Losses]:
    """Let no failure of standard output or standard error end the program; yields the failures."""
    # If a file or connection of ours got the number of a closed stream, C code would print into it.
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    losses = Losses()
    original = sys.stdout, sys.stderr
    sys.stdout = _wrapped(sys.stdout, losses, "stdout")
    sys.stderr = _wrapped(sys.stderr, losses, "stderr")
    try:
        yield losses
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = original


def _wrapped(stream: TextIO | None, losses: Losses, name: str) -> TextIO:
    # Python has None for a stream that was closed when the program began.
    inner = stream.buffer if stream else io.BytesIO()
    encoding = stream.encoding if stream else "utf-8"
    return io.TextIOWrapper(
        io.BufferedWriter(_Survivor(inner, losses, name)), encoding, errors=_PLAIN, line_buffering=True
    )


def _in_plain(error: UnicodeError) -> tuple[str, int]:
    """What is printed for characters that the terminal's encoding lacks: the closest of ASCII, or a question mark."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(_CLOSEST.get(character, "?") for character in lacking), error.end


codecs.register_error(_PLAIN, _in_plain)
