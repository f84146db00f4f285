"""A link between runner and target that a test can cut, freeze or make slow."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator


class Proxy:
    """Forwards TCP connections from a port of its own to another port of loopback, and counts the bytes."""

    def __init__(self, port: int) -> None:
        self.bytes_per_s: float | None = None
        self.total_bytes = 0
        self._target = port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._open: list[socket.socket] = []
        self._flowing = threading.Event()
        self._flowing.set()
        self._reachable = True
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            if not self._reachable:
                client.close()
                continue
            server = socket.create_connection(("127.0.0.1", self._target))
            self._open += [client, server]
            for source, sink in ((client, server), (server, client)):
                threading.Thread(target=self._copy, args=(source, sink), daemon=True).start()

    def _copy(self, source: socket.socket, sink: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                self._flowing.wait()
                if self.bytes_per_s:
                    time.sleep(len(data) / self.bytes_per_s)
                self.total_bytes += len(data)
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def cut(self) -> None:
        """Break every connection, and refuse new ones until `mend`."""
        self._reachable = False
        opened, self._open = self._open, []
        for end in opened:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def freeze(self) -> None:
        """Let nothing through any more, and say nothing: a cable pulled somewhere far away."""
        self._flowing.clear()

    def mend(self) -> None:
        """Be a good link again, for new connections."""
        self.cut()
        self._reachable = True
        self._flowing.set()

    def close(self) -> None:
        """Give the port back."""
        self.mend()
        self.cut()
        self._server.close()


@contextlib.contextmanager
def proxy_to(port: int) -> Iterator[Proxy]:
    """A proxy that is closed when the context is left."""
    proxy = Proxy(port)
    try:
        yield proxy
    finally:
        proxy.close()
