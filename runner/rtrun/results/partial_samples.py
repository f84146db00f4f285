"""What a suite that was cut off left of its samples: ``<output>.npy.part`` (see docs/formats.md) made readable."""

import re
from pathlib import Path

import numpy as np

ENDING = ".npy.part"
_HEADER = re.compile(rb"\{'descr': '<i8', 'fortran_order': False, 'shape': \(([0-9]{1,12}), ([0-9]{1,2})\), \} *\n")


def salvage(part: Path) -> int | None:
    """Turn a part into ``<output>.npy`` beside it with every row that is whole; return their number.

    None, and nothing changed, when it is no part or the samples are there already. There is no json: what was measured
    is kept, and no reader of results takes it for a result.
    """
    npy = part.with_suffix("")
    with part.open("rb") as stream:
        lead = stream.read(10)
        start = 10 + int.from_bytes(lead[8:], "little")
        found = _HEADER.fullmatch(stream.read(start - 10)) if lead[:8] == b"\x93NUMPY\x01\x00" else None
    if npy.exists() or not found or int(found[2]) == 0:
        return None
    columns = int(found[2])
    count = min(int(found[1]), (part.stat().st_size - start) // (8 * columns))
    rows = np.zeros((0, columns), dtype="<i8")
    if count > 0:
        rows = np.memmap(part, dtype="<i8", mode="r", offset=start, shape=(count, columns))
        # After a power cut a file may be longer than what was written to it. No row of a suite is all zeros.
        filled = np.flatnonzero(rows.any(axis=1))
        rows = rows[: int(filled[-1]) + 1 if filled.size else 0]
    np.save(npy, rows)
    part.unlink()
    return len(rows)
