"""Combine the files of single runs into packs of many: `rtrun archive compact`.

A pack is a new file, so readers are not disturbed, and a run that is added meanwhile keeps its own file until the next
call. A file whose runs are all in newer packs is removed once these packs are older than a grace period, so that
readers that have listed the old files can finish. Two concurrent calls make packs with the same runs, and the newer
pack supersedes the older. A file is removed only if its runs have expired or are in newer files.
"""

import hashlib
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from typing import NamedTuple

import pyarrow

from rtrun.archive.files import PACK, RowRange, TableFile, damaged, name_of, opened, paths_of, places, read_files
from rtrun.archive.notes import read_notes
from rtrun.archive.runs import LATER, PACKED_MAX, PARTITIONED, RunRow, in_path, is_kept, read_runs
from rtrun.archive.stamps import as_stamp, next_stamp, read_stamp
from rtrun.archive.store import Store, remove_files, write_file
from rtrun.archive.tables import SCHEMAS, Table, as_parquet, file_of
from rtrun.kinds.limits import BINS_MAX

GRACE = timedelta(days=1)
# Limits of the rows in a pack. A pack with fewer than half of them is packed again with newer runs.
_ROWS = {"runs": PACKED_MAX, "histograms": BINS_MAX, "samples": BINS_MAX}


class Compaction(NamedTuple):
    """What became of the files of an archive.

    `packed` files were combined into `packs`, `removed` files are gone, `waiting` files are superseded and within the
    grace period.
    """

    packed: int = 0
    packs: int = 0
    removed: int = 0
    waiting: int = 0


def compact(store: Store, *, grace: timedelta, now: datetime) -> Compaction:
    """Pack the files of an archive, and remove those whose grace period is over; a second call changes nothing.

    `now` is in UTC. Raises UsageError for a damaged file, InfrastructureError; finished work stays, and the next call
    does the rest.
    """
    # The runs of a course are stored in sequence, as they are read.
    rows = sorted(read_runs(store), key=_along_courses)
    order = {row.run_key: place for place, row in enumerate(rows)}
    notes = read_notes(store)
    done = []
    for table in SCHEMAS:
        # Runs that were already expired when the grace period began have no readers any more.
        since = notes.kept_since(table, now.replace(tzinfo=None), grace)
        gone = {row.run_key for row in rows if not is_kept(row, since)}
        done.append(_pack_table(store, table, order, gone, now))
        done.append(_remove_superseded(store, table, gone, now - grace))
    return Compaction(*map(sum, zip(*done, strict=True)))


def _along_courses(row: RunRow) -> tuple[object, ...]:
    """The order in which a history reads runs."""
    start = row.start_utc or datetime.max
    return row.scenario, row.parameters, row.platform, row.machine, start, row.run_key


def _pack_table(store: Store, table: str, order: Mapping[str, int], gone: Container[str], now: datetime) -> Compaction:
    most = _ROWS[table]
    members: dict[str, list[tuple[str, RowRange]]] = {}  # the runs that count in each file, by its path
    for key, place in sorted(places(store, table).items(), key=lambda item: (order.get(item[0], len(order)), item[0])):
        if key not in gone and place.number:
            members.setdefault(place.file.path, []).append((key, place))
    small = [of_file for of_file in members.values() if _is_small(of_file, most)]
    small.sort(key=lambda of_file: not of_file[0][1].file.is_pack)  # packs first, then by the order of their runs
    packs = packed = 0
    for bundle in _bundles(small, most):
        if len(bundle) > 1 or _is_sparse(bundle[0]):
            _write_pack(store, table, bundle, order, now)
            packs += 1
            packed += len(bundle)
    return Compaction(packed=packed, packs=packs)


_Members = Sequence[tuple[str, RowRange]]
"""The runs of one file, by key."""


def _is_small(members: _Members, most: int) -> bool:
    file = members[0][1].file
    return not file.is_pack or 2 * file.footer.num_rows <= most or _is_sparse(members)


def _is_sparse(members: _Members) -> bool:
    """Whether at least half the rows of a pack belong to runs that are expired or in newer packs."""
    file = members[0][1].file
    return file.is_pack and 2 * sum(place.number for _, place in members) <= file.footer.num_rows


def _bundles(files: Iterable[_Members], most: int) -> Iterator[list[_Members]]:
    """Consecutive files, grouped so that a group has at most `most` rows."""
    bundle: list[_Members] = []
    rows = 0
    for members in files:
        number = sum(place.number for _, place in members)
        if bundle and rows + number > most:
            yield bundle
            bundle, rows = [], 0
        bundle.append(members)
        rows += number
    if bundle:
        yield bundle


def _write_pack(store: Store, table: str, bundle: Sequence[_Members], order: Mapping[str, int], now: datetime) -> None:
    """Write the runs of some files into one new file."""
    rows: dict[str, Table] = {}
    with ThreadPoolExecutor(store.at_once) as threads:
        read = threads.map(lambda members: _read(store, table, members[0][1].file), bundle)
        for members, whole in zip(bundle, read, strict=True):
            rows |= {key: whole.slice(place.first, place.number) for key, place in members}
    keys = sorted(rows, key=lambda key: (order.get(key, len(order)), key))
    digest = hashlib.sha256("\n".join(keys).encode()).hexdigest()
    content = as_parquet(pyarrow.concat_tables([rows[key] for key in keys]).unify_dictionaries().combine_chunks())
    # The pack is newer than all others, whatever the clock of this machine says.
    stamps = [_words(path)[0] for path in paths_of(store, table)[0]]
    name = f"{PACK}{next_stamp(stamps, now)}-{as_stamp(now)}-{digest[:16]}"
    write_file(store, file_of(table, name), content)


def _read(store: Store, table: str, file: TableFile) -> Table:
    """All rows of a file, with the columns of its table; in schema 1 some columns were only in its path.

    Texts are read as dictionaries, which take much less memory.
    """
    text = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
    fields = [(field.name, text if field.type == pyarrow.string() else field.type) for field in SCHEMAS[table]]
    partitioned = [name for name in PARTITIONED if table == "runs" and f"/{name}=" in file.path]
    texts = [name for name, type_ in fields if type_ == text and name not in (*partitioned, *LATER)]
    with opened(store, file.path, footer=file.footer, dictionary=texts) as source:
        whole = source.read(use_threads=False)
        for name in partitioned:
            whole = whole.append_column(name, pyarrow.array([in_path(file.path, name)] * whole.num_rows))
        for name in LATER if table == "runs" else ():
            if name not in whole.column_names:
                whole = whole.append_column(name, pyarrow.nulls(whole.num_rows, dict(fields)[name]))
        return whole.select([name for name, _ in fields]).cast(pyarrow.schema(fields))


def _remove_superseded(store: Store, table: str, gone: Container[str], before: datetime) -> Compaction:
    """Remove files whose runs all expired, or have been in newer packs for longer than the grace period.

    It does not matter whether these packs are superseded themselves: readers that listed the files since then use no
    older files.
    """
    files = read_files(store, table)
    since: dict[str, datetime] = {}  # by run: when the first pack newer than a file was made
    superseded: list[tuple[str, list[datetime]]] = []
    for file in files.packs:
        if all(key in gone or key in since for key in file.rows):
            superseded.append((file.path, [since[key] for key in file.rows if key not in gone]))
        packed_at = _packed_at(store, file)
        since |= {key: min(packed_at, since.get(key, packed_at)) for key in file.rows}
    for key, path in files.alone.items():
        if key in gone or key in since:
            superseded.append((path, [] if key in gone else [since[key]]))
    over = [path for path, times in superseded if all(time <= before for time in times)]
    remove_files(store, over)
    return Compaction(removed=len(over), waiting=len(superseded) - len(over))


def _words(path: str) -> list[str]:
    """The parts of a pack's name: its stamp, when it was made (if recorded), its digest."""
    return name_of(path).removeprefix(PACK).split("-")


def _packed_at(store: Store, pack: TableFile) -> datetime:
    """When a pack was made, in UTC, by the clock of the machine that made it."""
    stamp, *rest = _words(pack.path)
    packed_at = next((moment for text in [*rest[:1], stamp] if (moment := read_stamp(text)) is not None), None)
    if packed_at is None:
        raise damaged(store, f"{pack.path}: no name of a pack, as {PACK}20261124T101500Z-...")
    return packed_at
