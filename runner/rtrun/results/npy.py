"""The header of an npy in NumPy format 1.0, read without numpy: its own reader evaluates the header as Python."""

import re
from dataclasses import dataclass
from typing import BinaryIO

# An npy without a row is its header: of a few columns this size, as the format rounds it up to 64 bytes.
EMPTY_BYTES = 128
_LEAD = b"\x93NUMPY\x01\x00"
_HEADER = re.compile(
    r"\{\s*'descr':\s*'(?P<dtype>[^'\\]{1,40})',\s*'fortran_order':\s*(?P<fortran>True|False),"
    r"\s*'shape':\s*\((?P<shape>(?:[0-9]{1,18}, ?)*[0-9]{0,18})\),?\s*\}\s*",
    re.ASCII,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class NpyHeader:
    """What the header announces; the data begin at `start_bytes`."""

    dtype: str
    fortran_order: bool
    shape: tuple[int, ...]
    start_bytes: int


def read_header(stream: BinaryIO) -> NpyHeader:
    """Read the header from the beginning of a file. Raises ValueError that says what is wrong with it."""
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
