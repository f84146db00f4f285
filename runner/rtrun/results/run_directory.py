"""Run directories: filled under a temporary name, closed by run.json, renamed into place (see docs/formats.md).

Several may work in one folder of results. Whoever takes a name there that is free does so under the folder's lock.
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

# In the folder that keeps a number: something was measured.
_BEGUN = "begun"


def make_results(folder: Path) -> bool:
    """Make the folder for the runs of a campaign, unless it is there. Whether this call made it.

    Raises UsageError where others could change what it holds, InfrastructureError where it cannot be made.
    """
    try:
        is_new = ownership.make_folder(folder)
    except OSError as error:
        raise InfrastructureError(f"{folder}: cannot keep the results: {error.strerror}") from error
    if not os.access(folder, os.W_OK):
        raise InfrastructureError(f"{folder}: cannot keep the results: it is read-only")
    return is_new


def unused_results(folder: Path) -> Path:
    """The folder, or the first of its name and a number that is not there."""
    if not folder.exists():
        return folder
    number = 2
    while (candidate := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    return candidate


def make_new_results(folder: Path) -> Path:
    """Make `unused_results` of a folder; nobody else gets it. Raises as `make_results`."""
    while not make_results(made := unused_results(folder)):
        pass  # another took that name first
    return made


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which is there; others wait meanwhile. It is not to be taken twice."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def numbered(results: Path) -> Iterator[Path]:
    """Take the next number in a folder of results, as 007; nobody else gets it. Yields the folder to be filled.

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
    """The folder that keeps a number while a call fills its run directory."""
    return folder.with_name(f".{folder.name}.taken")


def mark_begun(folder: Path) -> None:
    """Say that what fills a numbered folder measures now. Raises InfrastructureError where nothing can be written."""
    try:
        (_taken(folder) / _BEGUN).touch()
        atomic.sync_folder(_taken(folder))
    except OSError as error:
        raise InfrastructureError(f"{folder.parent}: cannot keep the results: {error.strerror}") from error


def numbers_begun(results: Path) -> dict[str, bool]:
    """The numbers of which something was measured and nothing is closed: whether the call that measures still lives."""
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
    """Remove what a killed call has left: the number that it took, unless it had begun, and what it was filling."""
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
    """What a run directory is called while it is filled."""
    return folder.with_name(f".{folder.name}.partial")


def room_of(folder: Path) -> Path:
    """The file that keeps room on the disk for a run directory."""
    return folder.with_name(f".{folder.name}.room")


@contextlib.contextmanager
def filling(folder: Path) -> Iterator[Path]:
    """Yield an empty folder beside `folder` to fill; nothing of it stays when the context is left by an exception.

    A full local disk, or any other trouble with it, is an InfrastructureError. Raises as `make_results`, too.
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
        # numpy gives no reason where a file took less than it wrote.
        reason = error.strerror or f"the disk took no more ({error})"
        raise InfrastructureError(f"{place}: cannot keep the results: {reason}") from error
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


@contextlib.contextmanager
def all_or_none(results: Path, number: str) -> Iterator[Path]:
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
    """Move a folder into its final place; what stood there before is kept as ``<name>.old-<n>``."""
    with locked(folder.parent):
        if folder.exists():
            folder.rename(_unused(folder, "old"))
        source.rename(folder)
    atomic.sync_folder(folder.parent)


def put_aside(folder: Path) -> None:
    """Move a run directory to the first ``<name>.old-<n>`` that is free."""
    with locked(folder.parent):
        folder.rename(_unused(folder, "old"))


def keep_beside(partial: Path, folder: Path, kind: str) -> Path:
    """Move what was filled to the first ``<name>.<kind>-<n>`` beside a folder that is free; returns that."""
    with locked(folder.parent):
        kept = partial.rename(_unused(folder, kind))
    atomic.sync_folder(folder.parent)
    return kept


def _unused(folder: Path, kind: str) -> Path:
    """The first ``<name>.<kind>-<n>`` beside a folder that is free, for who holds the lock."""
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
