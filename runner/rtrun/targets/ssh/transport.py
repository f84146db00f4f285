"""The authenticated transport under an SSH connection: reached, host key checked, logged in.

The target is not trusted: each step has a deadline, and what may arrive without being read is limited.
"""

import contextlib
import logging
import socket
import threading
from collections.abc import Container, Iterator
from typing import cast

import paramiko

from rtfiles.errors import InfrastructureError
from rtrun.targets.address import Address
from rtrun.targets.errors import ConnectionLost, TargetError
from rtrun.targets.ssh.host_keys import (
    CERTIFICATE,
    HostKeys,
    UnacceptedHostKey,
    base_type,
    check_host_key,
    read_host_keys,
)
from rtrun.targets.ssh.login import HungUp, Refused, log_in, read_keys, unlock

# Enough to see a silent link die within about 20 s, rare enough not to disturb a measurement.
KEEPALIVE_S = 10  #: silence of a connection before a keepalive
USER_TIMEOUT_MS = 20_000
# AES-GCM needs one pass, CTR with a MAC needs two. Outdated ciphers are not offered at all.
CIPHERS = ("aes128-gcm@openssh.com", "aes256-gcm@openssh.com", "aes128-ctr", "aes192-ctr", "aes256-ctr")
# The two windows of a channel, 2 MiB each, and their overhead.
UNREAD_BYTES_MAX = 5 * 1024 * 1024  #: unread bytes of a connection
# Connecting takes several steps of `timeout_s` each at most.
CONNECT_STEPS = 4
# "Administratively prohibited" (RFC 4254, section 5.1).
FORBIDDEN = 1
# paramiko's own timeout comes first, and says more.
JUMP_GRACE_S = 5.0  #: more time for a connection through a jump host

# Our exceptions report errors. paramiko would print a traceback for a board that is still booting.
logging.getLogger("paramiko").addHandler(logging.NullHandler())


class LimitedStream:
    """A TCP connection, or a channel through a jump host, that receives a limited number of bytes.

    It receives more once its user reports that the data has been read. SSH has windows for the same purpose, but
    paramiko does not enforce them on the other side.
    """

    def __init__(self, carrier: socket.socket | paramiko.Channel, jump: "LimitedStream | None" = None) -> None:
        self.carrier = carrier
        self.unread_bytes = 0
        self.is_exceeded = False
        self._jump = jump

    def recv(self, size: int) -> bytes:
        """As of a socket, but raises SSHException once more than UNREAD_BYTES_MAX bytes are unread."""
        self.is_exceeded |= self.unread_bytes > UNREAD_BYTES_MAX
        if self.is_exceeded:
            raise paramiko.SSHException("more arrived than was asked for")
        data = self.carrier.recv(size)
        self.unread_bytes += len(data)
        if self._jump is not None and isinstance(self.carrier, paramiko.Channel):
            self._jump.unread_bytes -= len(data)
            if not self.carrier.recv_ready():
                # The rest of the count is headers of packets.
                self._jump.unread_bytes = 0
        return data

    @property
    def _closed(self) -> bool:
        # paramiko asks this of a socket.
        return bool(getattr(self.carrier, "_closed", False))

    def send(self, data: bytes) -> int:
        """As of a socket."""
        return self.carrier.send(data)

    def settimeout(self, seconds: float | None) -> None:
        """As of a socket."""
        self.carrier.settimeout(seconds)

    def shut_down(self) -> None:
        """Shut down the TCP connection that carries this one, so that every wait for it ends."""
        if self._jump is not None:
            self._jump.shut_down()
        elif isinstance(self.carrier, socket.socket):
            with contextlib.suppress(OSError):
                self.carrier.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close this and the connections to the jump hosts that it goes through. May be called from several threads."""
        if isinstance(self.carrier, paramiko.Channel):
            # This ends the channel as well. Closing the channel first would write to a transport that may be closed.
            self.carrier.get_transport().close()
        else:
            self.carrier.close()


def connect(address: Address, timeout_s: float) -> tuple[LimitedStream, paramiko.Transport]:
    """Connect, check the host key and log in; if there is a jump host, first do the same there.

    Raises ConnectionLost when another attempt may succeed, TargetError otherwise.
    """
    known = read_host_keys(address)
    keys = read_keys(address)
    # A fingerprint does not tell the type of its key. These are the types whose keys were shown and did not match.
    excluded: set[str] = set()
    unaccepted: UnacceptedHostKey | None = None
    while True:
        stream = _reach(address, timeout_s)
        transport: paramiko.Transport | None = None
        try:
            with shutting_down(stream, CONNECT_STEPS * timeout_s):
                # paramiko uses no more of a socket than a LimitedStream has.
                transport = paramiko.Transport(cast("socket.socket", stream))
                _choose_algorithms(transport, known, excluded)
                transport.banner_timeout = transport.auth_timeout = timeout_s
                transport.start_client(timeout=timeout_s)
                check_host_key(address, transport.get_remote_server_key(), known)
                log_in(transport, address, keys)
                transport.set_keepalive(KEEPALIVE_S)
            return stream, transport
        except BaseException as error:
            shown = transport.host_key_type if transport is not None else None
            if transport is not None:
                transport.close()
            stream.close()
            if isinstance(error, UnacceptedHostKey) and known.is_fingerprint and shown:
                excluded.add(base_type(shown))
                unaccepted = unaccepted or error
                continue
            if isinstance(error, HungUp) and keys.usable:
                continue
            if isinstance(error, Refused | HungUp) and keys.locked:
                # Between two connections: neither side waits while the user types.
                keys.usable = unlock(address, keys.locked.pop(0))
                continue
            if not isinstance(error, Exception) or isinstance(error, InfrastructureError):
                raise
            # Once every type of key that was shown is left out, there may be none left to agree on.
            raise unaccepted or ConnectionLost(f"{address}: SSH did not come up: {reason(error)}") from error


def ask_host_key(address: Address, timeout_s: float) -> tuple[str, bytes]:
    """Return type and public key that a server shows. The key is not checked: the user has to compare it.

    Raises ConnectionLost, and as `connect` does for the jump host before the server.
    """
    stream = _reach(address, timeout_s)
    try:
        with shutting_down(stream, CONNECT_STEPS * timeout_s):
            transport = paramiko.Transport(cast("socket.socket", stream))
            transport.banner_timeout = timeout_s
            try:
                transport.start_client(timeout=timeout_s)
                key = transport.get_remote_server_key()
                return key.get_name(), key.asbytes()
            finally:
                transport.close()
    except Exception as error:
        # paramiko raises the error that ended its reading thread.
        raise ConnectionLost(f"{address}: SSH did not come up: {reason(error)}") from error
    finally:
        stream.close()


def _reach(address: Address, timeout_s: float) -> LimitedStream:
    """Return a stream to the port where the SSH server listens. Raises as `connect` does."""
    if address.jump is not None:
        return _reach_through(address.jump, address, timeout_s)
    try:
        link = socket.create_connection((address.host, address.port), timeout=timeout_s)
    except (OSError, UnicodeError) as error:
        raise ConnectionLost(f"{address}: cannot connect: {getattr(error, 'strerror', None) or error}") from error
    # Without it a command's round trip waits for delayed acknowledgements: 47.6 ms instead of 1.9 ms.
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    link.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, USER_TIMEOUT_MS)
    return LimitedStream(link)


def _reach_through(jump: Address, address: Address, timeout_s: float) -> LimitedStream:
    """Let a jump host connect to the address; a new connection to the jump host is made for it."""
    below, transport = connect(jump, timeout_s)
    try:
        with shutting_down(below, timeout_s + JUMP_GRACE_S):
            target = (address.host, address.port)
            channel = transport.open_channel("direct-tcpip", target, ("127.0.0.1", 0), timeout=timeout_s)
    except BaseException as error:
        transport.close()
        below.close()
        if isinstance(error, paramiko.ChannelException) and error.code == FORBIDDEN:
            raise TargetError(
                f"{address}: the jump host {jump} forbids TCP forwarding, allow it there (AllowTcpForwarding yes)"
            ) from error
        if not isinstance(error, Exception):
            raise
        raise ConnectionLost(f"{address}: cannot connect from the jump host {jump}: {reason(error)}") from error
    channel.settimeout(timeout_s)
    return LimitedStream(channel, below)


def _choose_algorithms(transport: paramiko.Transport, known: HostKeys, excluded: Container[str]) -> None:
    options = transport.get_security_options()
    options.ciphers = tuple(cipher for cipher in CIPHERS if cipher in options.ciphers)
    # Ask first for the types of key that can be checked: a server has several, and might show another one.
    plain = options.key_types
    checkable = [name for name in known.types if name.removesuffix(CERTIFICATE) in plain]
    options.key_types = tuple(name for name in dict.fromkeys((*checkable, *plain)) if base_type(name) not in excluded)


@contextlib.contextmanager
def shutting_down(stream: LimitedStream, seconds: float) -> Iterator[threading.Event]:
    """Shut the stream down if the body takes longer, so that every wait in it ends; then the event is set."""
    expired = threading.Event()

    def expire() -> None:
        expired.set()
        stream.shut_down()

    timer = threading.Timer(seconds, expire)
    timer.daemon = True
    timer.start()
    try:
        yield expired
    finally:
        timer.cancel()


def reason(error: Exception) -> str:
    """The text of an exception of paramiko, or its type if it has no text."""
    return str(error) or type(error).__name__
