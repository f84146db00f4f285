"""Files that come from a target: as they are there, compressed where the wire is slow, never larger than believable."""

import gzip
import hashlib
import io
import os
from dataclasses import replace
from pathlib import PurePosixPath

import pytest
from proxy import proxy_to

from rtrun.target import receiving
from rtrun.target.address import ThisMachine
from rtrun.target.connection import Connection
from rtrun.target.errors import TargetError
from rtrun.target.receiving import LARGE_BYTES, Receiver, is_faster_compressed

SOURCE = PurePosixPath("/run/samples.npy")
BLOCK = os.urandom(1024) + bytes(3 * 1024)  # gzip makes a quarter of it


@pytest.mark.sshd
@pytest.mark.parametrize("is_slow", [True, False])
def test_a_large_file_arrives_whole_and_over_a_slow_wire_compressed(sshd, tmp_path, monkeypatch, is_slow):
    samples = BLOCK * 1500
    (tmp_path / "there").write_bytes(samples)
    monkeypatch.setattr(receiving, "_FAST_RATE", 50e6 if is_slow else 0.0)
    with proxy_to(sshd.port) as wire, (tmp_path / "here").open("wb") as stream:
        wire.bytes_per_s = 1.5e6 if is_slow else None
        connection = Connection(replace(sshd.address, port=wire.port))
        connection.download(
            PurePosixPath(tmp_path / "there"), stream, size_bytes=len(samples), limit_bytes=len(samples)
        )
        connection.close()
    assert (tmp_path / "here").read_bytes() == samples
    assert (wire.total_bytes < len(samples)) is is_slow


class Wire:
    """A shell whose commands take so many seconds by a clock of its own: plain ones, and those with gzip."""

    def __init__(self, monkeypatch, plain_s, gzip_s, gzip_status=0):
        self.now_s, self.commands = 0.0, 0
        self.plain, self.gzip = (plain_s, 0), (gzip_s, gzip_status)
        monkeypatch.setattr(receiving.time, "monotonic", lambda: self.now_s)

    def execute(self, argv, stdin, take, deadline_s):
        seconds, status = self.gzip if "gzip" in " ".join(argv) else self.plain
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
def test_what_is_measured_decides(monkeypatch, plain_s, gzip_s, status, compressed, commands):
    wire = Wire(monkeypatch, plain_s, gzip_s, status)
    assert is_faster_compressed(wire, SOURCE) is compressed
    assert wire.commands == commands


def test_a_small_file_is_measured_by_nobody(tmp_path):
    (tmp_path / "there").write_bytes(b"x")
    connection = Connection(ThisMachine())
    connection.download(PurePosixPath(tmp_path / "there"), io.BytesIO(), size_bytes=LARGE_BYTES - 1, limit_bytes=1)
    assert connection._is_compressing is None


def receiver(limit_bytes):
    stream = io.BytesIO()
    return Receiver(ThisMachine(), SOURCE, stream, limit_bytes), stream


def printed(data):
    return f"sh: a warning\n{hashlib.md5(data).hexdigest()}  -\n"


@pytest.mark.parametrize("piece", [1, 100, 1_000_000])
def test_what_was_compressed_is_as_before(piece):
    receiving_, stream = receiver(len(BLOCK))
    data = gzip.compress(BLOCK)
    for start in range(0, len(data), piece):
        receiving_.take_compressed(data[start : start + piece])
    receiving_.check(printed(BLOCK))
    assert stream.getvalue() == BLOCK


def test_a_small_stream_that_becomes_huge_is_refused():
    receiving_, stream = receiver(100_000)
    with pytest.raises(TargetError, match=r"samples\.npy has more than the 100000 bytes that were expected"):
        receiving_.take_compressed(gzip.compress(bytes(100_000_000)))
    assert len(stream.getvalue()) <= 100_000


@pytest.mark.parametrize("data", [gzip.compress(BLOCK)[:-2000], b"no gzip at all"])
def test_a_damaged_stream_is_refused(data):
    receiving_, _ = receiver(len(BLOCK))
    with pytest.raises(TargetError, match=r"samples\.npy arrived damaged"):
        receiving_.take_compressed(data)
        receiving_.check(printed(BLOCK))


@pytest.mark.parametrize("stderr", [printed(b"other"), "", "md5sum: not found\n"])
def test_another_checksum_is_refused(stderr):
    receiving_, _ = receiver(len(BLOCK))
    receiving_.take(BLOCK)
    with pytest.raises(TargetError, match="arrived damaged: its checksum differs"):
        receiving_.check(stderr)
