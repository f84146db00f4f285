"""Run directories: filled under a temporary name, closed by run.json, renamed into place (see docs/formats.md).

Several processes may work in one folder of results. A process that takes a free name there holds the lock of the
folder.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from rtfiles import atomic, ownership
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.results.record import FILE, FileRecord, RunRecord, read_record

# A file in the folder that keeps a number: something was measured.
_BEGUN = "begun"


def make_results(folder: Path) -> bool:
    """Make the folder for the runs of a campaign, unless it exists. Returns whether this call made it.

    Raises UsageError where others could change its content, InfrastructureError where it cannot be made.
    """
    try:
        is_new = ownership.make_folder(folder)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot keep the results: {error.strerror}") from error
    if not os.access(folder, os.W_OK):
        raise InfrastructureError(f"{folder}: cannot keep the results: it is read-only")
    return is_new


def unused_results(folder: Path) -> Path:
    """The folder, or the first free name made of its name and a number."""
    if not folder.exists():
        return folder
    number = 2
    while (candidate := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    return candidate


def make_new_results(folder: Path) -> Path:
    """Make `unused_results` of a folder; nobody else gets it. Raises as `make_results`."""
    while not make_results(results := unused_results(folder)):
        pass  # another process took that name first
    return results


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of an existing folder; others wait meanwhile. It must not be taken twice."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def numbered(results: Path) -> Iterator[Path]:
    """Take the next number in a folder of results, such as 007, exclusively. Yields the folder to fill.

    Raises InfrastructureError where nothing can be written there.
    """
    try:
        with locked(results):
            _free_numbers_of_the_dead(results)
            names = (re.match(r"\.?([0-9]{1,9})(?![0-9])", path.name) for path in results.iterdir())
            folder = results / f"{max((int(match[1]) for match in names if match), default=0) + 1:03}"
            taken = _taken(folder)
            taken.mkdir()
            handle = _hold(taken)
    except OSError as error:
        raise InfrastructureError(f"{results}: cannot keep the results: {error.strerror}") from error
    try:
        yield folder
    finally:
        os.close(handle)
        with contextlib.suppress(OSError):
            (taken / _BEGUN).unlink(missing_ok=True)
            taken.rmdir()


def _taken(folder: Path) -> Path:
    """The folder that reserves a number while a call fills its run directory."""
    return folder.with_name(f".{folder.name}.taken")


def mark_begun(folder: Path) -> None:
    """Mark a numbered folder as measuring now. Raises InfrastructureError where nothing can be written."""
    try:
        (_taken(folder) / _BEGUN).touch()
        atomic.sync_folder(_taken(folder))
    except OSError as error:
        raise InfrastructureError(f"{folder.parent}: cannot keep the results: {error.strerror}") from error


def numbers_begun(results: Path) -> dict[str, bool]:
    """The numbers that began to measure and were not closed, each with whether its call still lives."""
    marks = sorted(results.glob(f".[0-9]*.taken/{_BEGUN}"))
    return {mark.parent.name[1:].removesuffix(".taken"): _is_held(mark.parent) for mark in marks}


def _is_held(taken: Path) -> bool:
    try:
        os.close(_hold(taken))
    except OSError:
        return True
    return False


def _hold(taken: Path) -> int:
    """Hold a number until the handle is closed. Raises BlockingIOError where somebody holds it."""
    handle = os.open(taken, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


def _free_numbers_of_the_dead(results: Path) -> None:
    """Remove what a killed call has left: what it was filling, and its number unless it had begun to measure."""
    for taken in results.glob(".*.taken"):
        folder = results / taken.name[1:].removesuffix(".taken")
        if not re.fullmatch(r"[0-9]{1,9}", folder.name):
            continue
        with contextlib.suppress(OSError):
            os.close(_hold(taken))
            shutil.rmtree(_partial_of(folder), ignore_errors=True)
            room_of(folder).unlink(missing_ok=True)
            taken.rmdir()


def _partial_of(folder: Path) -> Path:
    """The name of a run directory while it is filled."""
    return folder.with_name(f".{folder.name}.partial")


def room_of(folder: Path) -> Path:
    """The file that reserves disk space for a run directory."""
    return folder.with_name(f".{folder.name}.room")


@contextlib.contextmanager
def filling(folder: Path) -> Iterator[Path]:
    """Yield an empty folder next to `folder` to fill; it is removed when an exception leaves the context.

    A full local disk, or any other trouble with it, is an InfrastructureError. Also raises as `make_results`.
    """
    partial = _partial_of(folder)
    make_results(folder.parent)
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        yield partial
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        place = error.filename or partial
        # numpy gives no reason when a file took less than it wrote.
        reason = error.strerror or f"the disk took no more ({error})"
        raise InfrastructureError(f"{place}: cannot keep the results: {reason}") from error
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


@contextlib.contextmanager
def all_or_none(results: Path, number: str) -> Iterator[Path]:
    """Yield an empty folder to close run directories in: at the end all of them are in `results`, or none is.

    The one named `number` comes last. Raises InfrastructureError where there is no room for all.
    """
    try:
        with filling(results / number) as staged:
            yield staged
            for folder in sorted(staged.iterdir(), key=lambda entry: (entry.name == number, entry.name)):
                rename(folder, results / folder.name)
            staged.rmdir()
    except InfrastructureError as error:
        raise InfrastructureError(f"{error}; nothing of {number} is kept") from error


def close(partial: Path, folder: Path, record: RunRecord) -> None:
    """Write run.json with the size and SHA-256 of every file, and give the folder its final name."""
    files = {}
    for path in sorted(partial.iterdir()):
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            os.fsync(stream.fileno())
        files[path.name] = FileRecord(size_bytes=path.stat().st_size, sha256=digest)
    atomic.write_text(partial / FILE, record.model_copy(update={"files": files}).to_json())
    rename(partial, folder)


def rename(source: Path, folder: Path) -> None:
    """Move a folder to its final place; what was there before is kept as ``<name>.old-<n>``."""
    with locked(folder.parent):
        if folder.exists():
            folder.rename(_unused(folder, "old"))
        source.rename(folder)
    atomic.sync_folder(folder.parent)


def put_aside(folder: Path) -> None:
    """Move a run directory to the first free ``<name>.old-<n>``."""
    with locked(folder.parent):
        folder.rename(_unused(folder, "old"))


def keep_beside(partial: Path, folder: Path, kind: str) -> Path:
    """Move the filled folder to the first free ``<name>.<kind>-<n>`` next to `folder`; returns its path."""
    with locked(folder.parent):
        kept = partial.rename(_unused(folder, kind))
    atomic.sync_folder(folder.parent)
    return kept


def _unused(folder: Path, kind: str) -> Path:
    """The first free ``<name>.<kind>-<n>`` next to a folder; the caller holds the lock."""
    number = 1
    while (candidate := folder.with_name(f"{folder.name}.{kind}-{number}")).exists():
        number += 1
    return candidate


def closing_record(folder: Path) -> RunRecord | None:
    """Return the record of a run directory, or None when it is not closed or not readable."""
    try:
        return read_record(folder)
    except UsageError:
        return None
