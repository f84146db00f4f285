"""What ~/.ssh/config says about a host, read as ssh(1) reads it; docs/targets.md lists what is read and what is not.

Nothing in the file is executed: the lines under a `Match exec` are left out with a note, a `ProxyCommand` is refused.
"""

import getpass
import glob
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from rtfiles import untrusted
from rtfiles.errors import UsageError
from rtfiles.output import print_note
from rtrun.targets.address import Address, check_host
from rtrun.targets.ssh.host_keys import matches

FILE = Path("~/.ssh/config")
SSH_CONFIG_BYTES_MAX = untrusted.MIB  #: `~/.ssh/config`, and each file that it includes
# Includes as in OpenSSH. A jump host may have a jump host of its own, so their number is limited, too.
INCLUDES_MAX = 16  #: files of `~/.ssh/config` that include each other
JUMPS_MAX = 8  #: jump hosts before a target
DEFAULT_IDENTITIES = ["~/.ssh/id_rsa", "~/.ssh/id_ecdsa", "~/.ssh/id_ed25519"]
DEFAULT_KNOWN_HOSTS = ["~/.ssh/known_hosts"]
_READ = frozenset(
    {
        "hostname",
        "port",
        "user",
        "identityfile",
        "identitiesonly",
        "identityagent",
        "proxyjump",
        "proxycommand",
        "userknownhostsfile",
    }
)
_LINE = re.compile(r"(\w+)(?:\s*=\s*|\s+)(.+)")
_JUMP = re.compile(r"(?:ssh://)?(?:([^@]+)@)?(\[[^]]+\]|[^:\[\]]+)(?::([0-9]{1,5}))?/?")


@dataclass(slots=True, kw_only=True)
class _Lookup:
    """One host, and the settings found for it so far: keyword in lower case to its words."""

    alias: str
    user: str | None
    """The user that the target file names."""
    settings: dict[str, list[str]] = field(default_factory=dict)

    def first(self, keyword: str) -> str | None:
        return self.settings.get(keyword, [None])[0]


def address_of(
    host: str,
    *,
    user: str | None = None,
    port: int | None = None,
    key: Path | None = None,
    host_key: str | None = None,
    known_hosts: Path | None = None,
) -> Address:
    """Return the address of a host by its name or its alias in ~/.ssh/config; these arguments take precedence.

    The default user is root. Raises UsageError naming the line that is wrong or cannot be followed.
    """
    address = _address(FILE.expanduser(), host, user=user, port=port, default_user="root")
    return replace(
        address, key=key, host_key=host_key, known_hosts=(known_hosts,) if known_hosts else address.known_hosts
    )


def _address(
    file: Path,
    alias: str,
    *,
    user: str | None,
    port: int | None,
    default_user: str,
    hops: list[str] | None = None,
    before: tuple[str, ...] = (),
) -> Address:
    """Return the address of one host; `hops` are its jump hosts if they are given, `before` those that led here."""
    if alias in before or len(before) > JUMPS_MAX:
        raise UsageError(f"{file}: ProxyJump leads in a circle: {' -> '.join((*before, alias))}")
    lookup = _Lookup(alias=alias, user=user)
    _read(file, lookup, is_active=True, depth=0)
    if lookup.first("proxycommand") not in (None, "none") and lookup.first("proxyjump") is None:
        raise UsageError(
            f"{file}: ProxyCommand for {alias}: rtrun runs no command to connect; write ProxyJump instead, "
            f"or give {alias} a Host section with ProxyCommand none"
        )
    user = user or lookup.first("user") or default_user
    try:
        name = check_host(_expand(file, lookup.first("hostname") or "%h", {"h": alias}))
    except ValueError as error:
        raise UsageError(f"{file}: HostName of {alias}: {error}") from error
    tokens = {"h": name, "r": user, "u": _local_user(), "d": str(Path.home())}
    return Address(
        host=name,
        port=port or _port(file, lookup.first("port") or "22"),
        user=user,
        identities=_paths(file, lookup.settings.get("identityfile", DEFAULT_IDENTITIES), tokens),
        identities_only=lookup.first("identitiesonly") == "yes",
        agent=_expand(file, lookup.first("identityagent") or "SSH_AUTH_SOCK", tokens),
        known_hosts=_paths(file, lookup.settings.get("userknownhostsfile", DEFAULT_KNOWN_HOSTS), tokens),
        jump=_jump(file, lookup, hops, (*before, alias)),
    )


def _jump(file: Path, lookup: _Lookup, hops: list[str] | None, before: tuple[str, ...]) -> Address | None:
    """Return the last jump host before a host; the earlier ones are its own jump hosts."""
    if hops is None:
        hops = [hop for word in lookup.settings.get("proxyjump", []) for hop in word.split(",")]
    if not hops or hops == ["none"]:
        return None
    parts = _JUMP.fullmatch(hops[-1])
    if parts is None:
        raise UsageError(f"{file}: ProxyJump for {lookup.alias}: {hops[-1]!r} is not [user@]host[:port]")
    user, host, port = parts.groups()
    address = _address(
        file,
        host.strip("[]"),
        user=user,
        port=_port(file, port) if port else None,
        default_user=_local_user(),
        # As OpenSSH: only the first of several may have a ProxyJump of its own.
        hops=hops[:-1] or None,
        before=before,
    )
    return replace(address, is_jump=True)


def _read(file: Path, lookup: _Lookup, *, is_active: bool, depth: int) -> None:
    """Add what a file says about the host; for most keywords the first value counts."""
    for number, keyword, words in _lines(file):
        where = f"{file}: line {number}"
        if keyword == "host":
            is_active = _is_named(words, lookup.alias)
        elif keyword == "match":
            is_active = _is_matched(words, lookup, where)
        elif not is_active:
            continue
        elif keyword == "include":
            if depth == INCLUDES_MAX:
                raise UsageError(f"{where}: more than {INCLUDES_MAX} files include each other")
            for included in _included(words, where):
                _read(included, lookup, is_active=True, depth=depth + 1)
        elif keyword == "identityfile":
            lookup.settings.setdefault(keyword, []).extend(words[:1])
        elif keyword in _READ and words:
            lookup.settings.setdefault(keyword, words)


def _lines(file: Path) -> Iterator[tuple[int, str, list[str]]]:
    if not file.is_file():
        return
    text = untrusted.read_bytes(file, max_bytes=SSH_CONFIG_BYTES_MAX).decode("utf-8", "replace")
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        parts = _LINE.fullmatch(line.strip())
        try:
            if parts is None or "\0" in line:
                raise ValueError("expected a keyword and its value")
            yield number, parts[1].lower(), shlex.split(parts[2], comments=True)
        except ValueError as error:
            raise UsageError(f"{file}: line {number}: {error}") from error


def _included(patterns: list[str], where: str) -> Iterator[Path]:
    for pattern in patterns:
        try:
            path = FILE.expanduser().parent / Path(pattern).expanduser()
        except RuntimeError as error:
            raise UsageError(f"{where}: {error}") from error
        # Unlike Path.glob, it accepts every text, and returns nothing for an impossible one.
        yield from map(Path, sorted(glob.glob(str(path))))  # noqa: PTH207


def _is_named(patterns: list[str], name: str) -> bool:
    """Whether a list of patterns names a host: a pattern fits, and no pattern with ``!`` excludes it."""
    fitting = [pattern for pattern in patterns if matches(pattern.removeprefix("!").lower(), name.lower())]
    return bool(fitting) and not any(pattern.startswith("!") for pattern in fitting)


def _is_matched(words: list[str], lookup: _Lookup, where: str) -> bool:
    """Evaluate the criteria of a Match line in their order, up to the first that fails."""
    remaining = iter(words)
    for word in remaining:
        criterion, _, argument = word.lower().removeprefix("!").partition("=")
        if criterion == "all":
            continue
        values = {
            "host": lookup.first("hostname") or lookup.alias,
            "originalhost": lookup.alias,
            "user": lookup.user or lookup.first("user") or _local_user(),
            "localuser": _local_user(),
        }
        if criterion not in values:
            print_note(f"rtrun: {where}: Match {criterion} is not evaluated: the lines under it are left out")
            return False
        patterns = (argument or next(remaining, "")).split(",")
        if _is_named(patterns, values[criterion]) == word.startswith("!"):
            return False
    return True


def _expand(file: Path, text: str, tokens: Mapping[str, str]) -> str:
    """Replace the tokens of ssh_config(5), such as ``%h``."""
    try:
        return re.sub("%(.?)", lambda token: {**tokens, "%": "%"}[token[1]], text)
    except KeyError as error:
        raise UsageError(f"{file}: {text}: the token %{error.args[0]} is not known here") from error


def _paths(file: Path, words: list[str], tokens: Mapping[str, str]) -> tuple[Path, ...]:
    try:
        return tuple(Path(_expand(file, word, tokens)).expanduser() for word in words if word.lower() != "none")
    except RuntimeError as error:
        raise UsageError(f"{file}: {' '.join(words)}: {error}") from error


def _local_user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        # A user of a container may have no name.
        return str(os.getuid())


def _port(file: Path, text: str) -> int:
    try:
        return untrusted.whole_number(text, lowest=1, highest=65535)
    except ValueError as error:
        raise UsageError(f"{file}: port {text!r}: expected a number from 1 to 65535") from error
