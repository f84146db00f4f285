"""The one reader of data from a file or a target: everything has a limit, and exceeding one is an error.

Wrong files and texts raise UsageError ``origin: what is wrong``; single numbers and words raise ValueError, so that the
caller adds the place. No input raises any other exception here.
"""

import json
import math
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from xml.parsers import expat

from rtfiles.errors import UsageError

MIB = 1 << 20
JSON_BYTES_MAX = 16 * MIB  #: a JSON text
# An empty list takes 3 bytes of JSON and 64 of memory: limiting the text does not limit the memory.
JSON_ITEMS_MAX = 500_000  #: values in a JSON text
JSON_DEPTH_MAX = 32  #: nesting of a JSON text
XML_DEPTH_MAX = 64  #: nesting of an XML text
LINE_CHARACTERS_MAX = 262_144  #: characters of a line of another program's text
# Python refuses only numbers above 4300 digits, and shorter ones still cost quadratic time.
DIGITS_MAX = 20  #: digits of a whole number
INT64_MAX = 2**63 - 1  # a range
_WHOLE_NUMBER = re.compile(rf"-?[0-9]{{1,{DIGITS_MAX}}}", re.ASCII)


@contextmanager
def _regular_file(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file. Raises UsageError, also within the context; refuses a pipe or a device, and never blocks."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as stream:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise UsageError(f"{path}: not a regular file")
            yield stream
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:  # a NUL in the path
        raise UsageError(f"{str(path)!r}: {error}") from error


def read_bytes(path: Path, *, max_bytes: int) -> bytes:
    """Return the content of a regular file. Raises UsageError; refuses a pipe or a device, and never blocks."""
    data = read_beginning(path, max_bytes=max_bytes + 1)
    if len(data) > max_bytes:
        raise UsageError(f"{path}: larger than {max_bytes} bytes")
    return data


def read_beginning(path: Path, *, max_bytes: int) -> bytes:
    """Return the first bytes of a regular file of any size. Raises UsageError as `read_bytes` does."""
    with _regular_file(path) as stream:
        return stream.read(max_bytes)


def read_end(path: Path, *, max_bytes: int) -> bytes:
    """Return the last bytes of a file of any size. Raises OSError."""
    with path.open("rb") as stream:
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - max_bytes))
        return stream.read(max_bytes)


def read_text(path: Path, *, max_bytes: int) -> str:
    """Return the content of a regular file of UTF-8 text. Raises UsageError."""
    try:
        return read_bytes(path, max_bytes=max_bytes).decode("utf-8")
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not UTF-8 text") from error


def lines_of(text: str, origin: str) -> Iterator[str]:
    """Yield the lines of a text without their ends. Raises UsageError for a line longer than any of ours.

    They come one at a time, because a list of short lines or words takes 20 times the memory of their text.
    """
    start, number = 0, 1
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        if end - start > LINE_CHARACTERS_MAX:
            raise UsageError(f"{origin}:{number}: a line of more than {LINE_CHARACTERS_MAX} characters")
        yield text[start:end].removesuffix("\r")
        start, number = end + 1, number + 1


def lines_in(path: Path) -> Iterator[bytes]:
    """Yield the lines of a regular file of any size, with their ends. Raises UsageError as `lines_of` does."""
    with _regular_file(path) as stream:
        number = 1
        while line := stream.readline(LINE_CHARACTERS_MAX + 2):
            if len(line) > LINE_CHARACTERS_MAX and len(line.rstrip(b"\r\n")) > LINE_CHARACTERS_MAX:
                raise UsageError(f"{path}:{number}: a line of more than {LINE_CHARACTERS_MAX} characters")
            yield line
            number += 1


def parse_json(text: str, origin: str, *, max_bytes: int = JSON_BYTES_MAX, max_items: int = JSON_ITEMS_MAX) -> Any:
    """Return the plain data in a JSON text: finite numbers, and texts that can be encoded. Raises UsageError."""
    # A character takes at least a byte.
    if len(text) > max_bytes:
        raise UsageError(f"{origin}: larger than {max_bytes} bytes")
    if text.count(",") + text.count("[") + text.count("{") > max_items:
        raise UsageError(f"{origin}: more than {max_items} values")
    try:
        data = json.loads(
            text,
            parse_int=whole_number,
            parse_float=real_number,
            parse_constant=real_number,
            object_pairs_hook=_members,
        )
        _check(data)
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else error
        raise UsageError(f"{origin}: not JSON that is read here: {reason}") from error
    return data


def _members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The members of a JSON object. Raises ValueError for a duplicate key: it is not known which value counts."""
    members: dict[str, Any] = {}
    for key, value in pairs:
        if key in members:
            raise ValueError(f"the key {key[:40]!r} stands twice")
        members[key] = value
    return members


def _check(data: Any) -> None:
    """Refuse plain data that cannot be written again: nested too deeply, or a text with a lone surrogate."""
    waiting: list[tuple[Any, int]] = [([data], 0)]
    while waiting:
        value, depth = waiting.pop()
        if depth > JSON_DEPTH_MAX:
            raise ValueError(f"nested more than {JSON_DEPTH_MAX} deep")
        for child in (*value, *value.values()) if isinstance(value, dict) else value:
            if isinstance(child, str):
                text(child)
            elif isinstance(child, dict | list):
                waiting.append((child, depth + 1))


@dataclass(frozen=True, kw_only=True, slots=True)
class XmlElement:
    """An XML element: the names of its ancestors and its own, its attributes, its own text, its line."""

    path: tuple[str, ...]
    attributes: Mapping[str, str]
    text: str
    line: int


@dataclass(kw_only=True, slots=True)
class _OpenElement:
    name: str
    attributes: Mapping[str, str]
    line: int
    text: list[str] = field(default_factory=list)


def parse_xml(text: str, origin: str, take: Callable[[XmlElement], None]) -> None:
    """Pass each element of an XML text to `take` when it ends, so that inner elements come first.

    Only the open elements are kept in memory. A document type is refused, and with it every custom entity. Raises
    UsageError, as `take` may.
    """
    start = 0
    while start < len(text):  # a tag holds no <, so this also limits its attributes
        end = text.find("<", start)
        end = len(text) if end < 0 else end
        if end - start > LINE_CHARACTERS_MAX:
            raise UsageError(f"{origin}: more than {LINE_CHARACTERS_MAX} characters without a <")
        start = end + 1
    parser = expat.ParserCreate()
    parser.buffer_text = True
    waiting: list[_OpenElement] = []

    def begin(name: str, attributes: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        if len(waiting) == XML_DEPTH_MAX:
            raise UsageError(f"{origin}:{line}: nested more than {XML_DEPTH_MAX} deep")
        waiting.append(_OpenElement(name=name, attributes=attributes, line=line))

    def finish(_: str) -> None:
        path = tuple(element.name for element in waiting)
        last = waiting.pop()
        take(XmlElement(path=path, attributes=last.attributes, text="".join(last.text).strip(), line=last.line))

    def refuse(*_: object) -> None:
        raise UsageError(f"{origin}:{parser.CurrentLineNumber}: a document type, which nothing that is read here has")

    parser.StartElementHandler, parser.EndElementHandler = begin, finish
    parser.CharacterDataHandler = lambda words: waiting[-1].text.append(words)
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise UsageError(f"{origin}:{error.lineno}: not XML: {expat.ErrorString(error.code)}") from error
    except ValueError as error:  # a lone surrogate
        raise UsageError(f"{origin}: not XML: {error}") from error


def text(word: str) -> str:
    """Return a text that can be encoded as UTF-8. Raises ValueError for a text with a lone surrogate."""
    try:
        word.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError("a text with half of a character (a lone surrogate)") from None
    return word


def whole_number(word: str, *, lowest: int = -INT64_MAX - 1, highest: int = INT64_MAX) -> int:
    """Return the number in a text of ASCII digits. Raises ValueError for any other text, and outside the limits."""
    if not _WHOLE_NUMBER.fullmatch(word):
        raise ValueError(f"expected a whole number of at most {DIGITS_MAX} digits, got {word[:40]!r}")
    number = int(word)
    if not lowest <= number <= highest:
        raise ValueError(f"expected a whole number from {lowest} to {highest}, got {number}")
    return number


def real_number(word: str, *, lowest: float = -math.inf, highest: float = math.inf) -> float:
    """Return the finite number in a text, as C and JSON write it. Raises ValueError, also outside the limits."""
    if not re.fullmatch(r"-?[0-9]{1,400}(\.[0-9]{1,400})?([eE][+-]?[0-9]{1,4})?", word, re.ASCII):
        raise ValueError(f"expected a number, got {word[:40]!r}")
    number = float(word)
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number, got {word[:40]!r}")
    if not lowest <= number <= highest:
        raise ValueError(f"expected a number from {lowest} to {highest}, got {word[:40]!r}")
    return number
