"""Write an image to an unused SD card, and read it back.

`check_device` reads /sys and /proc before anything is opened for writing; `write` copies and compares. A loop device
counts as a card.
"""

import contextlib
import fcntl
import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from rtfiles.errors import InfrastructureError, UsageError

CHUNK = 4 * 1024 * 1024
SECTOR = 512
BLKFLSBUF = 0x1261  # linux/fs.h: drop the cached content of a device, so that reading back reads the card
BLKRRPART = 0x125F  # linux/fs.h: read the partition table again
Progress = Callable[[str, int], None]
Chunk = tuple[int, bytes]  # the size of a piece in bytes, its SHA-256
PACKED = (".bz2", ".gz", ".lz4", ".xz", ".zst", ".zip")


@dataclass(frozen=True, kw_only=True, slots=True)
class Card:
    """A device that may be written to.

    `sequence` is the kernel's number of this card: another card in the same reader, or with the same name, has another
    number. It is empty before Linux 5.15.
    """

    path: Path
    name: str
    model: str
    size_bytes: int
    sequence: str


def check_image(image: Path) -> int:
    """The size of an image in bytes. Raises UsageError if it is not a whole card with all its partitions."""
    if image.suffix in PACKED:
        raise UsageError(f"{image}: packed, unpack it first: give the .wic file")
    try:
        if not stat.S_ISREG(image.stat().st_mode):
            raise UsageError(f"{image}: not a file")
        with image.open("rb") as stream:
            head = stream.read(SECTOR)
    except OSError as error:
        raise UsageError(f"{image}: {error.strerror}") from error
    if len(head) < SECTOR or head[510:512] != b"\x55\xaa":
        raise UsageError(f"{image}: no partition table in it, give the .wic file of the image")
    size: int = image.stat().st_size
    needed = partitions_end(head)
    if needed > size:
        raise UsageError(
            f"{image}: cut short: its partitions need {needed} bytes, the file has {size}: unpack or copy it again"
        )
    return size


def partitions_end(head: bytes) -> int:
    """The byte after the last partition in an MBR; with a GPT the end of the disk, which its one partition covers.

    An entry has 16 bytes: the type in byte 4 (0: unused), from byte 8 the first sector and the number of sectors. For a
    GPT of more than 2 TiB, that is the largest number (UEFI specification 2.10, 5.2.1 and 5.2.3).
    """
    entries = [head[at : at + 16] for at in range(446, 510, 16)]
    extents = [
        (int.from_bytes(entry[8:12], "little"), int.from_bytes(entry[12:], "little"), entry[4]) for entry in entries
    ]
    return max((start + count for start, count, kind in extents if kind and count < 2**32 - 1), default=0) * SECTOR


def check_device(device: Path, image_bytes: int, sys: Path = Path("/sys"), proc: Path = Path("/proc")) -> Card:
    """The card of a device. Raises UsageError if it is not a whole, removable, unused disk that is large enough."""
    try:
        device = device.resolve(strict=True)
        status = device.stat()
    except OSError as error:
        raise UsageError(f"{device}: {error.strerror}") from error
    if not stat.S_ISBLK(status.st_mode):
        raise UsageError(f"{device}: not a block device, give that of the card, e.g. /dev/sdX or /dev/mmcblkN")
    node = _node(status, sys)
    if (node / "partition").exists():
        raise UsageError(f"{device}: a partition, give the whole card: /dev/{node.parent.name}")
    parts = [node, *(part.parent for part in node.glob("*/partition"))]
    for part in parts:
        users = _users(part, proc)
        if users:
            raise UsageError(f"{device}: in use: /dev/{part.name} is {users[0]}")
    if _read(node / "ro") == "1":
        raise UsageError(f"{device}: write-protected, check the switch on the card")
    # Linux does not mark a card in a built-in reader as removable; the mmc driver reports its type.
    removable = _read(node / "removable") == "1" or _read(node / "device/type") == "SD" or (node / "loop").is_dir()
    if not removable:
        raise UsageError(f"{device}: not removable, so not an SD card")
    size = int(_read(node / "size") or 0) * SECTOR
    if size == 0:
        raise UsageError(f"{device}: there is no card in it")
    if size < image_bytes:
        raise UsageError(f"{device}: too small: {size} bytes, the image needs {image_bytes} bytes")
    model = " ".join(
        filter(None, (_read(node / "device/vendor"), _read(node / "device/model"), _read(node / "device/name")))
    )
    return Card(
        path=device, name=node.name, model=model or node.name, size_bytes=size, sequence=_read(node / "diskseq")
    )


def write(image: Path, size_bytes: int, card: Card, progress: Progress) -> str:
    """Write an image of `size_bytes` to a card, read it back, return its SHA-256.

    `progress` gets the step and its bytes. Raises InfrastructureError when the card fails, is in use, is not the one
    that was checked, or reads back wrong, and when the image cannot be read or has another size.
    """
    try:
        # O_EXCL on a block device: the kernel refuses if it is mounted, and refuses to mount it while it is open.
        handle = os.open(card.path, os.O_RDWR | os.O_EXCL)
    except OSError as error:
        raise InfrastructureError(f"{card.path}: {error.strerror}") from error
    with FileIO(handle, "r+b") as device:
        # The user was asked since the check, and may have changed cards.
        if _read(_node(os.fstat(handle), Path("/sys")) / "diskseq") != card.sequence:
            raise InfrastructureError(f"{card.path}: another device than the one that was checked: nothing was written")
        try:
            chunks = _copy(image, size_bytes, device, progress)
            os.fsync(device)
            fcntl.ioctl(device, BLKFLSBUF)
            written = _compare(chunks, device, card, progress)
        except OSError as error:
            raise InfrastructureError(f"{card.path}: {error.strerror}") from error
        # A loop device without partitions refuses this; a card's partitions are read again when it is inserted.
        with contextlib.suppress(OSError):
            fcntl.ioctl(device, BLKRRPART)
    return written


def _node(status: os.stat_result, sys: Path) -> Path:
    """The folder of a block device in /sys."""
    return (sys / "dev/block" / f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}").resolve()


def _chunks(image: Path) -> Iterator[bytes]:
    """The image in pieces. Errors here name the image, not the card."""
    try:
        with image.open("rb") as source:
            while chunk := source.read(CHUNK):
                yield chunk
    except OSError as error:
        raise InfrastructureError(f"{image}: {error.strerror}") from error


def _copy(image: Path, size_bytes: int, device: FileIO, progress: Progress) -> list[Chunk]:
    """Write the image; return its chunks. It is read only once, because a build may replace it meanwhile."""
    chunks: list[Chunk] = []
    done = 0
    for chunk in _chunks(image):
        chunks.append((len(chunk), hashlib.sha256(chunk).digest()))
        done += len(chunk)
        if done > size_bytes:
            break
        view = memoryview(chunk)
        while view:
            view = view[device.write(view) :]
        progress("written", done)
    if done != size_bytes:
        raise InfrastructureError(f"{image}: changed while it was written, the card has a part of it: write it again")
    return chunks


def _compare(chunks: list[Chunk], device: FileIO, card: Card, progress: Progress) -> str:
    """Read the card back; return the SHA-256 of everything that was written."""
    device.seek(0)
    total = hashlib.sha256()
    done = 0
    for size, digest in chunks:
        have = b""
        while len(have) < size:
            more = device.read(size - len(have))
            if not more:
                break
            have += more
        if hashlib.sha256(have).digest() != digest:
            where = f"bytes {done} to {done + size - 1}"
            raise InfrastructureError(f"{card.path}: {where} read back otherwise than written, the card is broken")
        total.update(have)
        done += size
        progress("verified", done)
    return total.hexdigest()


def _users(node: Path, proc: Path) -> list[str]:
    """The uses of a disk or partition: mounts, swap, device mapper and the like."""
    number = _read(node / "dev")
    users = []
    for line in (proc / "self/mountinfo").read_text().splitlines():
        fields = line.split()
        if fields[2] == number:
            users.append(f"mounted on {fields[4]}")
    users += [
        f"swap ({line.split()[0]})" for line in _lines(proc / "swaps")[1:] if line.split()[0] == f"/dev/{node.name}"
    ]
    holders = node / "holders"
    if holders.is_dir():
        users += [f"part of {holder.name}" for holder in sorted(holders.iterdir())]
    return users


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def _read(path: Path) -> str:
    return path.read_text().strip() if path.is_file() else ""
