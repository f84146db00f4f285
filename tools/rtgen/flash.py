"""Write an image to an SD card that nobody uses, and read it back.

`check_device` reads /sys and /proc before anything is opened for writing; `write` copies and compares. A loop device is
accepted as a card.
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
PACKED = (".bz2", ".gz", ".lz4", ".xz", ".zst", ".zip")


@dataclass(frozen=True, kw_only=True, slots=True)
class Card:
    """A device that may be written to."""

    path: Path
    name: str
    model: str
    size_bytes: int


def check_image(image: Path) -> int:
    """The size of an image in bytes. Raises UsageError if it is not that of a whole card with all its partitions."""
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
    """The byte after the last partition in an MBR; with a GPT the end of the disk, over which its one partition goes.

    An entry has 16 bytes: the type in byte 4 (0: unused), from byte 8 the first sector and the number of sectors. A GPT
    of more than 2 TiB has the largest number instead (UEFI specification 2.10, 5.2.1 and 5.2.3).
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
    number = f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}"
    node = (sys / "dev/block" / number).resolve()
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
    return Card(path=device, name=node.name, model=model or node.name, size_bytes=size)


def write(image: Path, card: Card, progress: Progress) -> str:
    """Write an image to a card, read it back, return its SHA-256. `progress` gets the step and its bytes so far.

    Raises InfrastructureError when the card fails, is used by another program, or reads back wrong, and when the image
    cannot be read.
    """
    try:
        # O_EXCL on a block device: the kernel refuses if it is mounted, and refuses to mount it while it is open.
        handle = os.open(card.path, os.O_RDWR | os.O_EXCL)
    except OSError as error:
        raise InfrastructureError(f"{card.path}: {error.strerror}") from error
    with FileIO(handle, "r+b") as device:
        try:
            written = _copy(image, device, progress)
            os.fsync(device)
            fcntl.ioctl(device, BLKFLSBUF)
            _compare(image, device, card, progress)
        except OSError as error:
            raise InfrastructureError(f"{card.path}: {error.strerror}") from error
        # A loop device without partitions refuses this; those of a card are read again when it is inserted.
        with contextlib.suppress(OSError):
            fcntl.ioctl(device, BLKRRPART)
    return written


def _chunks(image: Path) -> Iterator[bytes]:
    """The image in pieces. Errors here name the image, not the card."""
    try:
        with image.open("rb") as source:
            while chunk := source.read(CHUNK):
                yield chunk
    except OSError as error:
        raise InfrastructureError(f"{image}: {error.strerror}") from error


def _copy(image: Path, device: FileIO, progress: Progress) -> str:
    total = hashlib.sha256()
    done = 0
    for chunk in _chunks(image):
        total.update(chunk)
        view = memoryview(chunk)
        while view:
            view = view[device.write(view) :]
        done += len(chunk)
        progress("written", done)
    return total.hexdigest()


def _compare(image: Path, device: FileIO, card: Card, progress: Progress) -> None:
    device.seek(0)
    done = 0
    for chunk in _chunks(image):
        have = b""
        while len(have) < len(chunk):
            more = device.read(len(chunk) - len(have))
            if not more:
                break
            have += more
        if have != chunk:
            at = next((i for i, (a, b) in enumerate(zip(have, chunk, strict=False)) if a != b), len(have))
            raise InfrastructureError(f"{card.path}: byte {done + at} reads back wrong, the card is broken")
        done += len(chunk)
        progress("verified", done)


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
