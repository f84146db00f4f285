"""Files written whole or not at all."""

import os
import shutil
import tempfile
from pathlib import Path

from rtfiles import ownership
from rtfiles.errors import UsageError


def write_bytes(path: Path, data: bytes, mode: int = 0o644) -> None:
    """Write a file under a temporary name in its folder, flush it to disk, rename it into place.

    Where `path` is a link, the file that it names is written, unless the link belongs to another user. What is no
    regular file, as /dev/null or a pipe, is written to. The folder must exist. Raises OSError that names `path`, and
    leaves no temporary file behind then.
    """
    try:
        _write(path, data, mode)
    except OSError as error:
        error.filename = str(path)  # of a full disk it has none, and of the temporary file another one
        raise


def _write(path: Path, data: bytes, mode: int) -> None:
    named = ownership.resolve(path)
    # Of a link in /proc/<pid>/fd, as /dev/stdout is one, the text may be the path of no file.
    if path.exists() and not named.is_file():
        with path.open("wb") as stream:
            stream.write(data)
        return
    handle, temporary = tempfile.mkstemp(dir=named.parent, prefix=f".{named.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            # By the name it may be another's by now.
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
    """`write_bytes` to a place that the user named. Raises UsageError where that cannot be, or there is nothing to
    write: an empty file would pass for an answer."""
    if not data:
        raise UsageError(f"{path}: not written, because there is nothing to write")
    try:
        write_bytes(path, data)
    except (OSError, ValueError) as error:  # the latter for a NUL in the path
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise UsageError(f"{path}: cannot be written: {reason}") from error


def replace_link(path: Path, target: Path | str) -> None:
    """Make `path` a symbolic link to a target, in one step where another link or file is there.

    Missing folders above it are made. A link that is right already stays as it is. Raises OSError.
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
    """Copy a folder under a temporary name beside its copy, and rename it into place; one that is there stays.

    Missing folders above it are made. Raises OSError, and leaves no temporary folder behind then.
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
