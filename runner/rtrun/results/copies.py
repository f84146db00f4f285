"""Runs that are copies of one another: the same measurements must not count twice."""

from collections.abc import Mapping
from pathlib import Path

from rtrun.results.npy import EMPTY_BYTES
from rtrun.results.record import RunRecord


def find_copies(records: Mapping[Path, RunRecord]) -> dict[Path, str]:
    """Which of these run directories hold what another one holds: each with a line that names both.

    They have the same attempt, or the same samples, of which two measurements never make the same. Samples without a
    measurement are alike in all runs, and so may histograms be.
    """
    holders: dict[tuple[str, str], list[Path]] = {}
    for folder, record in records.items():
        marks = [("attempt", record.attempt)] if record.attempt else []
        marks += [
            ("samples", file.sha256)
            for name, file in record.files.items()
            if name.endswith(".npy") and file.size_bytes > EMPTY_BYTES
        ]
        for mark in dict.fromkeys(marks):
            holders.setdefault(mark, []).append(folder)
    copies: dict[Path, str] = {}
    for (what, _), folders in holders.items():
        for folder in folders if len(folders) > 1 else []:
            other = next(each for each in folders if each != folder)
            alike = "are of the same attempt" if what == "attempt" else "hold the same samples"
            copies.setdefault(
                folder, f"{folder.name}: a copy? it and {other.name} {alike}, and neither counts: remove the copy"
            )
    return copies
