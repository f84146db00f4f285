"""Files that come from a target: as they are there, compressed where the wire is slow, never larger than believable."""

import gzip
import hashlib
import random
from dataclasses import replace
from pathlib import PurePosixPath

import pytest
from proxy import proxy_to

from rtrun.targets import receiving
from rtrun.targets.address import ThisMachine
from rtrun.targets.connection import Connection
from rtrun.targets.errors import TargetError
from rtrun.targets.receiving import Receiver, is_faster_compressed

SOURCE = PurePosixPath("/run/samples.npy")
BLOCK = random.Random(1).randbytes(1024) + bytes(3 * 1024)  # gzip makes a quarter of it


@pytest.mark.sshd
@pytest.mark.parametrize("is_slow", [True, False])
def test_large_files_arrive_whole_and_over_a_slow_wire_compressed(sshd, tmp_path, monkeypatch, is_slow):
    contents = {"a.json": b"{}", "empty": b"", "samples.npy": BLOCK * 1500, "z": b"z" * 100_000}
    for folder in ("there", "here"):
        (tmp_path / folder).mkdir()
    for name, data in contents.items():
        (tmp_path / "there" / name).write_bytes(data)
    sizes = {name: len(data) for name, data in contents.items()}
    monkeypatch.setattr(receiving, "_FAST_RATE", 50e6 if is_slow else 0.0)
    with proxy_to(sshd.port) as wire:
        wire.bytes_per_s = 1.5e6 if is_slow else None
        connection = Connection(replace(sshd.address, port=wire.port))
        connection.download(PurePosixPath(tmp_path / "there"), sizes, tmp_path / "here")
        connection.close()
    assert {path.name: path.read_bytes() for path in (tmp_path / "here").iterdir()} == contents
    assert (wire.total_bytes < sizes["samples.npy"]) is is_slow


class Wire:
    """A shell whose commands take so many seconds by a clock of its own: plain ones, and those with gzip."""

    def __init__(self, monkeypatch, plain_s, gzip_s, gzip_status=0):
        self.now_s, self.commands = 0.0, 0
        self.plain, self.gzip = (plain_s, 0), (gzip_s, gzip_status)
        monkeypatch.setattr(receiving.time, "monotonic", lambda: self.now_s)

    def execute(self, argv, stdin, take, deadline_s):
        seconds, status = self.gzip if "gzip" in " ".join(argv) else self.plain
        piece = BLOCK * (int(argv[-1]) // len(BLOCK))
        if status == 0:
            take(gzip.compress(piece) if "gzip" in " ".join(argv) else piece)
        self.now_s += seconds
        self.commands += 1
        return status, ""


@pytest.mark.parametrize(
    ("plain_s", "gzip_s", "status", "compressed", "commands"),
    [
        (0.2, 0.1, 0, True, 2),  # 10 MB/s, and a processor that compresses 20 MB/s
        (0.2, 0.4, 0, False, 2),  # a processor that is slower than the wire
        (0.2, 0.01, 127, False, 2),  # no gzip there
        (0.02, 0.01, 0, False, 1),  # 105 MB/s: gzip is not asked
    ],
)
def test_what_is_measured_decides(tmp_path, monkeypatch, plain_s, gzip_s, status, compressed, commands):
    wire = Wire(monkeypatch, plain_s, gzip_s, status)
    files = receiver(tmp_path, samples=receiving.LARGE_BYTES)
    assert is_faster_compressed(wire, SOURCE, files) is compressed
    assert wire.commands == commands
    # What was measured with needs not come again.
    assert files.received_bytes == (commands - (status != 0)) * receiving.LARGE_BYTES // 2


def test_small_files_are_measured_by_nobody(tmp_path):
    (tmp_path / "x").write_bytes(b"x")
    (tmp_path / "here").mkdir()
    connection = Connection(ThisMachine())
    connection.download(PurePosixPath(tmp_path), {"x": 1}, tmp_path / "here")
    assert connection._is_compressing is None
    assert (tmp_path / "here" / "x").read_bytes() == b"x"


def receiver(folder, **sizes):
    return Receiver(ThisMachine(), PurePosixPath("/run"), sizes, folder)


def printed(**contents):
    digests = {name: hashlib.md5(data).hexdigest() for name, data in contents.items()}
    return "sh: a warning\n" + "".join(f"{digest}  {name}\n" for name, digest in digests.items())


@pytest.mark.parametrize("piece", [1, 100, 1_000_000])
@pytest.mark.parametrize("is_compressed", [False, True])
def test_what_arrives_is_cut_into_files(tmp_path, piece, is_compressed):
    contents = {"first": BLOCK, "empty": b"", "second": BLOCK[:100]}
    files = receiver(tmp_path, **{name: len(data) for name, data in contents.items()})
    data = b"".join(contents.values())
    for part in (data[:2000], data[2000:]):
        # What two commands print.
        part, take = (gzip.compress(part), files.take_compressed) if is_compressed else (part, files.take)
        for start in range(0, len(part), piece):
            take(part[start : start + piece])
    files.check(printed(**contents))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == contents


def test_a_small_stream_that_becomes_huge_is_refused(tmp_path):
    files = receiver(tmp_path, samples=100_000)
    with pytest.raises(TargetError, match="/run: more than the 100000 bytes that were expected arrived"):
        files.take_compressed(gzip.compress(bytes(100_000_000)))
    assert (tmp_path / "samples").stat().st_size <= 100_000


@pytest.mark.parametrize(
    "data",
    [gzip.compress(BLOCK)[:-2000], gzip.compress(BLOCK) + b"more", b"no gzip at all"],
    ids=["cut off", "something behind it", "no gzip"],
)
def test_a_damaged_stream_is_refused(tmp_path, data):
    files = receiver(tmp_path, samples=len(BLOCK))
    with pytest.raises(TargetError, match="arrived damaged"):
        files.take_compressed(data)
        files.check(printed(samples=BLOCK))


@pytest.mark.parametrize("stderr", [printed(samples=b"other"), printed(other=BLOCK), "", "md5sum: not found\n"])
def test_another_checksum_is_refused(tmp_path, stderr):
    files = receiver(tmp_path, samples=len(BLOCK))
    files.take(BLOCK)
    with pytest.raises(TargetError, match="/run/samples arrived damaged: its checksum differs"):
        files.check(stderr)


def test_less_than_was_told_is_refused(tmp_path):
    files = receiver(tmp_path, samples=len(BLOCK))
    files.take(BLOCK[:-1])
    with pytest.raises(TargetError, match="arrived damaged"):
        files.check(printed(samples=BLOCK))
