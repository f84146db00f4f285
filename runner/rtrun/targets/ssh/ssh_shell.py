"""Run commands over SSH: each in its own channel. A second channel ends it when its time is up."""

import contextlib
import re
import select
import shlex
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import paramiko

from rtfiles.errors import InfrastructureError
from rtfiles.untrusted import whole_number
from rtrun.kinds.limits import PID_MAX
from rtrun.targets import groups
from rtrun.targets.address import Address
from rtrun.targets.errors import ConnectionLost, DeadlineExpired, TargetError
from rtrun.targets.shell import CHUNK_BYTES, OUTPUT_BYTES_MAX, POLL_S, Collector, TooMuch
from rtrun.targets.ssh.transport import FORBIDDEN, connect, reason, shutting_down

# All that a window holds: each time a part is taken, paramiko moves the rest of its buffer, up to 2 MiB.
_READ_BYTES = 2 * 1024 * 1024
KILL_GRACE_S = 5.0
GRACE_S = 3 * KILL_GRACE_S  #: more time to end a command that takes too long, and to wait for the answers
_WORD = "RTRUN_COMMAND"
_SECRET = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", re.ASCII)
# Whatever the login sets, others must not write to new files. The target draws the secret: if the runner drew it, the
# command line of the user's shell would show it.
_BEGIN = f"umask go-w; read -r {_WORD} </proc/sys/kernel/random/uuid; export {_WORD}; echo $$ ${_WORD}; exec "
# Not every SSH server starts a command as the leader of a group.
_KILL = (
    groups.FUNCTIONS
    + """
read -r known_by
lock=
if is_our_group "$1"; then
    kill -KILL "-$1"
else
    is_marked "$1" && kill -KILL "$1"
fi
"""
)


class _FirstLineApart:
    """Keeps the first line of a stream and hands on what follows it."""

    def __init__(self, take: Callable[[bytes], None]) -> None:
        self._line = b""
        self._take = take
        self._is_complete = False

    @property
    def command(self) -> tuple[int, str] | None:
        """The process that the line names, and its secret; None: it names none, or is not complete yet."""
        try:
            line = self._line.decode("ascii") if self._is_complete else ""
            number, _, secret = line.partition(" ")
            pid = whole_number(number, lowest=2, highest=PID_MAX)
        except ValueError:
            return None
        return (pid, secret) if _SECRET.fullmatch(secret) else None

    def __call__(self, chunk: bytes) -> None:
        if not self._is_complete:
            head, newline, chunk = chunk.partition(b"\n")
            self._line += head
            self._is_complete = bool(newline)
            if len(self._line) > CHUNK_BYTES:
                raise TooMuch(f"{CHUNK_BYTES} bytes in its first line")
        if chunk:
            self._take(chunk)


class SshShell:
    """An authenticated SSH connection."""

    def __init__(self, address: Address, *, timeout_s: float) -> None:
        self.address = address
        self.stream, self.transport = connect(address, timeout_s)

    def close(self) -> None:
        """Close the connection; what runs detached on the target goes on."""
        self.transport.close()

    def interrupt(self) -> None:
        """Break the connection, so that what another thread waits for ends."""
        self.stream.shut_down()

    @contextlib.contextmanager
    def open_port(self, port: int, deadline_s: float) -> Iterator[paramiko.Channel]:
        """Yield a stream to a port of the target's own loopback, which is closed after `deadline_s` seconds.

        Raises ConnectionRefusedError when nobody listens.
        """
        with self._within(deadline_s):
            channel: paramiko.Channel | None
            try:
                channel = self.transport.open_channel("direct-tcpip", ("127.0.0.1", port), ("127.0.0.1", 0))
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

    def execute(
        self,
        argv: Sequence[str],
        stdin: Iterable[bytes],
        take: Callable[[bytes], None],
        deadline_s: float,
        *,
        feed: Callable[[], bytes | None] | None = None,
    ) -> tuple[int, str]:
        """Run a command, hand what it prints to `take`, and return its exit status and its standard error."""
        deadline = time.monotonic() + deadline_s
        stderr = Collector(OUTPUT_BYTES_MAX)
        # The first line is the process to kill when time is up: sshd starts each command in a session of its own. The
        # secret in its environment distinguishes it from any other process of that number.
        stdout = _FirstLineApart(take)
        with self._within(deadline_s + GRACE_S), self._session() as channel:
            channel.settimeout(deadline_s)
            channel.exec_command(_BEGIN + shlex.join(argv))
            try:
                # A command may end before it has read everything; its exit status says why.
                with contextlib.suppress(OSError):
                    for chunk in stdin:
                        channel.sendall(chunk)
                    if feed is None:
                        channel.shutdown_write()
                ended = self._read(channel, deadline, stdout, stderr, feed)
                # A status that comes just when time is up may precede output that was not read.
                status = channel.recv_exit_status() if ended and channel.exit_status_ready() else None
            except TooMuch as error:
                self._kill(stdout.command)
                raise TargetError(f"{self.address}: {argv[0]} printed more than {error} and was ended") from error
            except InfrastructureError:
                self._kill(stdout.command)
                raise
            if status is None:
                fate = "was ended" if self._kill(stdout.command) else "may go on: the target does not show it"
                raise DeadlineExpired(f"{self.address}: {argv[0]} took longer than {deadline_s:g} s and {fate}")
            if status == -1 and not self.transport.is_active():
                raise EOFError(f"while {argv[0]} was running")
        return status, stderr.text()

    def _read(
        self,
        channel: paramiko.Channel,
        deadline: float,
        stdout: Callable[[bytes], None],
        stderr: Callable[[bytes], None],
        feed: Callable[[], bytes | None] | None,
    ) -> bool:
        """Read both streams until they end and the exit status is there, or the deadline (monotonic seconds) passes.

        Standard input gets what `feed` returns, and ends when that is None. Return whether the streams ended.
        """
        while (remaining_s := deadline - time.monotonic()) > 0:
            if feed is not None:
                more = feed()
                with contextlib.suppress(OSError):
                    if more is None:
                        channel.shutdown_write()
                    elif more:
                        channel.sendall(more)
                remaining_s = min(remaining_s, POLL_S)
            # Checked before the buffers, so that data that arrives in between is read in the next turn.
            ended = channel.eof_received or channel.closed
            chunks = (
                channel.recv(_READ_BYTES) if channel.recv_ready() else b"",
                channel.recv_stderr(_READ_BYTES) if channel.recv_stderr_ready() else b"",
            )
            if any(chunks):
                self.stream.unread_bytes -= len(chunks[0]) + len(chunks[1])
                stdout(chunks[0])
                stderr(chunks[1])
                continue
            self.stream.unread_bytes = 0
            if ended:
                # The exit status may come before or after the end of the streams.
                channel.status_event.wait(deadline - time.monotonic())
                return True
            select.select([channel], [], [], remaining_s)
        return False

    def _kill(self, command: tuple[int, str] | None) -> bool:
        """Kill what was started with this secret in its environment; return whether it was found and killed."""
        if command is None:
            return False
        pid, secret = command
        try:
            with self._session() as channel:
                channel.exec_command(shlex.join(["sh", "-c", _KILL, "sh", str(pid)]))
                channel.sendall(f"{_WORD}={secret}\n".encode())
                channel.shutdown_write()
                return bool(channel.status_event.wait(KILL_GRACE_S)) and channel.exit_status == 0
        except Exception:
            # As in `_within`. The caller reports why it wanted to kill.
            return False

    @contextlib.contextmanager
    def _session(self) -> Iterator[paramiko.Channel]:
        channel = self.transport.open_session()
        try:
            yield channel
        finally:
            channel.close()

    @contextlib.contextmanager
    def _within(self, seconds: float) -> Iterator[None]:
        """Give the body a total deadline, and turn errors of paramiko into ConnectionLost or TargetError."""
        self.stream.unread_bytes = 0
        with shutting_down(self.stream, seconds) as expired:
            try:
                yield
            except InfrastructureError:
                raise
            except Exception as error:
                # paramiko raises the error that ended its reading thread.
                if self.stream.is_exceeded:
                    raise TargetError(f"{self.address}: the target sends more than it was asked for") from error
                if expired.is_set():
                    raise ConnectionLost(f"{self.address}: no answer within {seconds:g} s") from error
                raise ConnectionLost(f"{self.address}: the connection broke: {reason(error)}") from error
