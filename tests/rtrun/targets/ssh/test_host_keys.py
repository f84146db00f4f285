"""Host keys as OpenSSH knows them: a real sshd with host certificates of a real ssh-keygen."""

import base64
import re
import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import pytest

from ports import free_port
from rtrun.targets.address import Address
from rtrun.targets.connection import Connection
from rtrun.targets.errors import TargetError
from rtrun.targets.ssh import host_keys
from rtrun.targets.ssh.host_keys import HostKeys, matches, parse_certificate, read_host_key, read_host_keys

SSHD = shutil.which("sshd", path="/usr/sbin:/usr/bin:/sbin") or "/usr/sbin/sshd"


def make_key(path: Path, kind: str = "ed25519") -> str:
    """Make a key pair and return the public key, type and base64."""
    subprocess.run(["ssh-keygen", "-q", "-t", kind, "-N", "", "-f", path], check=True)
    return " ".join(Path(f"{path}.pub").read_text().split()[:2])


def fingerprint(path: Path) -> str:
    done = subprocess.run(["ssh-keygen", "-l", "-f", path], capture_output=True, text=True, check=True)
    return done.stdout.split()[1]


def sign(authority: Path, key: Path, *options: str) -> None:
    """Make `key`-cert.pub."""
    argv = ["ssh-keygen", "-q", "-s", authority, "-I", "test", *options, f"{key}.pub"]
    subprocess.run(argv, check=True, capture_output=True)


class CertifiedServer:
    """An sshd with copies of these keys; `certify` gives one of them a certificate, and `start` serves."""

    def __init__(self, folder: Path, keys: dict[str, Path], authorized: Path) -> None:
        self.folder = folder
        self.keys = {kind: Path(shutil.copy(path, folder)) for kind, path in keys.items()}
        for path in keys.values():
            shutil.copy(f"{path}.pub", folder)
        self.public = {kind: " ".join(Path(f"{path}.pub").read_text().split()[:2]) for kind, path in keys.items()}
        self.authority = folder / "authority"
        self.authority_public = make_key(self.authority)
        self.lines = [f"HostKey {path}" for path in self.keys.values()]
        self.authorized = authorized
        self.port = free_port()
        self.process: subprocess.Popen | None = None

    def certify(self, kind: str, *options: str, authority: Path | None = None) -> None:
        sign(authority or self.authority, self.keys[kind], *options)
        self.lines.append(f"HostCertificate {self.keys[kind]}-cert.pub")

    def start(self) -> None:
        config = self.folder / "config"
        config.write_text(
            "\n".join(
                [
                    f"Port {self.port}\nListenAddress 127.0.0.1\nPidFile none\nStrictModes no\nUsePAM no",
                    f"AuthorizedKeysFile {self.authorized}\nMaxStartups 100\nSetEnv SHLVL=1",
                    *self.lines,
                ]
            )
            + "\n"
        )
        with (self.folder / "log").open("wb") as log:
            self.process = subprocess.Popen([SSHD, "-D", "-e", "-f", config], stdout=log, stderr=log)
        while "Server listening" not in (self.folder / "log").read_text():
            assert self.process.poll() is None, (self.folder / "log").read_text()
            time.sleep(0.02)

    def stop(self) -> None:
        if self.process:
            self.process.terminate()
            self.process.wait(60)


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """A key of each type, made once: an RSA key takes a second or more."""
    folder = tmp_path_factory.mktemp("keys")
    keys = {kind: folder / f"host_{kind}" for kind in ("ed25519", "ecdsa", "rsa")}
    for kind, path in keys.items():
        make_key(path, kind)
    return keys


@pytest.fixture
def server(sshd, keys, tmp_path):
    folder = tmp_path / "server"
    folder.mkdir()
    server = CertifiedServer(folder, keys, sshd.folder / "authorized_keys")
    yield server
    server.stop()


@pytest.fixture
def known_hosts(tmp_path):
    return tmp_path / "known_hosts"


@pytest.fixture
def log_in(server, sshd, known_hosts):
    """Log in at the server, which is started now, with these lines of known_hosts."""

    def log_in(*lines: str, **changed) -> None:
        if server.process is None:
            server.start()
        known_hosts.write_text("\n".join(lines) + "\n")
        address = replace(sshd.address, port=server.port, host_key=None, known_hosts=(known_hosts,))
        Connection(replace(address, **changed)).close()
        if not changed:
            # OpenSSH is of the same opinion.
            options = [f"-oUserKnownHostsFile={known_hosts}", "-oStrictHostKeyChecking=yes", "-oBatchMode=yes"]
            argv = ["ssh", "-F", "none", *options, "-oGlobalKnownHostsFile=none", "-i", sshd.key]
            argv += ["-p", str(server.port), f"{sshd.user}@127.0.0.1", "true"]
            done = subprocess.run(argv, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr

    return log_in


pytestmark = pytest.mark.sshd


@pytest.mark.parametrize("kind", ["ed25519", "ecdsa", "rsa"])
@pytest.mark.parametrize("authority", ["ed25519", "rsa"])
def test_a_host_certificate(server, log_in, tmp_path, kind, authority):
    public = make_key(tmp_path / "other-authority", authority)
    server.certify(kind, "-h", "-n", "127.0.0.1,board", authority=tmp_path / "other-authority")
    log_in(f"@cert-authority * {public}")


def test_a_certificate_that_names_no_host_is_for_every_host(server, log_in):
    server.certify("ed25519", "-h")
    log_in(f"@cert-authority * {server.authority_public}")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-h", "-n", "other"], "it is for other, not for 127.0.0.1"),
        (["-h", "-V", "20200101:20200102"], "it is not valid now"),
        (["-h", "-O", "critical:test@board=1"], "it has critical options"),
    ],
)
def test_a_certificate_that_does_not_count(server, log_in, options, message):
    server.certify("ed25519", *options)
    with pytest.raises(TargetError, match=rf"unknown host key.*vouches for it: {message}"):
        log_in(f"@cert-authority * {server.authority_public}")
    log_in(f"@cert-authority * {server.authority_public}", f"[127.0.0.1]:{server.port} {server.public['ed25519']}")


def test_an_authority_is_no_host_key(server, log_in):
    with pytest.raises(TargetError, match="unknown host key"):
        log_in(f"@cert-authority * {server.public['ed25519']}")


def test_a_certificate_of_another_authority(server, log_in, tmp_path):
    server.certify("ed25519", "-h", authority=tmp_path / "server" / "authority")
    other = make_key(tmp_path / "other")
    with pytest.raises(TargetError, match=r"vouches for it: it is signed by SHA256:"):
        log_in(f"@cert-authority * {other}")


def test_a_revoked_key_is_refused(server, log_in):
    host = f"[127.0.0.1]:{server.port}"
    key = server.public["ed25519"]
    for lines in ([f"{host} {key}", f"@revoked * {key}"], [f"@revoked * {key}", f"{host} {key}"]):
        with pytest.raises(TargetError, match="is revoked in"):
            log_in(*lines)


@pytest.mark.parametrize("is_fingerprint", [False, True])
def test_a_revoked_key_of_the_target_file_is_refused(sshd, tmp_path, is_fingerprint):
    known = tmp_path / "known_hosts"
    pinned = fingerprint(sshd.folder / "host_key.pub") if is_fingerprint else sshd.host_key
    address = replace(sshd.address, host_key=pinned, known_hosts=(known,))
    for line in (f"* {sshd.host_key}", f"@revoked elsewhere {sshd.host_key}", f"@revoked * {make_key(tmp_path / 'k')}"):
        known.write_text(f"{line}\n")
        Connection(address).close()
    known.write_text(f"@revoked * {sshd.host_key}\n")
    with pytest.raises(TargetError, match="is revoked in known_hosts: somebody else may answer"):
        Connection(address)


def test_a_revoked_authority_is_refused(server, log_in, tmp_path):
    server.certify("ed25519", "-h")
    authority = server.authority_public
    with pytest.raises(TargetError, match=r"unknown host key|authority of the host certificate is revoked"):
        log_in(f"@cert-authority * {authority}", f"@revoked * {authority}")
    other, plain = make_key(tmp_path / "other"), f"[127.0.0.1]:{server.port} {server.public['ed25519']}"
    with pytest.raises(TargetError, match="authority of the host certificate is revoked"):
        log_in(f"@cert-authority * {other}", plain, f"@revoked * {authority}")


@pytest.mark.parametrize(
    "hosts", ["*", "127.0.0.?", "[127.*]:{port}", "a,[127.0.0.1]:{port},b", "127.0.0.1", "!other,127.*"]
)
def test_patterns_of_hosts(server, log_in, hosts):
    log_in(f"{hosts.format(port=server.port)} {server.public['ed25519']}")


@pytest.mark.parametrize("hosts", ["!*127.0*,127.*,[127.*", "other", "127.0.0.1:*", "*,!*127*"])
def test_patterns_that_are_for_other_hosts(server, log_in, hosts):
    with pytest.raises(TargetError, match="unknown host key"):
        log_in(f"{hosts} {server.public['ed25519']}")


def test_a_hashed_name(server, log_in, known_hosts, tmp_path):
    known_hosts.write_text(f"[127.0.0.1]:{server.port} {server.public['ed25519']}\n")
    subprocess.run(["ssh-keygen", "-q", "-H", "-f", known_hosts], check=True, capture_output=True)
    line = known_hosts.read_text().strip()
    assert "127.0.0.1" not in line
    log_in(line)


def test_several_keys_of_one_type(server, log_in, tmp_path):
    host, other = f"[127.0.0.1]:{server.port}", make_key(tmp_path / "other")
    log_in(f"{host} {other}", f"{host} {server.public['ed25519']}")
    log_in(f"{host} {server.public['ed25519']}", f"{host} {other}")
    with pytest.raises(TargetError, match="host key has changed"):
        log_in(f"{host} {other}")


@pytest.mark.parametrize("kind", ["ecdsa", "rsa"])
def test_the_type_that_is_listed_is_asked_for(server, log_in, kind):
    log_in(f"[127.0.0.1]:{server.port} {server.public[kind]}")


def test_a_key_of_another_type_has_not_changed(sshd, tmp_path):
    known = tmp_path / "known_hosts"
    known.write_text(f"[127.0.0.1]:{sshd.port} {make_key(tmp_path / 'other', 'rsa')}\n")
    with pytest.raises(TargetError, match=r"unknown host key .*; .*known_hosts lists only ssh-rsa"):
        Connection(replace(sshd.address, host_key=None, known_hosts=(known,)))


@pytest.mark.parametrize("kind", ["ed25519", "ecdsa", "rsa"])
def test_a_fingerprint_of_any_type(server, log_in, kind):
    # ssh-keygen pads no fingerprint; other tools do.
    log_in(host_key=fingerprint(server.keys[kind]) + "=" * (kind == "rsa"))


def test_a_fingerprint_that_no_key_has(server, log_in):
    with pytest.raises(TargetError, match=r"host key has changed: the target file says SHA256:A+, the target shows"):
        log_in(host_key="SHA256:" + "A" * 43)


@pytest.mark.parametrize(
    "line",
    [
        b"@cert-authority",
        b"@revoked",
        b"@unknown * ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIAECAwQFBgcICQoLDA0ODxAREhMUFRYXGBkaGxwdHh8g",
        b"127.0.0.1 1024 35 1234567890123456789",
        b"|1|bad hash|neither ssh-ed25519 AAAA",
        b"|1|AAAA ssh-ed25519 AAAA",
        b"|1|\xff|\xff ssh-ed25519 AAAA",
        b"* ssh-ed25519 not-base64",
        b"* ssh-ed25519 AAAAC3NzaC1lZDI1NTE5",
        b"* \xe4 AAAA",
        b"# caf\xe9",
        b"\xff\xfe\0",
        b"*" * 10_000 + b"x ssh-ed25519 AAAA",
        b",".join([b"*a*b*c*d"] * 1000) + b" ssh-ed25519 AAAA",
    ],
)
def test_lines_that_cannot_be_read_are_skipped(tmp_path, sshd, line):
    known = tmp_path / "known_hosts"
    good = f"[127.0.0.1]:22022 {sshd.host_key} ".encode() + b"caf\xe9\n"
    known.write_bytes(line + b"\n" + good + line)
    address = Address(host="127.0.0.1", port=22022, known_hosts=(known,))
    assert list(read_host_keys(address).trusted.values()) == ["ssh-ed25519"]


@pytest.mark.parametrize(
    "host_key",
    [
        "junk", "ssh-rsa", "ssh-rsa !", "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5", "", "of another type", "SHA256:short",
        "SHA256:", "SHA256:" + "A" * 42 + "B", "SHA256:" + "A" * 44, "SHA256:" + "A" * 42 + "é", "SHA256:" + "A=" * 22,
    ],
)  # fmt: skip
def test_a_host_key_that_is_none(sshd, host_key):
    if host_key == "of another type":
        host_key = sshd.host_key.replace("ssh-ed25519", "ssh-rsa")
    with pytest.raises(ValueError, match=r"is neither a fingerprint as ssh-keygen -l prints it, .* nor a public key"):
        read_host_key(host_key)


def test_a_host_in_capitals(server, log_in, tmp_path):
    hashed = tmp_path / "hashed"
    hashed.write_text(f"board {server.public['ed25519']}\n")
    subprocess.run(["ssh-keygen", "-q", "-H", "-f", hashed], check=True, capture_output=True)
    address = Address(host="BOARD", port=22, user="root", key=None, host_key=None, known_hosts=(hashed,))
    assert list(read_host_keys(address).trusted.values()) == ["ssh-ed25519"]
    server.certify("ed25519", "-h", "-n", "localhost")
    log_in(f"@cert-authority * {server.authority_public}", host="LOCALHOST")


def test_what_is_listed_and_revoked_is_not_asked_for(server, known_hosts):
    """A server that has another key that is listed, or no certificate of this authority, is logged in at by that."""
    revoked, authority = server.public["ed25519"], server.authority_public
    lines = [f"board {revoked}", f"board {server.public['ecdsa']}", f"@revoked * {revoked}"]
    known_hosts.write_text("\n".join([*lines, f"@cert-authority * {authority}", f"@revoked * {authority}"]) + "\n")
    address = Address(host="board", port=22, user="root", key=None, host_key=None, known_hosts=(known_hosts,))
    assert read_host_keys(address).types == ["ecdsa-sha2-nistp256"]


def test_matching_takes_linear_time():
    assert not matches("*a" * 2000 + "b", "a" * 4000)
    assert matches("a*b?", "axxbc") and not matches("a?", "a") and matches("*", "")


def test_a_certificate_for_a_user_is_none_for_a_host(tmp_path):
    make_key(tmp_path / "authority")
    make_key(tmp_path / "key")
    known = HostKeys(source="here", trusted={}, authorities=frozenset({fingerprint(tmp_path / "authority")}))
    for options, objection in (([], "it is not a certificate for a host"), (["-h"], "")):
        sign(tmp_path / "authority", tmp_path / "key", "-n", "board", *options)
        certificate = parse_certificate(base64.b64decode((tmp_path / "key-cert.pub").read_text().split()[1]))
        assert host_keys._objection(certificate, "board", known) == objection
    forged = replace(certificate, signed=certificate.signed[:-1] + b"x")
    assert host_keys._objection(forged, "board", known) == "its signature is wrong"


def test_every_cut_of_a_certificate_is_refused(tmp_path):
    make_key(tmp_path / "authority")
    make_key(tmp_path / "key")
    sign(tmp_path / "authority", tmp_path / "key", "-h", "-n", "a,b")
    blob = base64.b64decode((tmp_path / "key-cert.pub").read_text().split()[1])
    assert parse_certificate(blob).principals == ("a", "b")
    for size in range(len(blob)):
        with pytest.raises(ValueError, match=re.compile("early|type|behind|bytes")):
            parse_certificate(blob[:size])
    with pytest.raises(ValueError, match="it goes on behind its signature"):
        parse_certificate(blob + b"x")
