"""How long the runner takes to pull 64 MiB, in the time that OpenSSH's scp takes for the same file.

`make bench` runs it; it is no test. Over loopback, and over a link of 100 Mbit/s into a network namespace where the SSH
server is alone. Both connect, log in and copy, in turn, so that the machine is as fast for one as for the other. The
file is of random bytes: no compression helps.
"""

import contextlib
import ctypes
import filecmp
import os
import statistics
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO

import pytest

from conftest import Sshd, serve
from rtrun.targets.connection import Connection

SIZE_BYTES = 64 * 1024 * 1024
ROUNDS = 9
NEAR, FAR = "198.18.0.1", "198.18.0.2"
RATE = "100mbit"

pytestmark = pytest.mark.timeout(0)


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


@contextlib.contextmanager
def network(name: str) -> Iterator[None]:
    """Let this thread, and all that it starts, be in the network namespace of that name."""
    libc = ctypes.CDLL(None, use_errno=True)
    with Path("/proc/thread-self/ns/net").open() as before, Path("/run/netns", name).open() as inside:

        def enter(namespace: IO[str]) -> None:
            if libc.setns(namespace.fileno(), 0) != 0:
                raise OSError(ctypes.get_errno(), f"cannot enter the network namespace {name}")

        enter(inside)
        try:
            yield
        finally:
            enter(before)


@contextlib.contextmanager
def slow_link(folder: Path) -> Iterator[Sshd]:
    """Be in a network namespace with an SSH server behind a link, at whose end it sends at RATE. Skips where it cannot.

    The network of this machine, which may use the same addresses, is left as it is.
    """
    near, far = (f"pulling-{os.getpid()}-{end}" for end in ("near", "far"))
    with contextlib.ExitStack() as stack:
        for name in (near, far):
            if subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False).returncode != 0:
                pytest.skip("this user may not make network namespaces")
            stack.callback(ip, "netns", "delete", name)
        ip("-netns", near, "link", "add", "wire", "type", "veth", "peer", "name", "wire", "netns", far)
        for name, address in ((near, NEAR), (far, FAR)):
            ip("-netns", name, "address", "add", f"{address}/30", "dev", "wire")
            ip("-netns", name, "link", "set", "wire", "up")
        shape = ["tc", "-netns", far, "qdisc", "add", "dev", "wire", "root", "tbf"]
        subprocess.run([*shape, "rate", RATE, "burst", "32kb", "latency", "50ms"], check=True)
        stack.enter_context(network(near))
        yield stack.enter_context(serve(folder, ("ip", "netns", "exec", far), FAR))


def scp(sshd: Sshd, source: Path, destination: Path) -> None:
    options = ["StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "LogLevel=ERROR", "BatchMode=yes"]
    words = [word for option in options for word in ("-o", option)]
    login = ["-F", "none", *words, "-i", str(sshd.key), "-P", str(sshd.port)]
    # By scp's own protocol: the server of the tests has no SFTP.
    subprocess.run(["scp", "-O", "-q", *login, f"{sshd.user}@{sshd.address.host}:{source}", destination], check=True)


# The limits are of scp's time: 0.9 of its speed where the processors are the bound, all of it where the link is.
@pytest.mark.parametrize(("link", "limit"), [("loopback", 1 / 0.9), (RATE, 1.0)])
def test_pulling(sshd, tmp_path, link, limit):
    source = tmp_path / "samples.npy"
    source.write_bytes(os.urandom(SIZE_BYTES))
    (tmp_path / "sshd").mkdir()
    taken_s: dict[str, list[float]] = {"rtrun": [], "scp": []}
    with contextlib.nullcontext(sshd) if link == "loopback" else slow_link(tmp_path / "sshd") as server:

        def pull(folder: Path) -> None:
            with contextlib.closing(Connection(server.address)) as connection:
                connection.download(PurePosixPath(tmp_path), {source.name: SIZE_BYTES}, folder)

        ways = {"rtrun": pull, "scp": lambda folder: scp(server, source, folder)}
        for _ in range(ROUNDS):
            for name, way in ways.items():
                folder = tmp_path / name
                folder.mkdir(exist_ok=True)
                start = time.monotonic()
                way(folder)
                taken_s[name].append(time.monotonic() - start)
                copy = folder / source.name
                assert filecmp.cmp(copy, source, shallow=False)
                copy.unlink()
    # What the machine does beside this slows both of a round.
    ratio = statistics.median(ours / theirs for ours, theirs in zip(taken_s["rtrun"], taken_s["scp"], strict=True))
    rates = ", ".join(
        f"{name} {SIZE_BYTES / 1e6 / statistics.median(times):.1f} MB/s" for name, times in taken_s.items()
    )
    print(f"\n64 MiB over {link}: {rates}; {ratio:.2f} of scp's time (limit {limit:.2f}; medians of {ROUNDS})")
    assert ratio <= limit
