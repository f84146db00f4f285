"""How long the runner takes to pull 64 MiB, in the time that OpenSSH's scp takes for the same file, over loopback.

`make bench` runs it; it is no test. Both connect, log in and copy, in turn, so that the machine is as fast for one as
for the other. The file is of random bytes: no compression helps.
"""

import contextlib
import os
import statistics
import subprocess
import time
from pathlib import Path, PurePosixPath

import pytest

from rtrun.target.connection import Connection

SIZE_BYTES = 64 * 1024 * 1024
ROUNDS = 9
# Of scp's time.
LIMIT = 1.0

pytestmark = pytest.mark.timeout(0)


def scp(sshd, source: Path, destination: Path) -> None:
    options = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR", "BatchMode=yes"]
    words = [word for option in options for word in ("-o", option)]
    login = ["-F", "none", *words, "-i", sshd.key, "-P", str(sshd.port)]
    # By scp's own protocol: the server of the tests has no SFTP.
    subprocess.run(["scp", "-O", "-q", *login, f"{sshd.user}@127.0.0.1:{source}", destination], check=True)


def test_pulling(sshd, tmp_path):
    source = tmp_path / "samples.npy"
    source.write_bytes(os.urandom(SIZE_BYTES))

    def pull(folder: Path) -> None:
        with contextlib.closing(Connection(sshd.address)) as connection:
            connection.download(PurePosixPath(tmp_path), {source.name: SIZE_BYTES}, folder)

    ways = {"rtrun": pull, "scp": lambda folder: scp(sshd, source, folder)}
    taken_s: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, way in ways.items():
            folder = tmp_path / name
            folder.mkdir(exist_ok=True)
            start = time.monotonic()
            way(folder)
            taken_s[name].append(time.monotonic() - start)
            copy = folder / source.name
            assert copy.stat().st_size == SIZE_BYTES
            copy.unlink()
    medians_s = {name: statistics.median(times) for name, times in taken_s.items()}
    rates = ", ".join(f"{name} {SIZE_BYTES / 1e6 / median:.0f} MB/s" for name, median in medians_s.items())
    ratio = medians_s["rtrun"] / medians_s["scp"]
    print(f"\n64 MiB over loopback: {rates}; {ratio:.2f} of scp's time (limit {LIMIT:g}; medians of {ROUNDS})")
    assert ratio <= LIMIT
