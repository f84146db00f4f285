"""Logging in with the private keys at hand: key files with their certificates, and the keys of the SSH agent."""

import base64
import getpass
import os
import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import paramiko
from paramiko.agent import AgentSSH

from rtfiles.errors import UsageError
from rtfiles.output import print_status
from rtrun.targets.address import Address
from rtrun.targets.errors import TargetError

AGENT_S = 30.0  #: an answer of the SSH agent
"""How long the agent may take to answer: a hardware key waits for a touch."""
AGENT_KEYS_MAX = 32  #: keys taken from the SSH agent
# As OpenSSH (NumberOfPasswordPrompts).
PROMPTS = 3
PUBLIC_KEY_BYTES_MAX = 64 * 1024  #: a public key file


class Refused(TargetError):
    """The server accepts no key."""


class HungUp(Exception):
    """The server ended the connection during the login, as OpenSSH does after six refused keys."""


@dataclass(slots=True, kw_only=True)
class Keys:
    """The keys to log in with, in the order to be tried. Those that were refused are taken out."""

    usable: list[paramiko.PKey]
    locked: list[Path]
    """Key files whose passphrase was not asked for yet."""
    source: str
    """Where the keys come from, for messages."""


# Passphrases are asked for once, not at each new connection.
_unlocked: dict[Path, list[paramiko.PKey]] = {}


def read_keys(address: Address) -> Keys:
    """Return the private keys to log in with. Raises TargetError when there are none."""
    if address.key is not None:
        return _read_one(address, address.key.expanduser())
    failure = f"{address}: no key: name one as 'key' in the target file, or load one into ssh-agent"
    try:
        held = _ask_agent(address)
    except TargetError as error:
        # A key file may do. The environment may name an agent that ended long ago.
        held, failure = [], str(error)
    files = [path.expanduser() for path in address.identities]
    # Path.is_file raises where a folder may not be read.
    files = [path for path in files if os.path.isfile(path)]  # noqa: PTH113
    held_of = {path: key for path in files if (key := _held(path, held))}
    listed = list(held_of.values())
    others = [] if address.identities_only else [key for key in held if key not in listed]
    source = ", ".join([*(["the keys of the SSH agent"] if held else []), *map(str, files)])
    keys = Keys(usable=[*listed, *others], locked=[], source=source)
    for path in files:
        if path in held_of:
            continue
        try:
            keys.usable += _read_key_file(path)
        except paramiko.PasswordRequiredException:
            keys.locked.append(path)
        except Exception:
            # As OpenSSH: of several keys, one that cannot be read is skipped.
            continue
    if not keys.usable and not keys.locked:
        raise TargetError(failure)
    return keys


def check_key_file(path: Path) -> None:
    """Raise UsageError unless a file holds a private key, with a passphrase or without."""
    try:
        _load(path, None)
    except paramiko.PasswordRequiredException:
        pass
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}: name the file of a private key as 'key'") from error
    except Exception as error:
        # paramiko and its libraries may raise anything on a file that is no key.
        raise UsageError(f"{path}: is no private key that can be read here: {error}") from error


def _read_one(address: Address, path: Path) -> Keys:
    """The key that the target file names. If it has a passphrase, the agent may hold it."""
    try:
        return Keys(usable=_read_key_file(path), locked=[], source=str(path))
    except FileNotFoundError as error:
        raise TargetError(f"{address}: key {path} does not exist") from error
    except paramiko.PasswordRequiredException:
        try:
            key = _held(path, _ask_agent(address))
        except TargetError:
            key = None
        return Keys(usable=[key] if key else [], locked=[] if key else [path], source=str(path))
    except Exception as error:
        # paramiko and its libraries may raise anything on a file that is no key.
        raise TargetError(f"{address}: key {path} cannot be read: {error}") from error


def unlock(address: Address, path: Path) -> list[paramiko.PKey]:
    """Ask for the passphrase of a key file. Raises TargetError when there is no terminal, or no right answer."""
    if not sys.stdin.isatty():
        raise TargetError(
            f"{address}: key {path} has a passphrase: load it into ssh-agent (ssh-add {path}), "
            "or call rtrun on a terminal, where it asks for it"
        )
    for _ in range(PROMPTS):
        # Clear a line that may show the progress.
        print_status("")
        try:
            passphrase = getpass.getpass(f"Passphrase of {path}: ")
        except EOFError:
            break
        try:
            _unlocked[path] = _read_key_file(path, passphrase)
        except Exception:
            # paramiko and its libraries may raise anything on a wrong passphrase.
            continue
        return _unlocked[path]
    raise TargetError(f"{address}: key {path}: that is not its passphrase")


def _ask_agent(address: Address) -> list[paramiko.PKey]:
    """Return the keys that the SSH agent holds; none without an agent. Raises TargetError when it does not answer."""
    path = _agent_socket(address.agent)
    if not path:
        return []
    try:
        connection = socket.socket(socket.AF_UNIX)
        connection.settimeout(AGENT_S)
        connection.connect(path)
        agent: Any = AgentSSH()
        # paramiko's own way to connect has no timeout.
        agent._connect(connection)
        return list(agent.get_keys())[:AGENT_KEYS_MAX]
    except TimeoutError as error:
        raise TargetError(f"{address}: the SSH agent ({path}) has not answered for {AGENT_S:g} s") from error
    except Exception as error:
        # paramiko raises what its parsing of the answer raises.
        raise TargetError(f"{address}: the SSH agent ({path}) cannot be asked: {error}") from error


def _agent_socket(agent: str) -> str:
    """Return the path of an IdentityAgent of ssh_config(5); empty without an agent."""
    if agent == "SSH_AUTH_SOCK" or agent.startswith("$"):
        return os.environ.get(agent.removeprefix("$"), "")
    return "" if agent == "none" else str(Path(agent).expanduser())


def _held(path: Path, held: Sequence[paramiko.PKey]) -> paramiko.PKey | None:
    """Return the key of the agent that belongs to a file: to ``<file>.pub``, or to the file itself if it is public."""
    for public in (path, path.with_name(f"{path.name}.pub")):
        try:
            with public.open("rb") as stream:
                blob = base64.b64decode(stream.read(PUBLIC_KEY_BYTES_MAX).split()[1], validate=True)
        except (OSError, ValueError, IndexError):
            continue
        return next((key for key in held if key.asbytes() == blob), None)
    return None


def _read_key_file(path: Path, passphrase: str | None = None) -> list[paramiko.PKey]:
    """Return the key of a file, after the one with its certificate if it has one.

    Raises PasswordRequiredException if the key needs a passphrase and none is given, and whatever paramiko and its
    libraries raise on a file that is no key.
    """
    if path in _unlocked:
        return list(_unlocked[path])
    plain = _load(path, passphrase)
    certificate = path.with_name(f"{path.name}-cert.pub")
    if not certificate.is_file():
        return [plain]
    # As OpenSSH: the certificate first, then the key without it.
    try:
        certified = _load(path, passphrase)
        certified.load_certificate(str(certificate))
    except Exception:
        return [plain]
    return [certified, plain]


def _load(path: Path, passphrase: str | None) -> paramiko.PKey:
    """Read a private key without the certificate that may be next to it."""
    failure: Exception = ValueError("not a private key")
    for kind in (paramiko.Ed25519Key, paramiko.ECDSAKey, paramiko.RSAKey):
        try:
            return kind.from_private_key_file(str(path), passphrase)
        except (OSError, paramiko.PasswordRequiredException):
            raise
        except TypeError as error:
            # For a PEM file, the library below raises this if there is no passphrase.
            raise paramiko.PasswordRequiredException(str(error)) from error
        except Exception as error:
            # A key of another type, or no key.
            failure = error
    raise failure


def log_in(transport: paramiko.Transport, address: Address, keys: Keys) -> None:
    """Log in with the first of the keys that is accepted; those that were refused are taken out.

    Raises Refused when no key is left, HungUp when the server ended the connection, TimeoutError when it does not
    answer, and TargetError.
    """
    refused = 0
    while keys.usable:
        try:
            wanted = transport.auth_publickey(address.user, keys.usable[0])
        except paramiko.BadAuthenticationType as error:
            raise TargetError(
                f"{address}: the SSH server takes no keys from user {address.user}, only "
                f"{', '.join(error.allowed_types)}: allow keys there (PubkeyAuthentication yes)"
            ) from error
        except TimeoutError as error:
            raise TargetError(f"{address}: the SSH agent has not signed for {AGENT_S:g} s") from error
        except Exception as error:
            # paramiko raises the error that ended its reading thread. It has no type for a server that does not answer:
            # a board that has just booted may be slow, and has refused nothing.
            if str(error) == "Authentication timeout.":
                raise TimeoutError("it has not answered to the login in time") from error
            hung_up = not transport.is_active()
            if not (hung_up and refused):
                # Else this key may have been cut off by the limit for refused keys: it is tried again.
                del keys.usable[0]
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
    raise Refused(f"{address}: user {address.user} may not log in with {keys.source}: authorise the key on the target")
