"""What people said, and who was told: small JSON files that are added to an archive one by one, and never changed."""

import hashlib
from collections.abc import Iterator
from datetime import datetime
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from rtfiles.errors import UsageError
from rtrun.archive.store import Store, read_small_files, write_file

_TIME = "%Y%m%dT%H%M%SZ"
Entry = TypeVar("Entry")


def read_entries(
    store: Store, folder: str, reader: TypeAdapter[Entry], *, most: int, max_bytes: int
) -> Iterator[tuple[str, Entry]]:
    """The entries of a folder with their names, the first one first.

    Raises UsageError for a file that is none, InfrastructureError.
    """
    for path, content in read_small_files(store, folder, ".json", most=most, max_bytes=max_bytes):
        try:
            entry = reader.validate_json(content)
        except ValidationError as error:
            (first, *_) = error.errors()
            where = ".".join(str(each) for each in first["loc"])
            raise UsageError(f"{store.address}: {path}: {where}: {first['msg']}") from error
        yield path.rpartition("/")[2].removesuffix(".json"), entry


def add_entry(store: Store, folder: str, at: datetime, content: bytes) -> str:
    """Add an entry of a time in UTC; returns its name. Raises InfrastructureError."""
    name = f"{at.strftime(_TIME)}-{hashlib.sha256(content).hexdigest()[:8]}"
    write_file(store, f"{folder}/{name}.json", content)
    return name
