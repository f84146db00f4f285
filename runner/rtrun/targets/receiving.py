"""Receive files from a target: the command that prints them, plain or compressed, and the copies made here."""

import contextlib
import hashlib
import re
import time
import zlib
from collections.abc import Generator, Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from rtfiles.errors import InfrastructureError
from rtrun.targets.address import Address, ThisMachine
from rtrun.targets.errors import TargetError
from rtrun.targets.shell import CHUNK_BYTES, Shell

# Smaller files arrive before a measurement could show whether compressing pays: 0.3 s at 100 Mbit/s.
LARGE_BYTES = 4 * 1024 * 1024
# Two pieces of a large file are used to measure: its beginning plain, then as much compressed.
_PIECE_BYTES = 2 * 1024 * 1024
PIECE_S = 60.0  #: each of the first two pieces of a large file, which decide whether to compress
# A faster link is not the bottleneck: no board's processor compresses samples by gzip at this rate.
_FAST_RATE = 50e6  # bytes/s
# Compressing must be this much faster: the plain piece is slowed by the start of the connection, and a small gain is
# not worth the target's processor time.
_WORTH = 1.25
# The checksums are made while the files are sent. They detect accidents on both disks: SSH protects the transfer, and
# an attacker who can change a file can change its checksum. So MD5 is enough; SHA-256 takes a target several times as
# long.
_READ = """
cd "$1" || exit 1
from=$2
shift 2
md5sum -- "$@" >&2 &
first=$1
shift
{ tail -c "+$from" -- "$first" && cat -- /dev/null "$@"; }%s && wait $!
"""
_READ_PIECE = 'tail -c "+$2" -- "$1" | head -c "$3"'
_COMPRESSED = " | gzip -1"
_GZIP = zlib.MAX_WBITS | 16


def reading(folder: PurePosixPath, names: Iterable[str], *, skip_bytes: int, is_compressed: bool) -> list[str]:
    """The command that prints files one after the other to standard output, and their MD5 to standard error.

    The first `skip_bytes` bytes of the first file are not printed.
    """
    script = _READ % (_COMPRESSED if is_compressed else "")
    return ["sh", "-c", script, "sh", str(folder), str(skip_bytes + 1), *names]


def is_faster_compressed(shell: Shell, source: PurePosixPath, receiver: "Receiver") -> bool:
    """Whether a file arrives sooner compressed than plain; False if the target has no gzip.

    This is measured with the file's first pieces, which go to the receiver. The file has at least LARGE_BYTES.
    """
    plain_bytes_per_s = _rate(shell, source, receiver, is_compressed=False)
    if plain_bytes_per_s > _FAST_RATE:
        return False
    return _rate(shell, source, receiver, is_compressed=True) > _WORTH * plain_bytes_per_s


def _rate(shell: Shell, source: PurePosixPath, receiver: "Receiver", *, is_compressed: bool) -> float:
    """Bytes per second at which the file's next piece arrives; 0 if the command fails."""
    script = _READ_PIECE + _COMPRESSED if is_compressed else _READ_PIECE
    take = receiver.take_compressed if is_compressed else receiver.take
    argv = ["sh", "-c", script, "sh", str(source), str(receiver.received_bytes + 1), str(_PIECE_BYTES)]
    start = time.monotonic()
    status, _ = shell.execute(argv, [], take, PIECE_S)
    return 0.0 if status else _PIECE_BYTES / (time.monotonic() - start)


class Receiver:
    """Writes what arrives into copies of files, one after the other. What the target sends is not trusted.

    `sizes` are those of the files on the target by name, in the order in which they arrive.
    """

    def __init__(
        self, address: Address | ThisMachine, folder: PurePosixPath, sizes: Mapping[str, int], destination: Path
    ) -> None:
        self._what = f"{address}: {folder}"
        self._sizes, self._destination = sizes, destination
        self.received_bytes = 0
        """Bytes of all files, as they are on the target (not compressed)."""
        self._total_bytes = sum(sizes.values())
        self._digests = {name: hashlib.md5(usedforsecurity=False) for name in sizes}
        self._inflation = zlib.decompressobj(_GZIP)
        self._writer = self._writing()
        next(self._writer)

    def take(self, chunk: bytes) -> None:
        """Write the next bytes. Raises TargetError when there are more than the files have, InfrastructureError."""
        self.received_bytes += len(chunk)
        if self.received_bytes > self._total_bytes:
            raise TargetError(f"{self._what}: more than the {self._total_bytes} bytes that were expected arrived")
        if chunk:
            self._writer.send(chunk)

    def _writing(self) -> Generator[None, bytes, None]:
        """Split the chunks that are sent to it into files."""
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
        """Decompress a chunk and write the content in pieces, however much it is. Raises as `take`."""
        try:
            if chunk and self._inflation.eof:
                # Each command prints a stream of its own.
                self._inflation = zlib.decompressobj(_GZIP)
            while chunk:
                self.take(self._inflation.decompress(chunk, CHUNK_BYTES))
                chunk = self._inflation.unconsumed_tail
            if self._inflation.unused_data:
                raise zlib.error("more follows the end of the stream")
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
    """Report a failure of a file on this machine as such, not as one of the target."""
    try:
        yield
    except OSError as error:
        raise InfrastructureError(f"{path}: {error.strerror or error}") from error
