"""The Parquet files of a table: one per run, and packs of many runs, which `rtrun archive compact` makes.

The file of a run is named by the run's key, a pack by a stamp later than those of all packs before it. In a pack the
rows of a run are contiguous. For a while a run is in several files, with the same rows in each. The newest pack that
has the run counts, or else its own file. So a reader finds each run once, whether it listed the files before or after a
pack was added.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rtfiles.errors import InfrastructureError, UsageError
from rtrun.archive.store import Store, find_files
from rtrun.kinds.limits import BINS_MAX

if TYPE_CHECKING:
    import pyarrow
    from pyarrow.parquet import FileMetaData, ParquetFile

PACK = "pack-"
ROW_GROUP = 1 << 17
"""Limit of the rows in a row group of a pack."""
GROUPS_MAX = 1024  #: row groups of a file of an archive
"""Limit of the row groups in a file: each takes 6 KB of memory in a footer, and the rows of a run are in at most 32."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TableFile:
    """A file of a table, with the rows of each run in it: (first, number) by the key of the run."""

    path: str
    footer: "FileMetaData"
    rows: Mapping[str, tuple[int, int]]

    @property
    def is_pack(self) -> bool:
        """Whether it is a pack of many runs."""
        return is_pack(self.path)


@dataclass(frozen=True, slots=True)
class RowRange:
    """Where the rows of a run are: `number` rows of a file, from row `first` on."""

    file: TableFile
    first: int
    number: int


def name_of(path: str) -> str:
    """The name of a file: the key of its run, or the name of the pack."""
    return path.rpartition("/")[2].removesuffix(".parquet")


def is_pack(path: str) -> bool:
    """Whether a file is a pack of many runs."""
    return name_of(path).startswith(PACK)


@dataclass(frozen=True, kw_only=True, slots=True)
class TableFiles:
    """The files of a table: its packs, newest first, and the paths of single runs by the key of the run."""

    packs: Sequence[TableFile]
    alone: Mapping[str, str]

    def newest(self) -> dict[str, TableFile]:
        """The pack that counts for each packed run."""
        found: dict[str, TableFile] = {}
        for file in self.packs:
            for key in file.rows:
                found.setdefault(key, file)
        return found


def paths_of(store: Store, table: str) -> tuple[list[str], dict[str, str]]:
    """Packs, newest first, and the files of single runs by key."""
    paths = find_files(store, table)
    packs = sorted(filter(is_pack, paths), key=name_of, reverse=True)
    return packs, {name_of(path): path for path in paths if not is_pack(path)}


def read_files(store: Store, table: str) -> TableFiles:
    """The files of a table. Raises UsageError for a damaged pack, InfrastructureError."""
    packs, alone = paths_of(store, table)
    with ThreadPoolExecutor(store.at_once) as threads:
        return TableFiles(packs=list(threads.map(partial(_pack, store), packs)), alone=alone)


def places(store: Store, table: str) -> dict[str, RowRange]:
    """Where each run of a table is. Raises UsageError for a file that is damaged or has too many rows."""
    files = read_files(store, table)
    found = {key: RowRange(file, *file.rows[key]) for key, file in files.newest().items()}
    others = [(key, path) for key, path in files.alone.items() if key not in found]
    with ThreadPoolExecutor(store.at_once) as threads:
        footers = threads.map(lambda other: _footer(store, other[1]), others)
        for (key, path), footer in zip(others, footers, strict=True):
            rows = {key: (0, footer.num_rows)}
            found[key] = RowRange(TableFile(path=path, footer=footer, rows=rows), *rows[key])
    return found


def _footer(store: Store, path: str) -> "FileMetaData":
    with opened(store, path) as file:
        return check_rows(file.metadata)


def _pack(store: Store, path: str) -> TableFile:
    """A pack with its column of keys read. Raises UsageError where the rows of a run are not contiguous."""
    with opened(store, path, dictionary=("run_key",)) as file:
        footer = check_rows(file.metadata)
        if any(footer.row_group(group).num_rows > ROW_GROUP for group in range(footer.num_row_groups)):
            raise ValueError(f"a row group of more than {ROW_GROUP} rows")
        known, codes = coded(file.read(columns=["run_key"], use_threads=False)["run_key"])
        starts = np.flatnonzero(np.r_[True, np.diff(codes) != 0][: codes.size])
        if codes[starts].size != np.unique(codes).size or -1 in codes[starts]:
            raise ValueError("run_key: the rows of a run lie apart, or a row has none")
        keys = [known[code] for code in codes[starts].tolist()]
        numbers = np.diff(np.r_[starts, codes.size])
        rows = dict(zip(keys, zip(starts.tolist(), numbers.tolist(), strict=True), strict=True))
        return TableFile(path=path, footer=footer, rows=rows)


def coded(column: Any) -> tuple[list[str | None], np.ndarray[tuple[int], np.dtype[Any]]]:
    """The different texts of a column read as a dictionary, and the text index of each row, shape (n,), or -1."""
    whole = column.unify_dictionaries().combine_chunks()
    return whole.dictionary.to_pylist(), numbers_of(whole.indices, -1)


def numbers_of(column: "pyarrow.Array[Any]", null: int) -> np.ndarray[tuple[int], np.dtype[Any]]:
    """A column of integers, with `null` where it has none, shape (n,).

    It is read from the buffers: pyarrow's own function imports pandas where it is installed, which takes as long as an
    answer.
    """
    if not len(column):
        return np.zeros(0, column.type.to_pandas_dtype())
    rows = slice(column.offset, column.offset + len(column))
    bits, values = column.buffers()
    stored = np.frombuffer(values, column.type.to_pandas_dtype())[rows]
    if not column.null_count:
        return stored
    is_valid = np.unpackbits(np.frombuffer(bits, np.uint8), bitorder="little")[rows].view(bool)
    return np.where(is_valid, stored, null)


def check_rows(footer: "FileMetaData", most: int = BINS_MAX) -> "FileMetaData":
    """Return the footer of a file. Raises ValueError where the file has more rows than `most`.

    The number of rows is at the end of a file, so a file that is too long is refused before it is read.
    """
    if footer.num_rows > most:
        raise ValueError(f"{footer.num_rows} rows, a file of this table has at most {most}")
    return footer


@contextmanager
def opened(
    store: Store, path: str, *, footer: "FileMetaData | None" = None, dictionary: Sequence[str] = ()
) -> "Iterator[ParquetFile]":
    """Open a Parquet file; the columns in `dictionary` are read as dictionaries.

    Raises UsageError where its content is wrong, also for a ValueError raised within the context; InfrastructureError.
    """
    import pyarrow
    import pyarrow.parquet

    try:
        # A local file is given by its path: pyarrow reads it without Python's lock. From any other file it requests the
        # ranges that it needs, one request each.
        with nullcontext(path) if store.is_local else store.file_system.open(path, "rb", cache_type="none") as source:
            yield pyarrow.parquet.ParquetFile(
                source,
                metadata=footer,
                read_dictionary=list(dictionary),
                pre_buffer=not store.is_local,
                thrift_container_size_limit=GROUPS_MAX,  # for every list in a footer
            )
    except (pyarrow.ArrowException, ValueError) as error:
        raise damaged(store, f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise InfrastructureError(f"{store.address}: {path}: removed while it was read: ask again") from error
    except (UsageError, InfrastructureError):
        raise
    except Exception as error:  # each object store has its own exceptions
        reason = " ".join(str(error).split()) or type(error).__name__
        if "thrift" in reason.lower():  # from pyarrow, which has no exception type for it
            raise damaged(
                store, f"{path}: its footer is damaged, or lists more than {GROUPS_MAX} row groups: {reason}"
            ) from error
        raise InfrastructureError(f"{store.address}: cannot be read: {reason}") from error


def damaged(store: Store, what: str) -> UsageError:
    """The error for a file that is not as rtrun writes it."""
    return UsageError(
        f"{store.address}: {what}; rtrun archive add writes the file of a run anew that is not whole; a pack that was "
        "cut off while it was written can be removed"
    )
