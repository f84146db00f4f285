"""One SSH connection to a target: commands with deadlines, files, streams to its ports.

Commands are argument lists; they are quoted here and nowhere else. The target is not trusted: every operation has a
total deadline, and what a command may print is limited.
"""

import contextlib
import hashlib
import re
import select
import shlex
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

import paramiko

from rtfiles import untrusted
from rtfiles.errors import InfrastructureError
from rtrun.target.address import Address
from rtrun.target.errors import ConnectionLost, DeadlineExpired, TargetError
from rtrun.target.transport import FORBIDDEN, connect, reason, shutting_down

# What a command on the target may take unless its caller says otherwise.
COMMAND_S = 30.0
KILL_GRACE_S = 5.0
# Beyond the deadline of a command: to end it, and for the answers to that.
GRACE_S = 3 * KILL_GRACE_S
CHUNK_BYTES = 32768
# What a command may print. The largest that is read whole is the kernel's configuration with some 300 KiB.
OUTPUT_BYTES_MAX = 8 * 1024 * 1024
# A transfer that is slower than this has failed.
TRANSFER_S = 60.0
TRANSFER_BYTES_PER_S = 50_000
FILES_MAX = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Completed:
    """A remote command that ended: its exit status and what it printed."""

    status: int
    stdout: str
    stderr: str


class _TooMuch(Exception):
    """A command printed more than is taken."""


class _Collector:
    """Collects what a command prints, up to a limit."""

    def __init__(self, limit_bytes: int) -> None:
        self._data = bytearray()
        self._limit_bytes = limit_bytes

    def __call__(self, chunk: bytes) -> None:
        self._data += chunk
        if len(self._data) > self._limit_bytes:
            raise _TooMuch(f"{self._limit_bytes // 2**20} MiB")

    def text(self) -> str:
        return self._data.decode("utf-8", "replace")


class _FirstLineApart:
    """Keeps the first line of a stream and hands on what follows it."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self.line = b""
        self._take = take
        self._is_complete = False

    def __call__(self, chunk: bytes) -> None:
        if not self._is_complete:
            head, newline, chunk = chunk.partition(b"\n")
            self.line += head
            self._is_complete = bool(newline)
            if len(self.line) > CHUNK_BYTES:
                raise _TooMuch(f"{CHUNK_BYTES} bytes in its first line")
        if chunk:
            self._take(chunk)


class Connection:
    """An authenticated SSH connection. Every call has a deadline; every transport failure is a `ConnectionLost`."""

    def __init__(self, address: Address, *, timeout_s: float = 15.0) -> None:
        self.address = address
        self._stream, self._transport = connect(address, timeout_s)

    def close(self) -> None:
        """Close the connection; what runs detached on the target goes on."""
        self._transport.close()

    def run(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S, stdin: str = "") -> Completed:
        """Run a command and wait for its end.

        Raises DeadlineExpired after `deadline_s` seconds, once what was started has been killed; TargetError when it
        prints more than 8 MiB; ConnectionLost.
        """
        stdout = _Collector(OUTPUT_BYTES_MAX)
        status, stderr = self._execute(argv, [stdin.encode()] if stdin else [], stdout, deadline_s)
        return Completed(status=status, stdout=stdout.text(), stderr=stderr)

    def check(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S, stdin: str = "") -> str:
        """`run`, and return what it printed; a nonzero exit status is a TargetError with its last line of output."""
        result = self.run(argv, deadline_s=deadline_s, stdin=stdin)
        if result.status != 0:
            last_line = _last_line(result.stderr) or _last_line(result.stdout) or "it printed nothing"
            raise TargetError(f"{self.address}: {argv[0]} failed with exit status {result.status}: {last_line}")
        return result.stdout

    def check_promptly(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S) -> str:
        """`check` of a command that any target answers at once: no answer in time is a ConnectionLost."""
        try:
            return self.check(argv, deadline_s=deadline_s)
        except DeadlineExpired as error:
            raise ConnectionLost(f"{self.address}: does not answer: {error}") from error

    def upload(self, source: Path, destination: PurePosixPath) -> None:
        """Copy a local file to the target. Raises TargetError when the target cannot hold it, ConnectionLost.

        After a lost connection a part of the file may stand there.
        """
        argv = ["sh", "-c", 'cat >"$1"', "sh", str(destination)]
        with _local_file(source), source.open("rb") as stream:
            chunks = iter(lambda: _read_local(source, stream), b"")
            size = source.stat().st_size
            status, stderr = self._execute(argv, chunks, _Collector(OUTPUT_BYTES_MAX), _transfer_s(size))
        if status != 0:
            full = "; the target's disk is full (df -h)" if "No space left" in stderr else ""
            raise TargetError(f"{self.address}: cannot write {destination}: {_last_line(stderr)}{full}")

    def download(self, source: PurePosixPath, destination: IO[bytes], *, limit_bytes: int) -> str:
        """Copy a file from the target and return its SHA-256 in hexadecimal.

        Raises TargetError when it has more than `limit_bytes` bytes or cannot be read, ConnectionLost, and
        InfrastructureError when the copy cannot be written.
        """
        digest, total = hashlib.sha256(), 0

        def take(chunk: bytes) -> None:
            nonlocal total
            total += len(chunk)
            if total > limit_bytes:
                raise TargetError(f"{self.address}: {source} has more than the {limit_bytes} bytes that were expected")
            digest.update(chunk)
            with _local_file(Path(destination.name)):
                destination.write(chunk)

        status, stderr = self._execute(["cat", str(source)], [], take, _transfer_s(limit_bytes))
        if status != 0:
            raise TargetError(f"{self.address}: cannot read {source}: {_last_line(stderr)}")
        return digest.hexdigest()

    def list_files(self, folder: PurePosixPath) -> dict[str, int]:
        """Return name and size in bytes of each regular file in a folder of the target; links are not followed."""
        files = {}
        for line in self.check(["env", "LC_ALL=C", "ls", "-ln", f"{folder}/"]).splitlines():
            # Mode, links, user, group, size, three words of the time, name.
            words = line.split(None, 8)
            if len(words) < 9 or not line.startswith("-"):
                continue
            with contextlib.suppress(ValueError):
                files[words[8]] = untrusted.whole_number(words[4], lowest=0)
            if len(files) > FILES_MAX:
                raise TargetError(f"{self.address}: {folder} has more than {FILES_MAX} files")
        return files

    @contextlib.contextmanager
    def open_port(self, port: int, *, deadline_s: float) -> Iterator[paramiko.Channel]:
        """Yield a stream to a port of the target's own loopback, which is closed after `deadline_s` seconds.

        Raises ConnectionRefusedError when nobody listens.
        """
        with self._within(deadline_s):
            channel: paramiko.Channel | None
            try:
                channel = self._transport.open_channel("direct-tcpip", ("127.0.0.1", port), ("127.0.0.1", 0))
            except paramiko.ChannelException as error:
                if error.code == FORBIDDEN:
                    raise TargetError(
                        f"{self.address}: the SSH server forbids TCP forwarding, allow it (AllowTcpForwarding yes)"
                    ) from error
                channel = None
        if channel is None:
            raise ConnectionRefusedError(f"{self.address}: nobody listens on port {port}")
        channel.settimeout(deadline_s)
        deadline = threading.Timer(deadline_s, channel.close)
        deadline.daemon = True
        deadline.start()
        try:
            yield channel
        finally:
            deadline.cancel()
            channel.close()

    def _execute(
        self, argv: Sequence[str], stdin: Iterable[bytes], take: Callable[[bytes], None], deadline_s: float
    ) -> tuple[int, str]:
        """Run a command, hand what it prints to `take`, and return its exit status and its standard error."""
        deadline = time.monotonic() + deadline_s
        stderr = _Collector(OUTPUT_BYTES_MAX)
        # The first line is the process to kill when time is up: sshd starts each command in a session of its own.
        stdout = _FirstLineApart(take)
        with self._within(deadline_s + GRACE_S), self._session() as channel:
            channel.settimeout(deadline_s)
            channel.exec_command(f"echo $$; exec {shlex.join(argv)}")
            try:
                # A command may end before it has read everything; its exit status says why.
                with contextlib.suppress(OSError):
                    for chunk in stdin:
                        channel.sendall(chunk)
                    channel.shutdown_write()
                self._read(channel, deadline, stdout, stderr)
                status = channel.recv_exit_status() if channel.exit_status_ready() else None
            except _TooMuch as error:
                self._kill(stdout.line)
                raise TargetError(f"{self.address}: {argv[0]} printed more than {error} and was ended") from error
            except InfrastructureError:
                self._kill(stdout.line)
                raise
            if status is None:
                fate = "was ended" if self._kill(stdout.line) else "may go on: the target has not said what it started"
                raise DeadlineExpired(f"{self.address}: {argv[0]} took longer than {deadline_s:g} s and {fate}")
            if status == -1 and not self._transport.is_active():
                raise EOFError(f"while {argv[0]} was running")
        return status, stderr.text()

    def _read(
        self,
        channel: paramiko.Channel,
        deadline: float,
        stdout: Callable[[bytes], None],
        stderr: Callable[[bytes], None],
    ) -> None:
        """Read both streams until they end and the exit status is there, or the deadline (monotonic seconds) passes."""
        while (remaining_s := deadline - time.monotonic()) > 0:
            # Asked before the buffers: what arrives in between is read in the next turn.
            ended = channel.eof_received or channel.closed
            chunks = (
                channel.recv(CHUNK_BYTES) if channel.recv_ready() else b"",
                channel.recv_stderr(CHUNK_BYTES) if channel.recv_stderr_ready() else b"",
            )
            if any(chunks):
                self._stream.unread_bytes -= len(chunks[0]) + len(chunks[1])
                stdout(chunks[0])
                stderr(chunks[1])
                continue
            self._stream.unread_bytes = 0
            if ended:
                # The exit status may come before or after the end of the streams.
                channel.status_event.wait(remaining_s)
                return
            select.select([channel], [], [], remaining_s)

    def _kill(self, first_line: bytes) -> bool:
        pid = first_line.decode("ascii", "replace").strip()
        if not re.fullmatch(r"[0-9]{1,10}", pid, re.ASCII):
            return False
        try:
            with self._session() as channel:
                channel.exec_command(f"kill -KILL -{pid} || kill -KILL {pid}")
                return bool(channel.status_event.wait(KILL_GRACE_S))
        except Exception:
            # As in `_within`; the reason to kill is what the caller reports.
            return False

    @contextlib.contextmanager
    def _session(self) -> Iterator[paramiko.Channel]:
        channel = self._transport.open_session()
        try:
            yield channel
        finally:
            channel.close()

    @contextlib.contextmanager
    def _within(self, seconds: float) -> Iterator[None]:
        """Give the body a total deadline, and turn what paramiko raises in it into ConnectionLost or TargetError."""
        self._stream.unread_bytes = 0
        with shutting_down(self._stream, seconds) as expired:
            try:
                yield
            except InfrastructureError:
                raise
            except Exception as error:
                # paramiko raises here whatever its reading thread has ended with.
                if self._stream.is_exceeded:
                    raise TargetError(f"{self.address}: the target sends more than it was asked for") from error
                if expired.is_set():
                    raise ConnectionLost(f"{self.address}: no answer within {seconds:g} s") from error
                raise ConnectionLost(f"{self.address}: the connection broke: {reason(error)}") from error


def join_commands(commands: Iterable[Sequence[str]]) -> list[str]:
    """One command that runs these one after the other, up to the first that fails: one round trip, not many."""
    return ["sh", "-c", " && ".join(map(shlex.join, commands))]


@contextlib.contextmanager
def _local_file(path: Path) -> Iterator[None]:
    """A failure of a file of this machine is not one of the target."""
    try:
        yield
    except OSError as error:
        raise InfrastructureError(f"{path}: {error.strerror or error}") from error


def _read_local(path: Path, stream: IO[bytes]) -> bytes:
    with _local_file(path):
        return stream.read(CHUNK_BYTES)


def _transfer_s(size_bytes: int) -> float:
    return TRANSFER_S + size_bytes / TRANSFER_BYTES_PER_S


def _last_line(text: str) -> str:
    return text.strip().rpartition("\n")[2][:500]
