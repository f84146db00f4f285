"""Notes, and who was notified: small JSON files that are added to an archive one by one and never changed."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Generic, TypeVar

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError
from pydantic_core import PydanticSerializationError

from rtfiles.errors import UsageError
from rtrun.archive.stamps import next_stamp, read_stamp
from rtrun.archive.store import Store, list_names, read_small_files, write_file

YEARS = (1900, 3000)
"""All times of an archive lie from the first year on and before the second."""
Entry = TypeVar("Entry")


def _in_utc(moment: datetime) -> datetime:
    if not YEARS[0] < moment.year < YEARS[1] - 1:  # a time zone shifts a time by less than a day
        raise ValueError(f"{moment}, expected a time between {YEARS[0]} and {YEARS[1]}")
    return moment.astimezone(UTC).replace(tzinfo=None) if moment.tzinfo else moment


Moment = Annotated[datetime, Field(strict=False), AfterValidator(_in_utc)]
"""A time in UTC, without a zone."""
Text = Annotated[str, Field(min_length=1, max_length=1000)]


@dataclass(frozen=True, kw_only=True, slots=True)
class EntryKind(Generic[Entry]):
    """Entries of one kind: their folder, their reader, the limit of their number, and the size limit of each."""

    folder: str
    reader: TypeAdapter[Entry]
    entries_max: int
    bytes_max: int


def stamp_of(name: str) -> str:
    """The stamp in the name of an entry, which gives its place; empty, so first, for a file that others named."""
    stamp = name.partition("-")[0]
    return stamp if read_stamp(stamp) else ""


def read_entries(store: Store, kind: EntryKind[Entry]) -> Iterator[tuple[str, Entry]]:
    """The entries of a kind with their names, oldest first.

    Raises UsageError for a file that is not an entry, InfrastructureError.
    """
    found = read_small_files(store, kind.folder, ".json", most=kind.entries_max, max_bytes=kind.bytes_max)
    named = [(path.rpartition("/")[2].removesuffix(".json"), path, content) for path, content in found]
    for name, path, content in sorted(named, key=lambda entry: (stamp_of(entry[0]), entry[0])):
        try:
            yield name, kind.reader.validate_json(content)
        except ValidationError as error:
            (first, *_) = error.errors()
            where = ".".join(str(key) for key in first["loc"])
            raise UsageError(f"{store.address}: {path}: {where}: {first['msg']}") from error


def add_entry(store: Store, kind: EntryKind[Entry], entry: Entry, now: datetime) -> str:
    """Add an entry after all existing ones; returns its name. `now` is in UTC.

    Raises UsageError, and writes nothing, if `read_entries` could not read it back unchanged; InfrastructureError.
    """
    content = _encoded(store, kind, entry)
    names = [name.removesuffix(".json") for name in list_names(store, kind.folder) if name.endswith(".json")]
    check_room(store, kind, len(names))
    name = f"{next_stamp(map(stamp_of, names), now)}-{hashlib.sha256(content).hexdigest()[:8]}"
    write_file(store, f"{kind.folder}/{name}.json", content)
    return name


def check_room(store: Store, kind: EntryKind[Entry], number: int, more: int = 1) -> None:
    """Raise UsageError where `more` entries do not fit next to `number`: no command could read the archive then."""
    if number + more > kind.entries_max:
        raise UsageError(
            f"{store.address}: {kind.folder}: {number} files are there, and at most {kind.entries_max} are read: "
            "remove the oldest ones, or those that no longer hold"
        )


def _encoded(store: Store, kind: EntryKind[Entry], entry: Entry) -> bytes:
    try:
        content = kind.reader.dump_json(entry, by_alias=True, indent=1) + b"\n"
        is_same = kind.reader.validate_json(content) == entry
    except (ValidationError, PydanticSerializationError) as error:
        raise UsageError(f"{store.address}: {kind.folder}: what is to be written cannot be read: {error}") from error
    if not is_same or len(content) > kind.bytes_max:
        raise UsageError(
            f"{store.address}: {kind.folder}: what is to be written would be read as something else, or is larger than "
            f"{kind.bytes_max} bytes"
        )
    return content
