"""Logging in with the private keys at hand: a key file with its certificate, or the keys of the SSH agent."""

import os
import socket
from pathlib import Path
from typing import Any

import paramiko
from paramiko.agent import AgentSSH

from rtrun.target.address import Address
from rtrun.target.errors import TargetError

AGENT_S = 30.0
"""How long the agent may take to answer: a hardware key waits for a touch."""
AGENT_KEYS_MAX = 32


class Refused(TargetError):
    """The server accepts none of the keys."""


class HungUp(Exception):
    """The server ended the connection during the login, as OpenSSH does after six refused keys."""


def _ask_agent(path: str) -> list[paramiko.PKey]:
    connection = socket.socket(socket.AF_UNIX)
    connection.settimeout(AGENT_S)
    connection.connect(path)
    agent: Any = AgentSSH()
    # paramiko's own way to connect has no timeout.
    agent._connect(connection)
    return list(agent.get_keys())[:AGENT_KEYS_MAX]


def read_keys(address: Address) -> list[paramiko.PKey]:
    """Return the private keys to log in with, in the order to be tried. Raises TargetError."""
    if address.key is not None:
        return _read_key_file(address, address.key.expanduser())
    keys: list[paramiko.PKey] = []
    if path := os.environ.get("SSH_AUTH_SOCK"):
        try:
            keys = _ask_agent(path)
        except TimeoutError as error:
            raise TargetError(f"{address}: the SSH agent ({path}) has not answered for {AGENT_S:g} s") from error
        except Exception as error:
            # paramiko raises what its parsing of the answer raises.
            raise TargetError(f"{address}: the SSH agent ({path}) cannot be asked: {error}") from error
    if not keys:
        raise TargetError(f"{address}: no key: name one as 'key' in the target file, or load one into ssh-agent")
    return keys


def _read_key_file(address: Address, path: Path) -> list[paramiko.PKey]:
    certificate = path.with_name(f"{path.name}-cert.pub")
    try:
        plain = _load(path)
    except FileNotFoundError as error:
        raise TargetError(f"{address}: key {path} does not exist") from error
    except (paramiko.PasswordRequiredException, TypeError) as error:
        raise TargetError(f"{address}: key {path} has a passphrase: load it into ssh-agent, leave 'key' out") from error
    except Exception as error:
        # paramiko and its libraries raise whatever on a file that is no key.
        raise TargetError(f"{address}: key {path} cannot be read: {error}") from error
    if not certificate.is_file():
        return [plain]
    # As OpenSSH: the certificate first, then the key without it.
    try:
        certified = _load(path)
        certified.load_certificate(str(certificate))
    except Exception:
        return [plain]
    return [certified, plain]


def _load(path: Path) -> paramiko.PKey:
    """Read a private key without the certificate that may stand beside it."""
    failure: Exception = ValueError("not a private key")
    for kind in (paramiko.Ed25519Key, paramiko.ECDSAKey, paramiko.RSAKey):
        try:
            return kind.from_private_key_file(str(path))
        except (OSError, paramiko.PasswordRequiredException):
            raise
        except Exception as error:
            # A key of another type, or no key.
            failure = error
    raise failure


def log_in(transport: paramiko.Transport, address: Address, keys: list[paramiko.PKey]) -> None:
    """Log in with the first of the keys that is accepted; those that were refused are taken out of the list.

    Raises Refused when no key is left, HungUp when the server ended the connection, and TargetError.
    """
    tried = str(address.key) if address.key else "the keys of the SSH agent"
    refused = 0
    while keys:
        try:
            wanted = transport.auth_publickey(address.user, keys[0])
        except paramiko.BadAuthenticationType as error:
            raise TargetError(
                f"{address}: the SSH server takes no keys from user {address.user}, only "
                f"{', '.join(error.allowed_types)}: allow keys there (PubkeyAuthentication yes)"
            ) from error
        except TimeoutError as error:
            raise TargetError(f"{address}: the SSH agent has not signed for {AGENT_S:g} s") from error
        except Exception as error:
            # paramiko raises here whatever its reading thread has ended with.
            hung_up = not transport.is_active()
            if not (hung_up and refused):
                # Else this key may have been cut off by the limit for refused keys: it is tried again.
                del keys[0]
                refused += 1
            if hung_up:
                raise HungUp(str(error)) from error
            continue
        if wanted:
            raise TargetError(
                f"{address}: the SSH server accepted the key of user {address.user} and wants {' or '.join(wanted)} "
                "besides; rtrun logs in by key alone: allow that there (AuthenticationMethods publickey)"
            )
        return
    raise Refused(f"{address}: user {address.user} may not log in with {tried}: authorise the key on the target")
