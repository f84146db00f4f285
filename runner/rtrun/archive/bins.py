"""Read the bins of runs from an archive's histograms, and compute figures from the bins of several runs together."""

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from itertools import accumulate
from threading import Lock
from typing import Any

import numpy as np

from rtrun.analysis.figures import PERCENTILES
from rtrun.archive.files import RowRange, TableFile, coded, numbers_of, opened
from rtrun.archive.store import Store
from rtrun.kinds.lateness import are_late
from rtrun.kinds.limits import TIME_MAX_NS
from rtrun.kinds.values import Int64s

Bins = tuple[Int64s, Int64s, Int64s]
"""value_ns, bin_ns and count of the rows of a histogram, shape (n,); NONE where the table has null."""
NONE = -(2**63)
_Rows = tuple[list[str | None], Int64s, Bins]
"""Rows as they are read: the series names, the name index of each row, and the numbers."""
_PER_100_000 = [round(1000 * p) for p in PERCENTILES]
_GRID_MAX = 4  # grid places per bin
_GRID_FROM = 4  # histograms: with fewer, sorting is faster, as each is already sorted
_COUNT_MAX = 2**53  # of all bins: above it a double cannot count in steps of one
_KEPT = 64  # row groups of 4 MB each
_NUMBERS = ("value_ns", "bin_ns", "count")


class BinReader:
    """Reads the bins of one run after another; of a pack it keeps the row groups that were read last.

    The runs of a pack are stored in the order in which they are read, so each row group is read once.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._groups: OrderedDict[tuple[str, int], Future[_Rows]] = OrderedDict()
        self._first_rows: dict[str, Sequence[int]] = {}
        self._lock = Lock()

    def read(self, place: RowRange) -> dict[str, Bins]:
        """The bins of a run by series. Raises UsageError for a file that is not a histogram, InfrastructureError."""
        if not place.file.is_pack:
            return _by_series(_read_rows(self._store, place.file, None))
        parts: dict[str, list[Bins]] = {}
        starts = self._starts(place.file)
        low, end = place.first, place.first + place.number
        for group in range(bisect_right(starts, low) - 1, len(starts) - 1):
            first, high = starts[group], min(end, starts[group + 1])
            if low >= high:
                break
            names, codes, (value, width, count) = self._group(place.file, group)
            rows = slice(low - first, high - first)
            of_run = (names, codes[rows], (value[rows], width[rows], count[rows]))
            for series, bins in _by_series(of_run).items():
                parts.setdefault(series, []).append(bins)
            low = high
        return {series: joined(pieces) for series, pieces in parts.items()}

    def _starts(self, file: TableFile) -> Sequence[int]:
        """The first row of each row group of a pack, and the total number of rows."""
        if file.path not in self._first_rows:
            groups = map(file.footer.row_group, range(file.footer.num_row_groups))
            self._first_rows[file.path] = [*accumulate((group.num_rows for group in groups), initial=0)]
        return self._first_rows[file.path]

    def _group(self, file: TableFile, group: int) -> _Rows:
        """A row group of a pack; the first thread that asks for it reads it."""
        key = (file.path, group)
        with self._lock:
            future = self._groups.get(key)
            if is_new := future is None:
                future = self._groups[key] = Future()
                if len(self._groups) > _KEPT:
                    self._groups.popitem(last=False)
            self._groups.move_to_end(key)
        if is_new:
            try:
                future.set_result(_read_rows(self._store, file, group))
            except BaseException as error:
                future.set_exception(error)
        return future.result()


def _read_rows(store: Store, file: TableFile, group: int | None) -> _Rows:
    """The rows of a file, or of one of its row groups."""
    import pyarrow

    with opened(store, file.path, footer=file.footer, dictionary=("series",)) as source:
        types = {field.name: field.type for field in source.schema_arrow}
        expected = {"series": pyarrow.dictionary(pyarrow.int32(), pyarrow.string())}
        expected |= dict.fromkeys(_NUMBERS, pyarrow.int64())
        if wrong := [name for name, type_ in expected.items() if types.get(name) != type_]:
            wanted = "string" if wrong[0] == "series" else "int64"
            raise ValueError(f"{wrong[0]}: expected {wanted}, got {types.get(wrong[0], 'no such column')}")
        columns = [*expected]
        if group is None:
            table = source.read(columns=columns, use_threads=False)
        else:
            table = source.read_row_group(group, columns=columns, use_threads=False)
        value, width, count = (numbers_of(table[name].combine_chunks(), NONE) for name in _NUMBERS)
        _check_bins(value, width, count)
        return *coded(table["series"]), (value, width, count)


def _by_series(rows: _Rows) -> dict[str, Bins]:
    names, codes, (value, width, count) = rows
    if codes.size and (codes == codes[0]).all():
        return {str(names[codes[0]]): (value, width, count)} if codes[0] >= 0 else {}
    chosen = {str(names[code]): codes == code for code in np.unique(codes) if code >= 0}
    return {name: (value[at], width[at], count[at]) for name, at in chosen.items()}


def _check_bins(value: Int64s, width: Int64s, count: Int64s) -> None:
    """Raise ValueError for a number that `histogram_table` never writes."""
    for name, column, lowest, highest in (
        ("value_ns", value[value != NONE], -TIME_MAX_NS, TIME_MAX_NS),
        ("bin_ns", width[width != NONE], 1, TIME_MAX_NS),
        ("count", count, 0, _COUNT_MAX),
    ):
        if column.size and not lowest <= column.min() <= column.max() <= highest:
            raise ValueError(f"{name}: from {column.min()} to {column.max()}, expected {lowest} to {highest}")
    if (total := count.sum(dtype=np.float64)) > _COUNT_MAX:
        raise ValueError(f"count: {total:g} in all, expected at most {_COUNT_MAX}")


def joined(bins: Sequence[Bins]) -> Bins:
    """The rows of several histograms, one after another."""
    if len(bins) == 1:
        return bins[0]
    value, width, count = (np.concatenate(columns) for columns in zip(*bins, strict=True))
    return value, width, count


def merged(bins: Sequence[Bins]) -> Bins:
    """The same counts, with equal bins merged."""
    value, width, count = joined(bins)
    order = np.lexsort((width, value))
    value, width, count = value[order], width[order], count[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(value) != 0) | (np.diff(width) != 0)][: value.size])
    return value[starts], width[starts], np.add.reduceat(count, starts) if starts.size else count


def figures_of_bins(bins: Sequence[Bins], deadline_ns: int | None) -> Mapping[str, Any]:
    """n, misses, unclear, percentiles_ns and max_ns of a Point, from the bins of its runs."""
    value, width, count = joined(bins)
    late_above_ns = TIME_MAX_NS if deadline_ns is None else deadline_ns
    late = are_late(value, late_above_ns, width)
    close = late & ~are_late(value, late_above_ns)
    limit_ns: int | None = None  # at and above this, values are only counted
    added = value, width, count
    if value.size and NONE in (value.min(), width.min()):
        came, known = value != NONE, width != NONE
        late |= ~came | ~known
        close &= came & known
        limit_ns = min(value[came & ~known].tolist(), default=None)
        added = value[came], width[came], count[came]
    values, reached = _added_up(*added, number=len(bins))
    percentiles_ns: dict[float, int | None] = dict.fromkeys(PERCENTILES)
    highest_ns: int | None = None
    if values.size:
        # The rank in integers, so that rounding does not shift it.
        ranks = [-(-int(reached[-1]) * share // 100_000) for share in _PER_100_000]
        at_ranks = values[np.searchsorted(reached, ranks)].tolist()
        *at_percentiles, highest_ns = (
            value_ns if limit_ns is None or value_ns < limit_ns else None for value_ns in (*at_ranks, int(values[-1]))
        )
        percentiles_ns = dict(zip(PERCENTILES, at_percentiles, strict=True))
    is_known = deadline_ns is not None and (limit_ns is None or limit_ns >= deadline_ns)
    return {
        "n": int(count.sum()),
        "misses": int(count[late].sum()) if is_known else None,
        "unclear": int(count[close].sum()),
        "percentiles_ns": percentiles_ns,
        "max_ns": highest_ns,
    }


def _added_up(value: Int64s, width: Int64s, count: Int64s, *, number: int) -> tuple[Int64s, Int64s]:
    """Values of `number` histograms, ascending, and how many measurements are at or below each, shape (k,)."""
    if number >= _GRID_FROM and value.size and 0 < (step := width.min()) == width.max():
        # Bins of one clock lie on a grid: adding them up there is much faster than sorting.
        lowest = value.min()
        at, beside = np.divmod(value - lowest, step)
        if not beside.any() and at.max() < _GRID_MAX * value.size:
            counts = np.bincount(at, weights=count).astype(np.int64)  # whole numbers below 2**53
            filled = np.flatnonzero(counts)
            return lowest + step * filled, np.cumsum(counts[filled])
    order = np.argsort(value, kind="stable")
    return value[order], np.cumsum(count[order])
