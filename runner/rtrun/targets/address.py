"""Where a target is: behind an SSH server, with the keys that identify both sides, or this machine."""

import ipaddress
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Self


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """An SSH server and the login to use there.

    `host_key` is as `host_keys.read_host_key` takes it; without it the `known_hosts` files decide. `key` is a private
    key file, and no other key is tried; without it the keys of the SSH agent are tried, then the files `identities`.
    """

    host: str
    port: int = 22
    user: str = "root"
    key: Path | None = None
    identities: tuple[Path, ...] = ()
    """Private key files, or public ones whose private part the agent has; those that do not exist are skipped."""
    identities_only: bool = False
    """Try no key of the agent that is not among the identities."""
    agent: str = "SSH_AUTH_SOCK"
    """IdentityAgent as in ssh_config(5): a socket, ``none``, or the environment variable that names the socket."""
    host_key: str | None = None
    known_hosts: tuple[Path, ...] = (Path("~/.ssh/known_hosts"),)
    jump: Self | None = None
    """The SSH server through which this one is reached."""
    is_jump: bool = False
    """Other servers are reached through this one. The host key in a target file is not that of a jump host."""

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.user}@{host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ThisMachine:
    """The machine that the runner itself runs on."""

    def __str__(self) -> str:
        return "this machine"


def check_host(name: str) -> str:
    """Return a name or an address that a resolver can look up. Raises ValueError for any other."""
    try:
        encoded = name.encode("idna")
    except UnicodeError as error:
        raise ValueError(f"expected the name or the address of a host: {error}") from error
    if not re.fullmatch(rb"[A-Za-z0-9._:%-]+", encoded):
        raise ValueError("expected the name or the address of a host")
    return name


def check_server(text: str) -> str:
    """Return HOST, HOST:PORT or [ADDRESS]:PORT, as used in an address. Raises ValueError."""
    _split(text)
    return text


def read_login(text: str) -> dict[str, str | int]:
    """Read [USER@]HOST[:PORT] into the keys of a target file that it states; the host is checked there.

    An IPv6 address with a port is in brackets. Raises ValueError.
    """
    user, at, server = text.rpartition("@")
    if (at and not user) or not server:
        raise ValueError(f"{text[:100]!r} is not [USER@]HOST[:PORT]")
    login: dict[str, str | int] = {"host": server}
    if ":" in server and not _is_ipv6(server):
        host, port = _split(server)
        login = {"host": host} | ({"port": port} if port else {})
    return login | ({"user": user} if user else {})


def _split(server: str) -> tuple[str, int | None]:
    parts = re.fullmatch(r"(?:\[([0-9A-Fa-f:.]+)\]|([A-Za-z0-9._-]+))(?::([0-9]{1,5}))?", server, re.ASCII)
    if not parts:
        raise ValueError(f"{server[:100]!r} is not HOST:PORT, of IPv6 [ADDRESS]:PORT")
    if parts[1]:
        ipaddress.IPv6Address(parts[1])
    else:
        check_host(parts[2])
    if parts[3] and not 0 < int(parts[3]) < 1 << 16:
        raise ValueError(f"{server[:100]!r}: a port is a number from 1 to 65535")
    return parts[1] or parts[2], int(parts[3]) if parts[3] else None


def _is_ipv6(text: str) -> bool:
    try:
        ipaddress.IPv6Address(text)
    except ValueError:
        return False
    return True
