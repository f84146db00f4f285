"""The host keys that a target may show: from the target file, or from known_hosts as OpenSSH reads it (sshd(8)).

Host certificates are understood as in OpenSSH's PROTOCOL.certkeys: a certificate counts when an authority of
known_hosts signed it for this host, and its plain key may be listed as well.
"""

import base64
import fnmatch
import hashlib
import hmac
import shlex
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rtfiles import untrusted
from rtrun.targets.address import Address
from rtrun.targets.errors import TargetError

if TYPE_CHECKING:
    import paramiko

CERTIFICATE = "-cert-v01@openssh.com"
KNOWN_HOSTS_BYTES_MAX = 8 * untrusted.MIB  #: a known_hosts file
# The number of fields of a public key, which are between the nonce and the serial number of its certificate.
_KEY_FIELDS = {
    "ssh-ed25519": 1,
    "ecdsa-sha2-nistp256": 2,
    "ecdsa-sha2-nistp384": 2,
    "ecdsa-sha2-nistp521": 2,
    "ssh-rsa": 2,
}
_HOST_CERTIFICATE = 2
_MARKERS = {b"@cert-authority": "authority", b"@revoked": "revoked"}


@dataclass(frozen=True, slots=True, kw_only=True)
class HostKeys:
    """The host keys of one target, by fingerprint. `source` is where they are listed, for messages."""

    source: str
    trusted: Mapping[str, str]
    """Fingerprint to type of key; the type is empty where only the fingerprint is known."""
    authorities: frozenset[str] = frozenset()
    revoked: frozenset[str] = frozenset()

    @property
    def is_fingerprint(self) -> bool:
        """Whether only a fingerprint is known; the key may have any type."""
        return "" in self.trusted.values()

    @property
    def types(self) -> list[str]:
        """The names of signature algorithms whose keys can be checked, certificates first."""
        plain = [name for kind in self.trusted.values() if kind for name in _algorithms(kind)]
        return [name + CERTIFICATE for kind in _KEY_FIELDS for name in _algorithms(kind) if self.authorities] + plain


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """The parts of a certificate that decide whether it counts. Times are in seconds since 1970."""

    type: int
    principals: tuple[str, ...]
    valid_after: int
    valid_before: int
    critical_options: bytes
    authority: bytes
    signed: bytes
    signature: bytes


class UnacceptedHostKey(TargetError):
    """The target showed a host key that is not accepted; it may have others."""


def fingerprint(blob: bytes) -> str:
    """Return the fingerprint of a public key as OpenSSH prints it: ``SHA256:`` and base64 without padding."""
    return fingerprint_of(hashlib.sha256(blob).digest())


def fingerprint_of(digest: bytes) -> str:
    """Return the fingerprint for a SHA-256. Raises ValueError for another length."""
    if len(digest) != hashlib.sha256().digest_size:
        raise ValueError("a SHA-256 has 32 bytes")
    return "SHA256:" + base64.b64encode(digest).decode().rstrip("=")


def base_type(algorithm: str) -> str:
    """The type of key that signs under this name. An RSA key has several names; each name has one for certificates."""
    plain = algorithm.removesuffix(CERTIFICATE)
    return "ssh-rsa" if plain.startswith("rsa-sha2-") else plain


def _algorithms(kind: str) -> tuple[str, ...]:
    # SHA-1 signatures, under the name ssh-rsa, are not accepted any more.
    return ("rsa-sha2-512", "rsa-sha2-256") if kind == "ssh-rsa" else (kind,)


def read_host_keys(address: Address) -> HostKeys:
    """Return the host keys that are accepted from a target. Raises UsageError, from known_hosts.

    A key of the target file is accepted unless known_hosts revokes it; as in OpenSSH, nothing overrides a revocation.
    """
    listed = _read_known_hosts(address)
    if address.host_key is None:
        return listed
    trusted = read_host_key(address.host_key)
    return HostKeys(source="the target file", trusted=trusted, revoked=listed.revoked)


def _read_known_hosts(address: Address) -> HostKeys:
    paths = [path.expanduser() for path in address.known_hosts]
    source = " and ".join(map(str, paths)) or "no known_hosts file"
    files = (untrusted.read_bytes(path, max_bytes=KNOWN_HOSTS_BYTES_MAX) for path in paths if path.is_file())
    content = b"\n".join(files)
    host = address.host.lower()
    if address.port == 22:
        return _listed(source, content, host)
    keys = _listed(source, content, f"[{host}]:{address.port}")
    # As OpenSSH: a host that is listed without its port is known on every port.
    return keys if keys.trusted or keys.authorities else _listed(source, content, host)


def read_host_key(text: str) -> dict[str, str]:
    """Return fingerprint and type (empty where unknown) of ``SHA256:…`` or ``type base64``. Raises ValueError."""
    try:
        if text.startswith("SHA256:"):
            digest = text.removeprefix("SHA256:").rstrip("=")
            # Fingerprints are compared as texts, so a second way to write the same bits is refused.
            if fingerprint_of(base64.b64decode(f"{digest}=", validate=True)) != f"SHA256:{digest}":
                raise ValueError
            return {f"SHA256:{digest}": ""}
        kind, encoded = text.split()[:2]
        return {fingerprint(_key_blob(kind.encode(), encoded.encode())): kind}
    except ValueError as error:
        raise ValueError(
            f"{text[:100]!r} is neither a fingerprint as ssh-keygen -l prints it, SHA256: and 43 characters, nor a "
            "public key, 'type base64'"
        ) from error


def _listed(source: str, content: bytes, host: str) -> HostKeys:
    kept: dict[str, dict[str, str]] = {"trusted": {}, "authority": {}, "revoked": {}}
    for use, kind, blob in _lines(content, host):
        kept[use][fingerprint(blob)] = kind
    revoked = kept["revoked"].keys()
    return HostKeys(
        source=source,
        trusted={key: kind for key, kind in kept["trusted"].items() if key not in revoked},
        authorities=frozenset(kept["authority"].keys() - revoked),
        revoked=frozenset(revoked),
    )


def _lines(content: bytes, host: str) -> Iterator[tuple[str, str, bytes]]:
    """Yield use, type and key of each line for this host. As in OpenSSH a line that cannot be read is skipped."""
    for line in content.split(b"\n"):
        words = line.split(None, 4)
        use = "trusted"
        if words and words[0].startswith(b"@"):
            if words[0] not in _MARKERS:
                continue
            use = _MARKERS[words.pop(0)]
        if len(words) < 3 or words[0].startswith(b"#") or not _names(words[0], host):
            continue
        try:
            yield use, words[1].decode("ascii"), _key_blob(words[1], words[2])
        except ValueError:
            continue


def _key_blob(kind: bytes, encoded: bytes) -> bytes:
    """Decode a public key. Raises ValueError when it is not base64 or not of this type."""
    blob = base64.b64decode(encoded, validate=True)
    inner, rest = _take(blob)
    if inner != kind or not rest:
        raise ValueError("the key is of another type than its line says")
    return blob


def _names(patterns: bytes, host: str) -> bool:
    """Whether the first field of a line (a hash, or patterns with ``*``, ``?`` and ``!``) names this host."""
    if patterns.startswith(b"|1|"):
        try:
            salt, digest = (base64.b64decode(part, validate=True) for part in patterns[3:].split(b"|"))
        except ValueError:
            return False
        return hmac.compare_digest(hmac.digest(salt, host.encode(), "sha1"), digest)
    named = False
    for pattern in patterns.decode("latin-1").lower().split(","):
        if matches(pattern.removeprefix("!"), host):
            if pattern.startswith("!"):
                return False
            named = True
    return named


def matches(pattern: str, word: str) -> bool:
    """Whether a word matches a pattern in which ``*`` stands for any text and ``?`` for one character."""
    if "*" not in pattern and "?" not in pattern:
        return pattern == word
    # A bracket stands for itself, as in OpenSSH.
    return fnmatch.fnmatchcase(word, pattern.replace("[", "[[]"))


def check_host_key(address: Address, key: "paramiko.PKey", known: HostKeys) -> None:
    """Raise UnacceptedHostKey unless the key that a target has shown, or its certificate, is accepted."""
    shown = fingerprint(key.asbytes())
    certificate = getattr(key, "public_blob", None)
    objection = "it shows no certificate"
    if certificate is not None:
        try:
            parsed = parse_certificate(certificate.key_blob)
            if fingerprint(parsed.authority) in known.revoked:
                raise TargetError(f"{address}: the authority of the host certificate is revoked in known_hosts")
            objection = _objection(parsed, address.host.lower(), known)
        except ValueError as error:
            objection = f"its certificate cannot be read: {error}"
    if shown in known.revoked:
        raise TargetError(f"{address}: the host key {shown} is revoked in known_hosts: somebody else may answer")
    if not objection or shown in known.trusted:
        return
    name = key.get_name()
    expected = [trusted for trusted, kind in known.trusted.items() if kind in ("", name)]
    if expected:
        raise UnacceptedHostKey(
            f"{address}: the host key has changed: {known.source} says {' or '.join(expected)}, the target shows "
            f"{shown} ({name}); if the board was installed anew, correct it there, otherwise somebody else answers"
        )
    listed = f"; {known.source} lists only {', '.join(sorted(set(known.trusted.values())))}" if known.trusted else ""
    signed = f"; no certificate authority of {known.source} vouches for it: {objection}" if known.authorities else ""
    raise UnacceptedHostKey(f"{address}: unknown host key {shown} ({name}){listed}{signed}; {_remedy(address, shown)}")


def _remedy(address: Address, shown: str) -> str:
    """How to make a host key known, once the user has compared it."""
    files = [str(path.expanduser()) for path in address.known_hosts]
    if not address.is_jump:
        listing = f" or add the host to {' and '.join(files)}" if files else ""
        return f"compare it with the board's, then put 'host_key: {shown}' into the target file{listing}"
    if not files:
        return "this is a jump host, whose key must be listed: name a UserKnownHostsFile for it in ~/.ssh/config"
    ssh = ["ssh", "-o", f"UserKnownHostsFile={files[0]}", "-p", str(address.port), f"{address.user}@{address.host}"]
    return (
        "this is a jump host, so a host_key in the target file is not for it: call "
        f"{shlex.join(ssh)} once, compare the key that it shows with the jump host's own, and answer yes"
    )


def parse_certificate(blob: bytes) -> Certificate:
    """Take a certificate apart (PROTOCOL.certkeys). Raises ValueError."""
    kind, rest = _take(blob)
    fields = _KEY_FIELDS.get(base_type(kind.decode("ascii")))
    if fields is None:
        raise ValueError(f"unknown type {kind[:40]!r}")
    for _ in range(1 + fields):
        _, rest = _take(rest)
    number, rest = _number(rest[8:], 4)
    _, rest = _take(rest)
    names, rest = _take(rest)
    principals = []
    while names:
        name, names = _take(names)
        principals.append(name.decode("utf-8"))
    valid_after, rest = _number(rest, 8)
    valid_before, rest = _number(rest, 8)
    critical, rest = _take(rest)
    _, rest = _take(rest)
    _, rest = _take(rest)
    authority, signature_field = _take(rest)
    signature, end = _take(signature_field)
    if end:
        raise ValueError("it goes on behind its signature")
    return Certificate(
        type=number,
        principals=tuple(principals),
        valid_after=valid_after,
        valid_before=valid_before,
        critical_options=critical,
        authority=authority,
        signed=blob[: len(blob) - len(signature_field)],
        signature=signature,
    )


def _objection(certificate: Certificate, host: str, known: HostKeys) -> str:
    """Say why a host certificate does not count; empty when it does."""
    if fingerprint(certificate.authority) not in known.authorities:
        return f"it is signed by {fingerprint(certificate.authority)}"
    if certificate.type != _HOST_CERTIFICATE:
        return "it is not a certificate for a host"
    if certificate.critical_options:
        return "it has critical options, which no host certificate may have"
    if not certificate.valid_after <= time.time() < certificate.valid_before:
        return "it is not valid now; look at the clocks and renew it"
    # As OpenSSH: a certificate without principals is for every host.
    if certificate.principals and not any(matches(principal.lower(), host) for principal in certificate.principals):
        return f"it is for {', '.join(certificate.principals)}, not for {host}"
    if not _is_signed(certificate):
        return "its signature is wrong"
    return ""


def _is_signed(certificate: Certificate) -> bool:
    import paramiko

    kind, _ = _take(certificate.authority)
    try:
        authority = paramiko.PKey.from_type_string(kind.decode("ascii"), certificate.authority)
        return bool(authority.verify_ssh_sig(certificate.signed, paramiko.Message(certificate.signature)))
    except Exception:
        # paramiko and its libraries may raise anything on bytes that are no key or no signature.
        return False


def _take(data: bytes) -> tuple[bytes, bytes]:
    """Split off a string as SSH writes it (RFC 4251, section 5). Raises ValueError."""
    size, rest = _number(data, 4)
    if len(rest) < size:
        raise ValueError("it ends early")
    return rest[:size], rest[size:]


def _number(data: bytes, size: int) -> tuple[int, bytes]:
    if len(data) < size:
        raise ValueError("it ends early")
    return int.from_bytes(data[:size], "big"), data[size:]
