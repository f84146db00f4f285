"""Files written completely or not at all."""

import os
import shutil
import tempfile
from pathlib import Path

from rtfiles import ownership
from rtfiles.errors import UsageError


def write_bytes(path: Path, data: bytes, mode: int = 0o644) -> None:
    """Write a file under a temporary name in its folder, flush it to disk, rename it into place.

    If `path` is a link, the file behind it is written, unless the link belongs to another user. A file that is not
    regular, such as /dev/null or a pipe, is written to directly. The folder must exist. Raises OSError that names
    `path`, and then leaves no temporary file behind.
    """
    try:
        _write(path, data, mode)
    except OSError as error:
        error.filename = str(path)  # a full disk names none, and the temporary file has another
        raise


def _write(path: Path, data: bytes, mode: int) -> None:
    named = ownership.resolve(path)
    # For a link in /proc/<pid>/fd, such as /dev/stdout, the text may be a path without a file.
    if path.exists() and not named.is_file():
        with path.open("wb") as stream:
            stream.write(data)
        return
    handle, temporary = tempfile.mkstemp(dir=named.parent, prefix=f".{named.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            # By now the name may refer to somebody else's file.
            os.fchmod(stream.fileno(), mode)
            os.fsync(stream.fileno())
        Path(temporary).replace(named)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    sync_folder(named.parent)


def write_text(path: Path, text: str, mode: int = 0o644) -> None:
    """`write_bytes` of UTF-8 text."""
    write_bytes(path, text.encode("utf-8"), mode)


def write_named(path: Path, data: bytes) -> None:
    """`write_bytes` to a place that the user named.

    Raises UsageError where that is not possible, or where there is nothing to write: an empty file would pass for an
    answer.
    """
    if not data:
        raise UsageError(f"{path}: not written, because there is nothing to write")
    try:
        write_bytes(path, data)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise UsageError(f"{path}: cannot be written: {reason}") from error


def replace_link(path: Path, target: Path | str) -> None:
    """Make `path` a symbolic link to a target, replacing another link or file in one step.

    Missing parent folders are made. A link that is already right stays as it is. Raises OSError.
    """
    if path.is_symlink() and str(path.readlink()) == str(target):
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(target)
    try:
        temporary.replace(path)
    except OSError as error:
        temporary.unlink()
        error.filename = str(path)
        raise


def copy_folder(source: Path, copy: Path) -> None:
    """Copy a folder under a temporary name next to `copy`, and rename it into place; an existing `copy` stays.

    Missing parent folders are made. Raises OSError, and then leaves no temporary folder behind.
    """
    if copy.is_dir():
        return
    copy.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=copy.parent, prefix=f"{copy.name}.") as temporary:
        shutil.copytree(source, Path(temporary) / copy.name)
        (Path(temporary) / copy.name).rename(copy)
    sync_folder(copy.parent)


def sync_folder(folder: Path) -> None:
    """Make a rename in this folder survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
