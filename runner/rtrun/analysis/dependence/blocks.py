"""One run cut into blocks of consecutive measurements: the units in which dependent data are resampled."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtrun.analysis.histogram import Histogram, from_samples
from rtrun.kinds.values import Int64s

BLOCKS = 64
_COLUMNS = 4096
_FINE_NS = 200
_SEED = 20140715


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """Counts of bins in each block of a run: ``counts`` (b, m) for bins from ``values_ns`` (m,), ascending.

    ``sums_ns`` (b,) are the sums of each block. ``ordered`` is False where a histogram was split at random, as if its
    measurements were independent. Bins are ``bin_ns`` wide; beyond a few thousand bins, ``values_ns`` are coarser.
    ``boot`` and ``start_time`` of the run are "" where they are not known.
    """

    values_ns: Int64s
    counts: Int64s
    sums_ns: NDArray[np.float64]
    bin_ns: int = 1000
    ordered: bool = True
    boot: str = ""
    start_time: str = ""

    @property
    def n(self) -> int:
        """Measurements in all blocks."""
        return int(self.counts.sum())

    @property
    def length(self) -> float:
        """Measurements per block."""
        return self.n / max(1, len(self.sums_ns))


def cut(values_ns: Int64s, blocks: int = BLOCKS) -> Blocks:
    """Cut int64 samples, shape (n,), into at most so many blocks of equal length; the last takes the rest."""
    whole = from_samples(values_ns, _FINE_NS)
    if whole.values_ns.size > _COLUMNS:
        whole = from_samples(values_ns)
    columns = _columns(whole)
    n = values_ns.size
    blocks = max(1, min(blocks, n))
    starts = np.arange(blocks) * (n // blocks)
    counts = np.zeros((blocks, columns.size), np.int64)
    sums = np.zeros(blocks)
    for row, (start, stop) in enumerate(zip(starts, [*starts[1:], n], strict=True)):
        part = values_ns[start:stop]
        bins = from_samples(part, whole.bin_ns)
        np.add.at(counts[row], np.searchsorted(columns, bins.values_ns, side="right") - 1, bins.counts)
        sums[row] = float(part.sum(dtype=np.float64))
    return Blocks(values_ns=columns, counts=counts, sums_ns=sums, bin_ns=whole.bin_ns)


def split_randomly(histogram: Histogram, blocks: int = BLOCKS) -> Blocks:
    """Split a histogram without order into blocks at random (fixed seed), as if its values were independent."""
    columns = _columns(histogram)
    counts = np.zeros(columns.size, np.int64)
    at = np.searchsorted(columns, histogram.values_ns, side="right") - 1
    np.add.at(counts, at, histogram.counts)
    rng = np.random.default_rng(_SEED)
    rows = []
    remainder = counts
    for remaining in range(blocks, 0, -1):
        take = rng.binomial(remainder, 1 / remaining) if remaining > 1 else remainder
        rows.append(take)
        remainder = remainder - take
    table = np.array(rows, dtype=np.int64)
    centre = columns + histogram.bin_ns / 2 if histogram.bin_ns > 1 else columns.astype(np.float64)
    return Blocks(values_ns=columns, counts=table, sums_ns=table @ centre, bin_ns=histogram.bin_ns, ordered=False)


def _columns(histogram: Histogram) -> Int64s:
    """Lower edges of the columns: every filled bin, or one in several if there are too many."""
    values = histogram.values_ns
    return values[:: -(-values.size // _COLUMNS)] if values.size else values


def align(sets: Sequence[Sequence[Blocks]]) -> tuple[Int64s, int, list[list[Int64s]]]:
    """Bring runs of several sets to the same columns and to about the same block length.

    Returns the columns (m,), their width in ns, and, for each set and run, counts (b, m).
    """
    runs = [run for members in sets for run in members]
    width = max(run.bin_ns for run in runs)
    columns = np.unique(np.concatenate([run.values_ns for run in runs]) // width * width)
    columns = columns[:: -(-columns.size // _COLUMNS)]
    longest = max(run.length for run in runs)
    aligned = []
    for members in sets:
        rows = []
        for run in members:
            factor = max(1, round(longest / max(run.length, 1e-9)))
            groups = max(1, len(run.sums_ns) // factor)
            at = np.searchsorted(columns, run.values_ns // width * width, side="right") - 1
            starts = np.arange(groups) * factor
            merged = np.add.reduceat(run.counts, starts, axis=0)
            table = np.zeros((groups, columns.size), np.int64)
            np.add.at(table.T, np.maximum(at, 0), merged.T)
            rows.append(table)
        aligned.append(rows)
    return columns, width, aligned


def add_outputs(outputs: Sequence[Blocks]) -> Blocks:
    """Add outputs that measured the same moments (the subscribers of one run), block by block."""
    if len(outputs) == 1:
        return outputs[0]
    width = max(output.bin_ns for output in outputs)
    columns = np.unique(np.concatenate([output.values_ns for output in outputs]) // width * width)
    rows = min(len(output.sums_ns) for output in outputs)
    counts = np.zeros((rows, columns.size), np.int64)
    sums = np.zeros(rows)
    for output in outputs:
        at = np.searchsorted(columns, output.values_ns // width * width)
        # An output that lost messages may have fewer blocks; the surplus blocks of the others are added to their last
        # one.
        np.add.at(counts.T, at, np.add.reduceat(output.counts, np.arange(rows), axis=0).T)
        sums += np.add.reduceat(output.sums_ns, np.arange(rows))
    ordered = all(output.ordered for output in outputs)
    return Blocks(values_ns=columns, counts=counts, sums_ns=sums, bin_ns=width, ordered=ordered)
