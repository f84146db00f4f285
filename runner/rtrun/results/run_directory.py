"""Run directories: filled under a temporary name, closed by run.json, renamed into place (see docs/formats.md)."""

import contextlib
import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from rtfiles import atomic, ownership
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.results.record import FILE, FileRecord, RunRecord, read_record


def make_results(folder: Path) -> None:
    """Make the folder for the runs of a campaign, unless it is there.

    Raises UsageError where others could change what it holds, InfrastructureError where it cannot be made.
    """
    try:
        ownership.make_folder(folder)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot keep the results: {error.strerror}") from error
    if not os.access(folder, os.W_OK):
        raise InfrastructureError(f"{folder}: cannot keep the results: it is read-only")


@contextlib.contextmanager
def filling(folder: Path) -> Iterator[Path]:
    """Yield an empty folder beside `folder` to fill; nothing of it stays when the context is left by an exception.

    A full local disk, or any other trouble with it, is an InfrastructureError. Raises as `make_results`, too.
    """
    partial = folder.with_name(f".{folder.name}.partial")
    make_results(folder.parent)
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        yield partial
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        place = error.filename or partial
        # numpy gives no reason where a file took less than it wrote.
        reason = error.strerror or f"the disk took no more ({error})"
        raise InfrastructureError(f"{place}: cannot keep the results: {reason}") from error
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


@contextlib.contextmanager
def together(results: Path, number: str) -> Iterator[Path]:
    """Yield an empty folder to close run directories in: at the end all of them stand in `results`, or none does.

    The one that is called `number` comes last. Raises InfrastructureError where there is no room for all.
    """
    try:
        with filling(results / number) as staged:
            yield staged
            for folder in sorted(staged.iterdir(), key=lambda each: (each.name == number, each.name)):
                rename(folder, results / folder.name)
            staged.rmdir()
    except InfrastructureError as error:
        raise InfrastructureError(f"{error}; nothing of {number} is kept") from error


def close(partial: Path, folder: Path, record: RunRecord) -> None:
    """Write run.json with the size and SHA-256 of every file, and give the folder its name."""
    files = {}
    for path in sorted(partial.iterdir()):
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            os.fsync(stream.fileno())
        files[path.name] = FileRecord(size_bytes=path.stat().st_size, sha256=digest)
    atomic.write_text(partial / FILE, record.model_copy(update={"files": files}).to_json())
    rename(partial, folder)


def rename(source: Path, folder: Path) -> None:
    """Move a folder into place for good; what stood there before is kept as ``<name>.old-<n>``."""
    if folder.exists():
        folder.rename(unused(folder, "old"))
    source.rename(folder)
    atomic.sync_folder(folder.parent)


def unused(folder: Path, kind: str) -> Path:
    """Return the first ``<name>.<kind>-<n>`` beside a folder that is not taken."""
    number = 1
    while (candidate := folder.with_name(f"{folder.name}.{kind}-{number}")).exists():
        number += 1
    return candidate


def closing_record(folder: Path) -> RunRecord | None:
    """Return the record of a run directory, or None when it is not closed, or not readable."""
    try:
        return read_record(folder)
    except UsageError:
        return None
