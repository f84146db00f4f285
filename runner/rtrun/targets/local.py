"""Run commands on this machine itself as sshd would: in a session and an environment of their own."""

import contextlib
import itertools
import os
import pwd
import selectors
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import IO

from rtrun.targets.address import ThisMachine
from rtrun.targets.errors import DeadlineExpired, TargetError
from rtrun.targets.shell import CHUNK_BYTES, OUTPUT_BYTES_MAX, POLL_S, Collector, TooMuch

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


class LocalShell:
    """This machine. Nothing can break between it and the runner."""

    def __init__(self, address: ThisMachine) -> None:
        self.address = address

    def interrupt(self) -> None:
        """There is no connection to break: a waiting thread waits until the command ends or its time is up."""

    def close(self) -> None:
        """Nothing is open."""

    def execute(
        self,
        argv: Sequence[str],
        stdin: Iterable[bytes],
        take: Callable[[bytes], None],
        deadline_s: float,
        *,
        feed: Callable[[], bytes | None] | None = None,
    ) -> tuple[int, str]:
        """As `Shell.execute`."""
        deadline = time.monotonic() + deadline_s
        stderr = Collector(OUTPUT_BYTES_MAX)
        with _interrupt_held() as release:
            process = self._start(argv)
        try:
            release()
            _exchange(process, stdin, take, stderr, deadline, feed)
            process.wait(max(0.0, deadline - time.monotonic()))
        except BaseException as error:
            # Kill it with everything that it started. Its number stays its own until somebody has waited for it.
            if process.returncode is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if isinstance(error, TooMuch):
                raise TargetError(f"{self.address}: {argv[0]} printed more than {error} and was ended") from error
            if isinstance(error, subprocess.TimeoutExpired):
                late = f"{self.address}: {argv[0]} took longer than {deadline_s:g} s and was ended"
                raise DeadlineExpired(late) from error
            raise
        finally:
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()
        return process.returncode, stderr.text()

    def _start(self, argv: Sequence[str]) -> "subprocess.Popen[bytes]":
        # Through a shell, as with SSH: a program that is not there is exit status 127.
        try:
            return subprocess.Popen(
                ["/bin/sh", "-c", 'umask go-w; exec "$@"', "sh", *argv],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                cwd="/",
                env=environment(),
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise TargetError(f"{self.address}: {argv[0]} cannot be started: {error}") from error

    @contextlib.contextmanager
    def open_port(self, port: int, deadline_s: float) -> Iterator[socket.socket]:
        """As `Shell.open_port`."""
        with socket.create_connection(("127.0.0.1", port), timeout=deadline_s) as stream:
            # The timeout of a socket applies to each step, not to the whole.
            deadline = threading.Timer(deadline_s, _shut_down, [stream])
            deadline.daemon = True
            deadline.start()
            try:
                yield stream
            finally:
                deadline.cancel()


@contextlib.contextmanager
def _interrupt_held() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C back until the yielded function is called: within Popen it is not known yet what was started.

    Blocking the signal does not work: another thread would take it, or the started program would inherit the block.
    """
    if threading.current_thread() is not threading.main_thread():
        # In Python only the main thread handles signals.
        yield lambda: None
        return
    held: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: held.append(number))

    def release() -> None:
        signal.signal(signal.SIGINT, before)
        if held:
            signal.raise_signal(signal.SIGINT)

    try:
        yield release
    except BaseException:
        release()
        raise


def environment() -> dict[str, str]:
    """The environment of a login, without what the runner's own shell has set up, such as a virtual environment."""
    try:
        user = pwd.getpwuid(os.getuid())
    except KeyError:
        # A user of a container may have no name.
        return {"PATH": PATH, "HOME": "/"}
    names = {"USER": user.pw_name, "LOGNAME": user.pw_name}
    return names | {"PATH": PATH, "HOME": user.pw_dir, "SHELL": user.pw_shell}


def _exchange(
    process: "subprocess.Popen[bytes]",
    stdin: Iterable[bytes],
    take_stdout: Callable[[bytes], None],
    take_stderr: Callable[[bytes], None],
    deadline: float,
    feed: Callable[[], bytes | None] | None,
) -> None:
    """Write and read until both outputs have ended. Raises TimeoutExpired at the deadline (monotonic seconds)."""
    assert process.stdin is not None and process.stdout is not None and process.stderr is not None
    chunks, pending = iter(stdin), b""
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ, take_stdout)
        selector.register(process.stderr, selectors.EVENT_READ, take_stderr)
        os.set_blocking(process.stdin.fileno(), False)
        selector.register(process.stdin, selectors.EVENT_WRITE)
        while selector.get_map():
            remaining_s = deadline - time.monotonic()
            if remaining_s <= 0:
                raise subprocess.TimeoutExpired(process.args, 0)
            if feed is not None:
                remaining_s = min(remaining_s, POLL_S)
                more = feed()
                if process.stdin.closed:
                    pass
                elif more is None:
                    _close_stdin(process.stdin, selector)
                elif more:
                    chunks = itertools.chain(chunks, [more])
                    # The pipe may still be registered.
                    with contextlib.suppress(KeyError):
                        selector.register(process.stdin, selectors.EVENT_WRITE)
            for key, _ in selector.select(remaining_s):
                if key.fileobj is process.stdin:
                    pending = pending or next(chunks, b"")
                    try:
                        written = os.write(key.fd, pending) if pending else 0
                    except BrokenPipeError:
                        # A command may end before it has read everything; its exit status says why.
                        written = 0
                    pending = pending[written:]
                    if written:
                        continue
                    if feed is None:
                        _close_stdin(process.stdin, selector)
                    else:
                        selector.unregister(process.stdin)
                elif data := os.read(key.fd, CHUNK_BYTES):
                    key.data(data)
                else:
                    selector.unregister(key.fileobj)


def _close_stdin(stdin: IO[bytes], selector: selectors.BaseSelector) -> None:
    with contextlib.suppress(KeyError):
        selector.unregister(stdin)
    stdin.close()


def _shut_down(stream: socket.socket) -> None:
    with contextlib.suppress(OSError):
        stream.shutdown(socket.SHUT_RDWR)
