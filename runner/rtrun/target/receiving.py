"""Files that come from a target: the command that prints them, plain or compressed, and what is made of that here."""

import contextlib
import hashlib
import re
import time
import zlib
from collections.abc import Generator, Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from rtfiles.errors import InfrastructureError
from rtrun.target.address import Address, ThisMachine
from rtrun.target.errors import TargetError
from rtrun.target.shell import CHUNK_BYTES, Shell

# Below, everything is there before it is known whether compressing pays: 0.3 s at 100 Mbit/s.
LARGE_BYTES = 4 * 1024 * 1024
# Of a large file, to measure with.
_HEAD_BYTES = 2 * 1024 * 1024
HEAD_S = 60.0
# A link that is faster is not the bound: no board's processor compresses samples by gzip at this rate.
_FAST_RATE = 50e6  # bytes/s
# The checksums are made while the files are on their way. They are for accidents on both disks: SSH guards the way, and
# whoever can change a file can change its checksum. So MD5 will do: SHA-256 takes a target several times as long.
_READ = 'cd "$1" && shift || exit 1; md5sum -- "$@" >&2 & cat -- "$@" && wait $!'
_READ_COMPRESSED = 'cd "$1" && shift || exit 1; md5sum -- "$@" >&2 & cat -- "$@" | gzip -1 && wait $!'
_GZIP = zlib.MAX_WBITS | 16


def reading(folder: PurePosixPath, names: Iterable[str], *, is_compressed: bool) -> list[str]:
    """The command that prints files one after the other to standard output, and their MD5 to standard error."""
    return ["sh", "-c", _READ_COMPRESSED if is_compressed else _READ, "sh", str(folder), *names]


def is_faster_compressed(shell: Shell, source: PurePosixPath) -> bool:
    """Whether the head of a file arrives sooner compressed than plain; not where the target has no gzip."""
    plain_bytes_per_s = _rate(shell, ["head", "-c", str(_HEAD_BYTES), str(source)])
    if plain_bytes_per_s > _FAST_RATE:
        return False
    script = 'head -c "$2" "$1" | gzip -1'
    return _rate(shell, ["sh", "-c", script, "sh", str(source), str(_HEAD_BYTES)]) > plain_bytes_per_s


def _rate(shell: Shell, command: list[str]) -> float:
    """Bytes of the file's head that arrive in a second by this command; 0 where it fails."""
    start = time.monotonic()
    status, _ = shell.execute(command, [], lambda _: None, HEAD_S)
    return 0.0 if status else _HEAD_BYTES / (time.monotonic() - start)


class Receiver:
    """Writes what arrives into copies of files, one after the other. What the target sends is not trusted.

    `sizes` are those of the files on the target by name, in the order in which they arrive.
    """

    def __init__(
        self, address: Address | ThisMachine, folder: PurePosixPath, sizes: Mapping[str, int], destination: Path
    ) -> None:
        self._what = f"{address}: {folder}"
        self._sizes, self._destination = sizes, destination
        self._missing_bytes = sum(sizes.values())
        self._digests = {name: hashlib.md5(usedforsecurity=False) for name in sizes}
        self._inflation = zlib.decompressobj(_GZIP)
        self._writer = self._writing()
        next(self._writer)

    def take(self, chunk: bytes) -> None:
        """Write what is next. Raises TargetError when it is more than the files have, InfrastructureError."""
        self._missing_bytes -= len(chunk)
        if self._missing_bytes < 0:
            total = sum(self._sizes.values())
            raise TargetError(f"{self._what}: more than the {total} bytes that were expected arrived")
        if chunk:
            self._writer.send(chunk)

    def _writing(self) -> Generator[None, bytes, None]:
        """Cut the chunks that are sent to it into files."""
        rest = b""
        for name, size_bytes in self._sizes.items():
            path, remaining_bytes = self._destination / name, size_bytes
            with local_file(path), path.open("wb") as stream:
                while remaining_bytes:
                    rest = rest or (yield)
                    piece, rest = rest[:remaining_bytes], rest[remaining_bytes:]
                    remaining_bytes -= len(piece)
                    self._digests[name].update(piece)
                    stream.write(piece)
        yield

    def take_compressed(self, chunk: bytes) -> None:
        """Write what a piece of the compressed files holds, however much that is, in pieces. Raises as `take`."""
        try:
            while chunk:
                self.take(self._inflation.decompress(chunk, CHUNK_BYTES))
                chunk = self._inflation.unconsumed_tail
        except zlib.error as error:
            raise TargetError(f"{self._what} arrived damaged: {error}") from error

    def check(self, stderr: str) -> None:
        """Raise TargetError unless what arrived has the checksums that the target printed."""
        self.take(self._inflation.flush())
        self._writer.close()
        printed = {name: digest for digest, name in re.findall(r"^([0-9a-f]{32})  (.+)$", stderr, re.MULTILINE)}
        for name, digest in self._digests.items():
            if printed.get(name) != digest.hexdigest():
                raise TargetError(f"{self._what}/{name} arrived damaged: its checksum differs")


@contextlib.contextmanager
def local_file(path: Path) -> Iterator[None]:
    """A failure of a file of this machine is not one of the target."""
    try:
        yield
    except OSError as error:
        raise InfrastructureError(f"{path}: {error.strerror or error}") from error
