"""Samples of a suite that was cut off: makes ``<output>.npy.part`` (see docs/formats.md) readable."""

from pathlib import Path

import numpy as np

from rtrun.results.samples import read_header

ENDING = ".npy.part"
MAX_COLUMNS = 99  #: columns of samples that were cut off


def salvage(part: Path) -> int | None:
    """Turn a part into ``<output>.npy`` next to it, with every complete row; return the number of rows.

    Returns None, and changes nothing, when the file is not a part or the samples are there already. No json is written:
    the measured values are kept, but no reader takes them for a result.
    """
    npy = part.with_suffix("")
    try:
        with part.open("rb") as stream:
            header = read_header(stream)
    except ValueError:
        return None
    plain = header.dtype == "<i8" and not header.fortran_order and len(header.shape) == 2
    if npy.exists() or not plain or not 0 < header.shape[1] <= MAX_COLUMNS:
        return None
    announced, columns = header.shape
    start = header.start_bytes
    count = min(announced, (part.stat().st_size - start) // (8 * columns))
    rows = np.zeros((0, columns), dtype="<i8")
    if count > 0:
        rows = np.memmap(part, dtype="<i8", mode="r", offset=start, shape=(count, columns))
        # After a power cut a file may be longer than what was written to it. No row of a suite is all zeros.
        filled = np.flatnonzero(rows.any(axis=1))
        rows = rows[: int(filled[-1]) + 1 if filled.size else 0]
    np.save(npy, rows)
    part.unlink()
    return len(rows)
