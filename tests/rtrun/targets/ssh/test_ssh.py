"""The SSH connection against a real sshd; what every connection does is in test_every_connection.py."""

import socket
import subprocess
import threading
from dataclasses import replace

import pytest

from rtrun.targets.address import Address
from rtrun.targets.connection import Connection
from rtrun.targets.errors import ConnectionLost, TargetError

pytestmark = pytest.mark.sshd


@pytest.fixture
def connection(sshd):
    connection = Connection(sshd.address)
    yield connection
    connection.close()


def test_no_delay_and_authenticated_cipher(connection):
    link = connection.shell.stream.carrier
    assert link.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
    assert connection.shell.transport.remote_cipher == "aes128-gcm@openssh.com"


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
        monkeypatch.setenv("SSH_AUTH_SOCK", str(tmp_path / "agent"))
        # 2: it does not answer yet.
        while subprocess.run(["ssh-add", "-l"], capture_output=True, check=False).returncode == 2:
            assert agent.poll() is None
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
