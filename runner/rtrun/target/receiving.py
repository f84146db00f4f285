"""A file that comes from a target: the command that prints it, plain or compressed, and what is made of that here."""

import hashlib
import re
import time
import zlib
from pathlib import Path, PurePosixPath
from typing import IO

from rtfiles.errors import InfrastructureError
from rtrun.target.address import Address, ThisMachine
from rtrun.target.errors import TargetError
from rtrun.target.shell import CHUNK_BYTES, Shell

# Below, a file is there before it is known whether compressing pays: 0.3 s at 100 Mbit/s.
LARGE_BYTES = 4 * 1024 * 1024
# Of the first large file, to measure with.
_HEAD_BYTES = 2 * 1024 * 1024
HEAD_S = 60.0
# A link that is faster is not the bound: no board's processor compresses samples by gzip at this rate.
_FAST_RATE = 50e6  # bytes/s
# The checksum is made while the file is on its way. It is for accidents on both disks: SSH guards the way, and whoever
# can change the file can change its checksum. So MD5 will do: SHA-256 takes a target several times as long.
_READ = 'md5sum <"$1" >&2 & cat <"$1" && wait $!'
_READ_COMPRESSED = 'md5sum <"$1" >&2 & gzip -1 <"$1" && wait $!'
_GZIP = zlib.MAX_WBITS | 16


def reading(source: PurePosixPath, is_compressed: bool) -> list[str]:
    """The command that prints a file to standard output and its MD5 to standard error."""
    return ["sh", "-c", _READ_COMPRESSED if is_compressed else _READ, "sh", str(source)]


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
    """Writes what arrives of a file into its copy. What the target sends is not trusted."""

    def __init__(
        self, address: Address | ThisMachine, source: PurePosixPath, destination: IO[bytes], limit_bytes: int
    ) -> None:
        self._what = f"{address}: {source}"
        self._destination = destination
        self._limit_bytes = limit_bytes
        self._size_bytes = 0
        self._digest = hashlib.md5(usedforsecurity=False)
        self._inflation = zlib.decompressobj(_GZIP)

    def take(self, chunk: bytes) -> None:
        """Write a piece of the file. Raises TargetError when it gets larger than believable, InfrastructureError."""
        self._size_bytes += len(chunk)
        if self._size_bytes > self._limit_bytes:
            raise TargetError(f"{self._what} has more than the {self._limit_bytes} bytes that were expected")
        self._digest.update(chunk)
        try:
            self._destination.write(chunk)
        except OSError as error:
            raise InfrastructureError(f"{Path(self._destination.name)}: {error.strerror or error}") from error

    def take_compressed(self, chunk: bytes) -> None:
        """Write what a piece of the compressed file holds, however much that is, in pieces. Raises as `take`."""
        try:
            while chunk:
                self.take(self._inflation.decompress(chunk, CHUNK_BYTES))
                chunk = self._inflation.unconsumed_tail
        except zlib.error as error:
            raise TargetError(f"{self._what} arrived damaged: {error}") from error

    def check(self, stderr: str) -> None:
        """Raise TargetError unless what arrived has the MD5 that the target printed."""
        self.take(self._inflation.flush())
        printed = re.search(r"^([0-9a-f]{32}) ", stderr, re.MULTILINE)
        if printed is None or printed[1] != self._digest.hexdigest():
            raise TargetError(f"{self._what} arrived damaged: its checksum differs")
