"""One SSH connection to a target: commands with deadlines, files over SFTP, streams to its ports.

Commands are argument lists; they are quoted here and nowhere else.
"""

import base64
import hashlib
import logging
import select
import shlex
import socket
import stat
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

import paramiko

from rtrun.target.errors import ConnectionLost, DeadlineExpired, TargetError

# Enough to see a silent link die within about 20 s, rare enough not to disturb a measurement.
KEEPALIVE_S = 10
USER_TIMEOUT_MS = 20_000
# AES-GCM needs one pass where CTR with a MAC needs two; ciphers out of date are not offered at all.
CIPHERS = ("aes128-gcm@openssh.com", "aes256-gcm@openssh.com", "aes128-ctr", "aes192-ctr", "aes256-ctr")
# What a command on the target may take unless its caller says otherwise.
COMMAND_S = 30.0
KILL_GRACE_S = 5.0
CHUNK_BYTES = 32768

# What goes wrong is in our exceptions; paramiko would print a traceback for a board that is still booting.
logging.getLogger("paramiko").addHandler(logging.NullHandler())


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """Where a target listens and how both sides prove who they are.

    `host_key` is ``SHA256:…`` or ``type base64``; without it the `known_hosts` file decides. `key` is a private key
    file; without it the SSH agent is asked.
    """

    host: str
    port: int = 22
    user: str = "root"
    key: Path | None = None
    host_key: str | None = None
    known_hosts: Path = Path("~/.ssh/known_hosts")

    def __str__(self) -> str:
        return f"{self.user}@{self.host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Completed:
    """A remote command that ended: its exit status and what it printed."""

    status: int
    stdout: str
    stderr: str


def fingerprint(key: paramiko.PKey) -> str:
    """Return the fingerprint as OpenSSH prints it, ``SHA256:`` and base64 without padding."""
    return "SHA256:" + base64.b64encode(hashlib.sha256(key.asbytes()).digest()).decode().rstrip("=")


class Connection:
    """An authenticated SSH connection. Every call has a deadline; every transport failure is a `ConnectionLost`."""

    def __init__(self, address: Address, *, timeout_s: float = 15.0) -> None:
        self.address = address
        self._sftp: paramiko.SFTPClient | None = None
        self._transport = _connect(address, timeout_s)

    def close(self) -> None:
        """Close the connection; what runs detached on the target goes on."""
        self._transport.close()

    def run(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S, stdin: str = "") -> Completed:
        """Run a command and wait for its end.

        Raises DeadlineExpired after `deadline_s` seconds, once what was started has been killed, and ConnectionLost.
        """
        deadline = time.monotonic() + deadline_s
        channel = self._open("session", deadline_s)
        try:
            # The first line is the process to kill when time is up: sshd starts each command in a session of its own.
            channel.exec_command(f"echo $$; exec {shlex.join(argv)}")
            if stdin:
                channel.sendall(stdin.encode())
            channel.shutdown_write()
            output = _read_until(channel, deadline)
            pid, _, text = output[0].decode("utf-8", "replace").partition("\n")
            if not channel.exit_status_ready():
                fate = "was ended" if self._kill(pid) else "may go on: the target has not said what it started"
                raise DeadlineExpired(f"{self.address}: {argv[0]} took longer than {deadline_s:g} s and {fate}")
            status = channel.recv_exit_status()
            if status == -1 and not self._transport.is_active():
                raise ConnectionLost(f"{self.address}: the connection broke while {argv[0]} was running")
            return Completed(status=status, stdout=text, stderr=output[1].decode("utf-8", "replace"))
        except (paramiko.SSHException, OSError, EOFError) as error:
            raise ConnectionLost(f"{self.address}: the connection broke: {error or type(error).__name__}") from error
        finally:
            channel.close()

    def check(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S, stdin: str = "") -> str:
        """`run`, and return what it printed; a nonzero exit status is a TargetError with the last line it said."""
        result = self.run(argv, deadline_s=deadline_s, stdin=stdin)
        if result.status != 0:
            last_line = (result.stderr.strip() or result.stdout.strip() or "it said nothing").splitlines()[-1]
            raise TargetError(f"{self.address}: {argv[0]} failed with exit status {result.status}: {last_line}")
        return result.stdout

    def check_promptly(self, argv: Sequence[str], *, deadline_s: float = COMMAND_S) -> str:
        """`check` of a command that any target answers at once: no answer in time is a ConnectionLost."""
        try:
            return self.check(argv, deadline_s=deadline_s)
        except DeadlineExpired as error:
            raise ConnectionLost(f"{self.address}: does not answer: {error}") from error

    def upload(self, source: Path, destination: PurePosixPath) -> None:
        """Copy a local file to the target. Raises TargetError when the target cannot hold it, ConnectionLost."""
        try:
            self._files().put(str(source), str(destination), confirm=True)
        except (OSError, EOFError, paramiko.SSHException) as error:
            raise self._failure(error, f"cannot write {destination}") from error

    def download(self, source: PurePosixPath, destination: IO[bytes], *, limit_bytes: int) -> str:
        """Copy a file from the target and return its SHA-256 in hexadecimal.

        The target's word on the size is not trusted: more than `limit_bytes` is a TargetError.
        """
        digest, total = hashlib.sha256(), 0
        try:
            with self._files().open(str(source), "rb") as stream:
                size = stream.stat().st_size or 0
                if size > limit_bytes:
                    raise TargetError(f"{self.address}: {source} has {size} bytes, at most {limit_bytes} were expected")
                stream.prefetch(size)
                while chunk := stream.read(CHUNK_BYTES):
                    total += len(chunk)
                    if total > limit_bytes:
                        raise TargetError(f"{self.address}: {source} grew past {limit_bytes} bytes while it was copied")
                    digest.update(chunk)
                    destination.write(chunk)
        except (OSError, EOFError, paramiko.SSHException) as error:
            raise self._failure(error, f"cannot read {source}") from error
        return digest.hexdigest()

    def list_files(self, folder: PurePosixPath) -> dict[str, int]:
        """Return name and size in bytes of each regular file in a folder of the target; links are not followed."""
        try:
            entries = self._files().listdir_attr(str(folder))
        except (OSError, EOFError, paramiko.SSHException) as error:
            raise self._failure(error, f"cannot list {folder}") from error
        return {entry.filename: entry.st_size or 0 for entry in entries if stat.S_ISREG(entry.st_mode or 0)}

    def open_port(self, port: int, *, timeout_s: float = 10.0) -> paramiko.Channel:
        """Open a stream to a port of the target's own loopback. Raises ConnectionRefusedError when nobody listens."""
        if not self._transport.is_active():
            raise ConnectionLost(f"{self.address}: the connection broke")
        try:
            return self._transport.open_channel(
                "direct-tcpip", ("127.0.0.1", port), ("127.0.0.1", 0), timeout=timeout_s
            )
        except paramiko.ChannelException as error:
            if error.code == 1:
                raise TargetError(
                    f"{self.address}: the SSH server forbids TCP forwarding, allow it (AllowTcpForwarding yes)"
                ) from error
            raise ConnectionRefusedError(f"{self.address}: nobody listens on port {port}") from error
        except (paramiko.SSHException, OSError, EOFError) as error:
            raise ConnectionLost(f"{self.address}: the connection broke: {error}") from error

    def _open(self, kind: str, timeout_s: float) -> paramiko.Channel:
        try:
            return self._transport.open_channel(kind, timeout=timeout_s)
        except (paramiko.SSHException, OSError, EOFError) as error:
            raise ConnectionLost(f"{self.address}: the connection broke: {error or type(error).__name__}") from error

    def _kill(self, pid: str) -> bool:
        if not pid.isdigit():
            return False
        channel = self._open("session", KILL_GRACE_S)
        try:
            channel.exec_command(f"kill -KILL -{pid} || kill -KILL {pid}")
            _read_until(channel, time.monotonic() + KILL_GRACE_S)
            return True
        finally:
            channel.close()

    def _files(self) -> paramiko.SFTPClient:
        if self._sftp is None:
            try:
                self._sftp = paramiko.SFTPClient.from_transport(self._transport)
            except paramiko.SSHException as error:
                if not self._transport.is_active():
                    raise
                raise TargetError(
                    f"{self.address}: the SSH server has no SFTP, install one (openssh-sftp-server)"
                ) from error
            if self._sftp is None:
                raise TargetError(f"{self.address}: the SSH server refused a channel for SFTP")
            channel = self._sftp.get_channel()
            if channel is not None:
                channel.settimeout(60.0)
        return self._sftp

    def _failure(self, error: Exception, what: str) -> TargetError:
        """A file operation failed: is it the file, or the link?"""
        if isinstance(error, TimeoutError | EOFError | paramiko.SSHException) or not self._transport.is_active():
            return ConnectionLost(f"{self.address}: the connection broke ({what})")
        # SFTP version 3 has no code of its own for a full disk: the server says just "Failure".
        reason = getattr(error, "strerror", None) or str(error)
        if reason == "Failure" or "size mismatch" in reason:
            reason = "not all of it fits, most often because the target's disk is full (df -h)"
        return TargetError(f"{self.address}: {what}: {reason}")


def join_commands(commands: Iterable[Sequence[str]]) -> list[str]:
    """One command that runs these one after the other, up to the first that fails: one round trip, not many."""
    return ["sh", "-c", " && ".join(map(shlex.join, commands))]


def _connect(address: Address, timeout_s: float) -> paramiko.Transport:
    try:
        link = socket.create_connection((address.host, address.port), timeout=timeout_s)
    except OSError as error:
        raise ConnectionLost(f"{address}: cannot connect: {error.strerror or error}") from error
    # Without it a command's round trip waits for delayed acknowledgements: 47.6 ms instead of 1.9 ms.
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, USER_TIMEOUT_MS)
    transport: paramiko.Transport | None = None
    try:
        transport = paramiko.Transport(link)
        options = transport.get_security_options()
        options.ciphers = tuple(cipher for cipher in CIPHERS if cipher in options.ciphers)
        known = _known_keys(address)
        # Ask for the kinds of key we can check: a server has several, and would pick another.
        options.key_types = sorted(options.key_types, key=lambda kind: _base_type(kind) not in known)
        transport.banner_timeout = transport.auth_timeout = timeout_s
        transport.start_client(timeout=timeout_s)
        _check_host_key(address, transport.get_remote_server_key(), known)
        _authenticate(address, transport)
        transport.set_keepalive(KEEPALIVE_S)
    except BaseException as error:
        if transport is not None:
            transport.close()
        link.close()
        if isinstance(error, paramiko.SSHException | OSError | EOFError):
            raise ConnectionLost(f"{address}: SSH did not come up: {error or type(error).__name__}") from error
        raise
    return transport


def _base_type(kind: str) -> str:
    """An RSA key signs under three names but is one type of key."""
    return "ssh-rsa" if kind.startswith("rsa-sha2-") else kind


def _known_keys(address: Address) -> dict[str, str]:
    """Return the host keys we accept, key type to fingerprint; type ``*`` stands for any."""
    if address.host_key is not None:
        if address.host_key.startswith("SHA256:"):
            return {"*": address.host_key.rstrip("=")}
        kind, _, encoded = address.host_key.partition(" ")
        try:
            data = base64.b64decode(encoded.split(" ")[0], validate=True)
        except ValueError:
            data = b""
        if not data:
            raise TargetError(f"{address}: host_key is neither 'SHA256:…' nor 'type base64': {address.host_key!r}")
        return {kind: "SHA256:" + base64.b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")}
    path = address.known_hosts.expanduser()
    keys = paramiko.HostKeys()
    try:
        keys.load(str(path))
    except FileNotFoundError:
        return {}
    except (OSError, paramiko.SSHException) as error:
        raise TargetError(f"{path}: {error}") from error
    name = address.host if address.port == 22 else f"[{address.host}]:{address.port}"
    return {kind: fingerprint(key) for kind, key in (keys.lookup(name) or {}).items()}


def _check_host_key(address: Address, key: paramiko.PKey, known: dict[str, str]) -> None:
    seen = fingerprint(key)
    if seen in known.values():
        return
    where = "the target file" if address.host_key is not None else str(address.known_hosts)
    if known:
        expected = known.get(key.get_name()) or next(iter(known.values()))
        raise TargetError(
            f"{address}: the host key has changed: {where} says {expected}, the target shows {seen} "
            f"({key.get_name()}); if the board was installed anew, correct it there, otherwise somebody else answers"
        )
    raise TargetError(
        f"{address}: unknown host key {seen} ({key.get_name()}); compare it with the board's, then put "
        f"'host_key: {seen}' into the target file or add the host to {where}"
    )


def _authenticate(address: Address, transport: paramiko.Transport) -> None:
    if address.key is not None:
        path = address.key.expanduser()
        try:
            keys: list[paramiko.PKey] = [paramiko.PKey.from_path(path)]
        except FileNotFoundError as error:
            raise TargetError(f"{address}: key {path} does not exist") from error
        except (paramiko.PasswordRequiredException, TypeError) as error:
            raise TargetError(
                f"{address}: key {path} has a passphrase: load it into ssh-agent, leave 'key' out"
            ) from error
        except (OSError, ValueError, paramiko.SSHException) as error:
            raise TargetError(f"{address}: key {path} cannot be read: {error}") from error
    else:
        keys = list(paramiko.Agent().get_keys())
        if not keys:
            raise TargetError(f"{address}: no key: name one as 'key' in the target file, or load one into ssh-agent")
    for key in keys:
        try:
            transport.auth_publickey(address.user, key)
            return
        except paramiko.AuthenticationException:
            continue
    tried = str(address.key) if address.key else f"{len(keys)} keys of the SSH agent"
    raise TargetError(f"{address}: user {address.user} may not log in with {tried}: authorise the key on the target")


def _read_until(channel: paramiko.Channel, deadline: float) -> tuple[bytes, bytes]:
    """Read both streams until they end or the deadline (monotonic seconds) passes."""
    buffers = (bytearray(), bytearray())
    while True:
        while channel.recv_ready():
            buffers[0].extend(channel.recv(CHUNK_BYTES))
        while channel.recv_stderr_ready():
            buffers[1].extend(channel.recv_stderr(CHUNK_BYTES))
        remaining_s = max(0.0, deadline - time.monotonic())
        if channel.eof_received or channel.closed:
            if not (channel.recv_ready() or channel.recv_stderr_ready()):
                # The exit status may come before or after the end of the streams.
                channel.status_event.wait(remaining_s)
                return bytes(buffers[0]), bytes(buffers[1])
        elif remaining_s == 0.0:
            return bytes(buffers[0]), bytes(buffers[1])
        else:
            select.select([channel], [], [], remaining_s)
