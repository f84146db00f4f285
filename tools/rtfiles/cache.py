"""Results of slow builds, kept under the hash of all inputs.

An entry is a folder ``<root>/<kind>/<hash>``, where root is ``$META_RT_TESTS_CACHE`` or
``${XDG_CACHE_HOME:-~/.cache}/meta-rt-tests``. It appears in one rename, so an interrupted build leaves no entry. A
cache that others could change is refused (`ownership`).
"""

import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO

from rtfiles import ownership
from rtfiles.errors import UsageError


def root() -> Path:
    """The folder of all entries."""
    chosen = os.environ.get("META_RT_TESTS_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "meta-rt-tests"


def digest(parts: Iterable[str | bytes | Path]) -> str:
    """The hash of texts, bytes, files and folders (names, modes, contents) in the given order, as 16 hex digits."""
    total = hashlib.sha256()

    def add(kind: bytes, data: bytes) -> None:
        total.update(kind + str(len(data)).encode() + b":" + data)

    def add_path(path: Path, name: str) -> None:
        if path.is_symlink():
            add(b"link", f"{name} {path.readlink()}".encode())
        elif path.is_dir():
            for child in sorted(path.iterdir()):
                if child.name != "__pycache__":
                    add_path(child, f"{name}/{child.name}")
        else:
            executable = os.access(path, os.X_OK)
            add(b"file", f"{name} {executable}".encode())
            add(b"data", path.read_bytes())

    for part in parts:
        if isinstance(part, Path):
            add_path(part, part.name)
        else:
            add(b"text", part.encode() if isinstance(part, str) else part)
    return total.hexdigest()[:16]


def entry(kind: str, key: str, build: Callable[[Path], None]) -> Path:
    """Return the folder of this kind and key, built by `build(empty folder)` if it is missing.

    Two processes that want the same entry build it once. An exception in `build` is passed on and leaves nothing
    behind. A killed build leaves its folder, which the next build of any entry removes.
    """
    folder = root() / kind
    ownership.make_folder(folder)
    final = folder / key
    if final.is_dir():
        ownership.make_folder(final)  # it may have been put there while others could write to the folder
        return final
    _remove_leftovers()
    with locked(kind, key):
        if final.is_dir():
            return final
        work = Path(tempfile.mkdtemp(dir=folder, prefix=f".{key}.tmp-"))
        try:
            work.chmod(0o755)
            build(work)
            work.rename(final)
        except BaseException:
            shutil.rmtree(work, ignore_errors=True)
            raise
    return final


@contextlib.contextmanager
def locked(kind: str, name: str) -> Iterator[None]:
    """Hold the lock with this name and kind; other processes wait for it meanwhile."""
    folder = root() / kind
    ownership.make_folder(folder)
    with _open_lock(folder, name) as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _open_lock(folder: Path, name: str) -> IO[bytes]:
    """Open a lock file without changing its contents.

    The file may have been put there while others could write to the folder. A link is refused, and a hard link to any
    other file keeps its contents.
    """
    path = folder / f".{name}.lock"
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise UsageError(f"{path}: is a link, and no lock of ours: remove it") from error
    return os.fdopen(handle, "rb+", buffering=0)


def _remove_leftovers() -> None:
    """Remove the folders of killed builds, whose lock is free. Folders that others could have put there stay."""
    for leftover in root().glob("*/.*.tmp-*"):
        key = leftover.name.removeprefix(".").partition(".tmp-")[0]
        with contextlib.suppress(BlockingIOError, UsageError):
            ownership.make_folder(leftover.parent)
            with _open_lock(leftover.parent, key) as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(leftover, ignore_errors=True)
