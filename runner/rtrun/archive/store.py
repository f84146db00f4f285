"""Where an archive is stored: a folder, or any place that fsspec reaches by an address such as s3://bucket/archive.

A file is written completely or not at all, and a file of a table is never rewritten: on a disk it is renamed into
place, and an object store shows an object once all of it has arrived. A partial Parquet file can still come from
elsewhere (an interrupted copy, a file system after a power cut). It counts as missing, and is written again.
"""

import contextlib
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from rtfiles import atomic, ownership
from rtfiles.config import Config
from rtfiles.errors import InfrastructureError, UsageError
from rtfiles.untrusted import text

SCHEMA = 2
MARKER = "archive.json"
_REMOTE_AT_ONCE = 32
_MAGIC = b"PAR1"  # the first and the last bytes of a complete Parquet file


class _Marker(Config):
    """archive.json, which marks an archive."""

    kind: Literal["rtrun archive"]
    schema_number: int = Field(alias="schema", ge=1)


@dataclass(frozen=True, kw_only=True, slots=True)
class Store:
    """A place for files: `root` is its path in `file_system` (an fsspec file system), `address` as it was given."""

    address: str
    file_system: Any
    root: str

    @property
    def is_local(self) -> bool:
        """Whether it is a folder of this machine."""
        return "file" in _protocols(self.file_system)

    @property
    def at_once(self) -> int:
        """How many files to open at a time: an object store makes them wait, otherwise they need the CPU."""
        return (os.cpu_count() or 1) if self.is_local else _REMOTE_AT_ONCE

    def locate(self, name: str) -> str:
        """The path of a file in the file system."""
        return f"{self.root}/{name}"


def _protocols(file_system: Any) -> tuple[str, ...]:
    protocol = file_system.protocol
    return (protocol,) if isinstance(protocol, str) else tuple(protocol)


def open_archive(address: str) -> Store:
    """Open the archive at an address. Raises UsageError when there is none, or when a newer version wrote it."""
    store = _reach(address)
    if _schema_of(store) is None:
        raise UsageError(
            f"{address}: no archive: there is no {MARKER} of one in it; rtrun archive add RESULTS --to makes an archive"
        )
    return store


def make_archive(address: str) -> Store:
    """Open the archive at an address for writing: a new one where nothing is, or one of this schema.

    Raises UsageError when something else is there, or when a newer version wrote it.
    """
    store = _reach(address)
    schema = _schema_of(store)
    if schema is None:
        with _naming(store, "cannot be listed"):
            names = store.file_system.ls(store.root, detail=False) if store.file_system.exists(store.root) else []
        # Another writer's marker is renamed into place, and its files follow.
        is_foreign = any(not name.rpartition("/")[2].lstrip(".").startswith(MARKER) for name in names)
        if is_foreign and _schema_of(store) is None:
            raise UsageError(
                f"{address}: holds files, but no {MARKER} of an archive: name an archive, or a new or empty folder"
            )
    if schema != SCHEMA:  # an older version would not find what this one writes
        write_file(store, MARKER, f'{{"kind": "rtrun archive", "schema": {SCHEMA}}}\n'.encode())
    return store


def _reach(address: str) -> Store:
    import fsspec.core

    _check_utf8(address)
    try:
        file_system, root = fsspec.core.url_to_fs(address)
    except (ImportError, ValueError) as error:  # no package for this protocol, or an unknown protocol
        raise UsageError(f"{address}: {error}") from error
    return Store(address=address, file_system=file_system, root=root.rstrip("/"))


def _schema_of(store: Store) -> int | None:
    """The schema that the archive is written in; None without an archive."""
    with _naming(store, "cannot be read"):
        if not store.file_system.exists(store.locate(MARKER)):
            return None
        content = store.file_system.cat_file(store.locate(MARKER))
    try:
        marker = _Marker.model_validate_json(content)
    except ValidationError:  # its writing was interrupted: it counts as missing
        return None
    if marker.schema_number > SCHEMA:
        raise UsageError(
            f"{store.address}: written by a newer version, in schema {marker.schema_number}; this one knows schema "
            f"{SCHEMA}: update rtrun"
        )
    return marker.schema_number


def is_whole(store: Store, path: str) -> bool:
    """Whether a Parquet file is complete, from its first to its last byte."""
    with _naming(store, "cannot be read"):
        if not store.file_system.exists(path):
            return False
        size = store.file_system.size(path)
        return bool(
            size > 2 * len(_MAGIC)
            and store.file_system.cat_file(path, start=0, end=len(_MAGIC)) == _MAGIC
            and store.file_system.cat_file(path, start=size - len(_MAGIC), end=size) == _MAGIC
        )


def write_file(store: Store, name: str, content: bytes) -> None:
    """Write a file completely or not at all. Raises InfrastructureError naming it."""
    path = store.locate(name)
    with _naming(store, f"{name} cannot be written"):
        if store.is_local:
            ownership.resolve(Path(path))  # make no folder behind another user's link
        store.file_system.makedirs(path.rpartition("/")[0], exist_ok=True)
        if store.is_local:
            atomic.write_bytes(Path(path), content)
        else:
            store.file_system.pipe_file(path, content)


def find_files(store: Store, folder: str) -> list[str]:
    """The paths of all Parquet files below a folder of the archive, ascending."""
    with _naming(store, "cannot be listed"):
        known = map(str, store.file_system.find(store.locate(folder)))
        paths = sorted(path for path in known if path.endswith(".parquet"))
    for path in paths:
        _check_utf8(path)
    return paths


def list_names(store: Store, folder: str) -> list[str]:
    """The names of the files below a folder of the archive, without hidden ones. Raises InfrastructureError."""
    with _naming(store, "cannot be listed"):
        store.file_system.invalidate_cache()  # others may have written since this process listed the folder
        names = [str(path).rpartition("/")[2] for path in store.file_system.find(store.locate(folder))]
    return [name for name in names if not name.startswith(".")]


def read_small_files(store: Store, folder: str, ends: str, *, most: int, max_bytes: int) -> list[tuple[str, bytes]]:
    """Paths and contents of the files below a folder whose names end with `ends`, ascending.

    Raises UsageError where there are more than `most`, or one has more than `max_bytes`; InfrastructureError.
    """
    with _naming(store, "cannot be read"):
        known = store.file_system.find(store.locate(folder), detail=True)
        sizes = {str(path): int(about["size"] or 0) for path, about in sorted(known.items())}
        paths = [path for path in sizes if path.endswith(ends) and not path.rpartition("/")[2].startswith(".")]
        if len(paths) > most or any(sizes[path] > max_bytes for path in paths):
            raise UsageError(f"{store.locate(folder)}: more than {most} files, or one of more than {max_bytes} bytes")
        contents = store.file_system.cat(paths) if paths else {}
    return [(path, contents[path]) for path in paths]


def remove_files(store: Store, paths: Sequence[str]) -> None:
    """Remove files; a file that another call removed is no error. Raises InfrastructureError."""
    with _naming(store, "a file cannot be removed"), contextlib.suppress(FileNotFoundError):
        if not store.is_local and paths:
            store.file_system.rm(list(paths))  # an object store removes a thousand with one request
        elif store.is_local:
            for path in paths:
                (ownership.resolve(Path(path).parent) / Path(path).name).unlink(missing_ok=True)


def _check_utf8(path: str) -> None:
    """Raise UsageError for a path that pyarrow cannot take."""
    try:
        text(path)
    except ValueError as error:
        raise UsageError(f"{path!r}: not UTF-8: rename it") from error


@contextmanager
def _naming(store: Store, what: str) -> Iterator[None]:
    """Turn any error of a file system into an InfrastructureError of one line."""
    try:
        yield
    except (UsageError, InfrastructureError):
        raise
    except Exception as error:  # each object store has its own exceptions
        reason = (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
        raise InfrastructureError(f"{store.address}: {what}: {' '.join(reason.split())}") from error
