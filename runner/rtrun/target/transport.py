"""The authenticated transport under an SSH connection: reached, host key checked, logged in.

The target is not trusted: each step has a deadline, and what may arrive without being read is limited.
"""

import contextlib
import logging
import socket
import threading
from collections.abc import Container, Iterator

import paramiko

from rtfiles.errors import InfrastructureError
from rtrun.target.address import Address
from rtrun.target.errors import ConnectionLost
from rtrun.target.host_keys import (
    CERTIFICATE,
    HostKeys,
    UnacceptedHostKey,
    base_type,
    check_host_key,
    read_host_keys,
)
from rtrun.target.login import HungUp, log_in, read_keys

# Enough to see a silent link die within about 20 s, rare enough not to disturb a measurement.
KEEPALIVE_S = 10
USER_TIMEOUT_MS = 20_000
# AES-GCM needs one pass where CTR with a MAC needs two; ciphers out of date are not offered at all.
CIPHERS = ("aes128-gcm@openssh.com", "aes256-gcm@openssh.com", "aes128-ctr", "aes192-ctr", "aes256-ctr")
# The two windows of a channel, of 2 MiB each, and what goes with them.
UNREAD_BYTES_MAX = 5 * 1024 * 1024
# Connecting takes several steps of `timeout_s` each at most.
CONNECT_STEPS = 4

# What goes wrong is in our exceptions; paramiko would print a traceback for a board that is still booting.
logging.getLogger("paramiko").addHandler(logging.NullHandler())


class LimitedSocket(socket.socket):
    """A socket that receives a limited number of bytes until its user says that what came has been read.

    SSH has windows for the same purpose, but paramiko does not enforce them on the other side.
    """

    unread_bytes = 0
    is_exceeded = False

    def recv(self, size: int, flags: int = 0) -> bytes:
        """As in the base class, with SSHException once more than UNREAD_BYTES_MAX bytes are unread."""
        self.is_exceeded |= self.unread_bytes > UNREAD_BYTES_MAX
        if self.is_exceeded:
            raise paramiko.SSHException("more arrived than was asked for")
        data = super().recv(size, flags)
        self.unread_bytes += len(data)
        return data


def connect(address: Address, timeout_s: float) -> tuple[LimitedSocket, paramiko.Transport]:
    """Connect, check the host key and log in.

    Raises ConnectionLost when another attempt may succeed, TargetError otherwise.
    """
    known = read_host_keys(address)
    keys = read_keys(address)
    # A fingerprint does not say of which type its key is: the types whose keys were shown and are others.
    excluded: set[str] = set()
    unaccepted: UnacceptedHostKey | None = None
    while True:
        try:
            link = socket.create_connection((address.host, address.port), timeout=timeout_s)
        except (OSError, UnicodeError) as error:
            raise ConnectionLost(f"{address}: cannot connect: {getattr(error, 'strerror', None) or error}") from error
        link = LimitedSocket(fileno=link.detach())
        transport: paramiko.Transport | None = None
        try:
            # Without it a command's round trip waits for delayed acknowledgements: 47.6 ms instead of 1.9 ms.
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, USER_TIMEOUT_MS)
            with shutting_down(link, CONNECT_STEPS * timeout_s):
                transport = paramiko.Transport(link)
                _choose_algorithms(transport, known, excluded)
                transport.banner_timeout = transport.auth_timeout = timeout_s
                transport.start_client(timeout=timeout_s)
                check_host_key(address, transport.get_remote_server_key(), known)
                log_in(transport, address, keys)
                transport.set_keepalive(KEEPALIVE_S)
            return link, transport
        except BaseException as error:
            shown = transport.host_key_type if transport is not None else None
            if transport is not None:
                transport.close()
            link.close()
            if isinstance(error, UnacceptedHostKey) and known.is_fingerprint and shown:
                excluded.add(base_type(shown))
                unaccepted = unaccepted or error
                continue
            if isinstance(error, HungUp) and keys:
                continue
            if not isinstance(error, Exception) or isinstance(error, InfrastructureError):
                raise
            # With every type of key that was shown left out nothing may remain to agree on.
            raise unaccepted or ConnectionLost(f"{address}: SSH did not come up: {reason(error)}") from error


def _choose_algorithms(transport: paramiko.Transport, known: HostKeys, excluded: Container[str]) -> None:
    options = transport.get_security_options()
    options.ciphers = tuple(cipher for cipher in CIPHERS if cipher in options.ciphers)
    # Ask for the types of key that can be checked first: a server has several, and would show another.
    plain = options.key_types
    checkable = [name for name in known.types if name.removesuffix(CERTIFICATE) in plain]
    options.key_types = tuple(name for name in dict.fromkeys((*checkable, *plain)) if base_type(name) not in excluded)


@contextlib.contextmanager
def shutting_down(link: socket.socket, seconds: float) -> Iterator[threading.Event]:
    """Shut the socket down when the body takes longer, so that whatever waits in it ends; the event tells."""
    expired = threading.Event()

    def expire() -> None:
        expired.set()
        with contextlib.suppress(OSError):
            link.shutdown(socket.SHUT_RDWR)

    timer = threading.Timer(seconds, expire)
    timer.daemon = True
    timer.start()
    try:
        yield expired
    finally:
        timer.cancel()


def reason(error: Exception) -> str:
    """What an exception of paramiko says, which may be nothing but its type."""
    return str(error) or type(error).__name__
