"""A hostile SSH server on loopback. It speaks SSH as any server does, and then does one thing that none should do."""

import contextlib
import functools
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import paramiko

from measured import measured

BLOCK = b"x" * 32768


class Server(paramiko.ServerInterface):
    """Lets everybody in and hands each command to a behaviour."""

    def __init__(self, behaviour: Callable[[paramiko.Channel, bytes], None]) -> None:
        self._behaviour = behaviour
        self.forwarded: set[int] = set()

    def check_auth_publickey(self, username: str, key: paramiko.PKey) -> int:
        return paramiko.AUTH_SUCCESSFUL

    def get_allowed_auths(self, username: str) -> str:
        return "publickey"

    def check_channel_request(self, kind: str, chanid: int) -> int:
        return paramiko.OPEN_SUCCEEDED

    def check_channel_direct_tcpip_request(self, chanid: int, origin: object, destination: object) -> int:
        self.forwarded.add(chanid)
        return paramiko.OPEN_SUCCEEDED

    def check_channel_exec_request(self, channel: paramiko.Channel, command: bytes) -> bool:
        threading.Thread(target=self._obey, args=(channel, command), daemon=True).start()
        return True

    def _obey(self, channel: paramiko.Channel, command: bytes) -> None:
        with contextlib.suppress(Exception):
            self._behaviour(channel, command)


def honest(channel: paramiko.Channel, command: bytes) -> None:
    """Run the command, as a target would."""
    process = subprocess.Popen(["sh", "-c", command.decode()], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin and process.stdout
    while data := channel.recv(32768):
        process.stdin.write(data)
    process.stdin.close()
    while data := process.stdout.read1(32768):
        channel.sendall(data)
    channel.send_exit_status(process.wait())
    channel.close()


def quietly(stream: Callable[[paramiko.Channel], None], channel: paramiko.Channel) -> None:
    """Serve a forwarded port until the other side has had enough."""
    with contextlib.suppress(OSError, EOFError, paramiko.SSHException):
        stream(channel)


@functools.cache
def host_key() -> paramiko.RSAKey:
    """Made once: that takes as long as what is done with it."""
    return paramiko.RSAKey.generate(2048)


@contextlib.contextmanager
def serving(
    behaviour: Callable[[paramiko.Channel, bytes], None] = honest,
    stream: Callable[[paramiko.Channel], None] | None = None,
) -> Iterator[tuple[int, str]]:
    """Serve on loopback; yield port and host key. `stream` serves every forwarded port."""
    key = host_key()
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept() -> None:
            while True:
                try:
                    link, _ = listener.accept()
                except OSError:
                    return
                threading.Thread(target=serve, args=(link,), daemon=True).start()

        def serve(link: socket.socket) -> None:
            with contextlib.suppress(Exception):
                transport = paramiko.Transport(link)
                transport.add_server_key(key)
                server = Server(behaviour)
                transport.start_server(server=server)
                while (channel := transport.accept(3600)) is not None:
                    if stream is not None and channel.get_id() in server.forwarded:
                        threading.Thread(target=quietly, args=(stream, channel), daemon=True).start()

        threading.Thread(target=accept, daemon=True).start()
        yield listener.getsockname()[1], f"ssh-rsa {key.get_base64()}"
        listener.shutdown(socket.SHUT_RDWR)


# What the runner does with the target, in a process of its own: its highest memory is measured.
CLIENT = """
import json, sys, time
from pathlib import Path, PurePosixPath
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.targets.address import Address
from rtrun.targets.config import Target
from rtrun.targets.link import Link

action, port, host_key, key, folder = sys.argv[1:]
target = Target(name="hostile", work_dir=PurePosixPath("/tmp/rt-tests"), suites=None, setup=None,
    master_port=11311, reconnect_s=1,
    address=Address(host="127.0.0.1", port=int(port), key=Path(key), host_key=host_key))
outcome, started = "done", time.monotonic()
try:
    exec(action)
except (InfrastructureError, UsageError) as error:
    outcome = f"{type(error).__name__}: {error}"
print(json.dumps({"outcome": outcome, "seconds": time.monotonic() - started}))
"""


def act(action: str, server: tuple[int, str], key: Path, folder: Path, *, timeout_s: float = 240) -> dict[str, object]:
    """Run an action of the runner against a server; return its outcome, duration and highest memory (MiB)."""
    started = time.monotonic()
    argv = [sys.executable, "-c", CLIENT, action, str(server[0]), server[1], str(key), str(folder)]
    done = measured(argv, timeout_s=timeout_s, check=False)
    assert done.status == 0, done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    assert time.monotonic() - started < timeout_s
    return json.loads(done.stdout.splitlines()[-1]) | {"peak_mib": done.peak_mib}
