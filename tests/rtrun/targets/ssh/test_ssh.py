"""The SSH connection against a real sshd."""

import socket
import subprocess
import threading
import time
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest

from rtrun.targets.address import Address
from rtrun.targets.connection import Connection, Listing, listing, parse_listing
from rtrun.targets.errors import ConnectionLost, DeadlineExpired, TargetError

pytestmark = pytest.mark.sshd


@pytest.fixture
def connection(sshd):
    connection = Connection(sshd.address)
    yield connection
    connection.close()


def test_large_output_on_both_streams(connection):
    done = connection.run(
        ["sh", "-c", "head -c 3000000 /dev/zero | tr '\\0' a; head -c 3000000 /dev/zero | tr '\\0' b >&2"]
    )
    assert (len(done.stdout), len(done.stderr)) == (3_000_000, 3_000_000)


def test_standard_input(connection):
    assert connection.check(["cat"], stdin="x" * 200_000) == "x" * 200_000


def test_failure_names_the_command_and_what_it_said(connection):
    with pytest.raises(TargetError, match=r"ls failed with exit status 2: .*no-such-file"):
        connection.check(["ls", "/no-such-file"])


def test_deadline_ends_everything_that_was_started(connection, tmp_path):
    pids = tmp_path / "pids"
    with pytest.raises(DeadlineExpired, match="sh took longer than 5 s and was ended"):
        connection.run(["sh", "-c", f"echo $$ >{pids}; sleep 300 & echo $! >>{pids}; wait"], deadline_s=5)
    deadline = time.monotonic() + 60
    for pid in pids.read_text().split():
        status = Path(f"/proc/{pid}/status")
        while status.exists() and "Z (zombie)" not in status.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.05)


def test_no_delay_and_authenticated_cipher(connection):
    link = connection.shell.stream.carrier
    assert link.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
    assert connection.shell.transport.remote_cipher == "aes128-gcm@openssh.com"


def test_files_both_ways(connection, tmp_path):
    (tmp_path / "up").write_bytes(bytes(range(256)) * 4096)
    connection.upload(tmp_path / "up", PurePosixPath(tmp_path / "there"))
    (tmp_path / "back").mkdir()
    connection.download(PurePosixPath(tmp_path), {"there": 256 * 4096}, tmp_path / "back")
    assert (tmp_path / "back" / "there").read_bytes() == (tmp_path / "up").read_bytes()


def test_more_than_the_target_has_told_is_refused(connection, tmp_path):
    (tmp_path / "big").write_bytes(b"x" * 1001)
    (tmp_path / "back").mkdir()
    with pytest.raises(TargetError, match="more than the 1000 bytes that were expected"):
        connection.download(PurePosixPath(tmp_path), {"big": 1000}, tmp_path / "back")


def test_a_listing_has_the_regular_files_that_were_asked_for(connection, tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "a folder").mkdir()
    (tmp_path / "link").symlink_to("/etc/passwd")
    for number in range(3):
        (tmp_path / f"trace-{number}").touch()
        (tmp_path / "a folder" / f"trace-{number}").touch()

    def listed(*names, matches_max=16):
        command = listing(PurePosixPath(tmp_path), names, matches_max=matches_max)
        return parse_listing(connection.check(command))

    assert listed("file", "a folder", "link", "none") == Listing(sizes={"file": 5}, total=6)
    assert listed("trace-*", "none*").sizes == dict.fromkeys((f"trace-{number}" for number in range(3)), 0)
    assert len(listed("trace-*", matches_max=2).sizes) == 2
    assert listed() == Listing(sizes={}, total=6)


def test_nobody_listens(sshd):
    with pytest.raises(ConnectionLost, match="cannot connect: Connection refused"):
        Connection(Address(host="127.0.0.1", port=1, key=sshd.key, host_key=sshd.host_key))


def test_somebody_listens_who_is_no_ssh_server(sshd):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            link, _ = server.accept()
            link.sendall(b"HTTP/1.0 400 Bad Request\r\n\r\n")
            link.close()

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(ConnectionLost, match="SSH did not come up"):
            Connection(Address(host="127.0.0.1", port=server.getsockname()[1], key=sshd.key, host_key=sshd.host_key))
        thread.join()


def test_changed_host_key_is_refused(sshd):
    other = "SHA256:" + "A" * 43
    with pytest.raises(TargetError, match=f"has changed: the target file says {other}, the target shows SHA256"):
        Connection(replace(sshd.address, host_key=other))


def test_known_hosts_decides_without_a_fingerprint(sshd, tmp_path):
    known = tmp_path / "known_hosts"
    address = replace(sshd.address, host_key=None, known_hosts=(known,))
    with pytest.raises(TargetError, match=r"unknown host key SHA256:.*put 'host_key: SHA256:"):
        Connection(address)
    known.write_text(f"[127.0.0.1]:{sshd.port} {sshd.host_key}\n")
    Connection(address).close()
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / "other"], check=True)
    changed = " ".join((tmp_path / "other.pub").read_text().split()[:2])
    known.write_text(f"[127.0.0.1]:{sshd.port} {changed}\n")
    with pytest.raises(TargetError, match="host key has changed"):
        Connection(address)


def test_a_key_that_may_not_log_in(sshd, tmp_path):
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / "key"], check=True)
    with pytest.raises(TargetError, match=r"may not log in with .*/key: authorise the key on the target"):
        Connection(replace(sshd.address, key=tmp_path / "key"))


@pytest.mark.parametrize(
    ("content", "message"), [(None, "does not exist"), ("junk", "cannot be read"), ("", "cannot be read")]
)
def test_a_key_file_that_is_none(sshd, tmp_path, content, message):
    if content is not None:
        (tmp_path / "key").write_text(content)
    with pytest.raises(TargetError, match=message):
        Connection(replace(sshd.address, key=tmp_path / "key"))


def test_a_key_with_a_passphrase(sshd, tmp_path):
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "secret", "-f", tmp_path / "key"], check=True)
    with pytest.raises(TargetError, match="has a passphrase: load it into ssh-agent"):
        Connection(replace(sshd.address, key=tmp_path / "key"))


def test_agent(sshd, tmp_path, monkeypatch):
    agent = subprocess.Popen(["ssh-agent", "-D", "-a", tmp_path / "agent"], stdout=subprocess.DEVNULL)
    try:
        while not (tmp_path / "agent").exists():
            assert agent.poll() is None
        monkeypatch.setenv("SSH_AUTH_SOCK", str(tmp_path / "agent"))
        with pytest.raises(TargetError, match="no key: name one as 'key'"):
            Connection(replace(sshd.address, key=None))
        subprocess.run(["ssh-add", "-q", sshd.key], check=True)
        Connection(replace(sshd.address, key=None)).close()
    finally:
        agent.terminate()
        agent.wait()


def test_a_broken_link_is_a_lost_connection(connection):
    connection.shell.stream.shut_down()
    with pytest.raises(ConnectionLost):
        connection.run(["true"])


def test_a_link_that_breaks_in_the_middle(connection):
    threading.Timer(0.3, lambda: connection.shell.stream.shut_down()).start()
    with pytest.raises(ConnectionLost):
        connection.run(["sleep", "20"])


def test_port_of_the_target(connection):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with connection.open_port(port, deadline_s=20) as channel:
            link, _ = server.accept()
            link.sendall(b"hello")
            assert channel.recv(5) == b"hello"
            link.close()
    with pytest.raises(ConnectionRefusedError), connection.open_port(port, deadline_s=20):
        pass
