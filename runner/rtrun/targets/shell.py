"""The interface of SSH and of this machine to a connection: run one command, open one stream."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

CHUNK_BYTES = 32768
# How much a command may print. The largest outputs that are read whole are the kernel's configuration, some 300 KiB,
# and the CPU facts of a machine with a thousand CPUs. A list of the words of an output takes thirty times the memory.
OUTPUT_BYTES_MAX = 2 * 1024 * 1024  #: output of a command on the target
# How often `feed` is asked while a command waits for the end of its standard input.
POLL_S = 0.2


class Shell(Protocol):
    """Runs commands on a target, each within its deadline. Every transport failure is a `ConnectionLost`."""

    def execute(
        self,
        argv: Sequence[str],
        stdin: Iterable[bytes],
        take: Callable[[bytes], None],
        deadline_s: float,
        *,
        feed: Callable[[], bytes | None] | None = None,
    ) -> tuple[int, str]:
        """Run a command, hand what it prints to `take`, and return its exit status and its standard error.

        Its standard input is `stdin`. If there is a `feed`, it is asked for more every POLL_S as long as the command
        lasts, until it returns None. An error that `feed` raises ends the command. Raises DeadlineExpired once
        everything that was started has been killed; TargetError when `take` raises TooMuch.
        """

    def open_port(self, port: int, deadline_s: float) -> AbstractContextManager[Any]:
        """Yield a stream with a socket's methods to a port of the target's loopback, open for `deadline_s` at most.

        Raises ConnectionRefusedError when nobody listens.
        """

    def interrupt(self) -> None:
        """End the wait of another thread, as far as possible."""

    def close(self) -> None:
        """End the connection; what runs detached on the target goes on."""


class TooMuch(Exception):
    """A command printed more than the limit."""


class Collector:
    """Collects what a command prints, up to a limit; `on_line` gets each line when its end arrives."""

    def __init__(self, limit_bytes: int, on_line: Callable[[str], None] | None = None) -> None:
        self._data = bytearray()
        self._limit_bytes, self._on_line = limit_bytes, on_line
        self._lines_bytes = 0

    def __call__(self, chunk: bytes) -> None:
        self._data += chunk
        if len(self._data) > self._limit_bytes:
            raise TooMuch(f"{self._limit_bytes // 2**20} MiB")
        while self._on_line and (end := self._data.find(b"\n", self._lines_bytes)) >= 0:
            line, self._lines_bytes = self._data[self._lines_bytes : end], end + 1
            self._on_line(line.decode("utf-8", "replace"))

    def text(self) -> str:
        return self._data.decode("utf-8", "replace")
