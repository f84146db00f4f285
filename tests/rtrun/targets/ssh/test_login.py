"""Logging in where the first try does not do."""

import shutil
import socket
import subprocess
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import paramiko
import pytest

from ports import free_port
from rtrun.targets.connection import Connection
from rtrun.targets.errors import ConnectionLost, TargetError
from rtrun.targets.ssh import login

pytestmark = pytest.mark.sshd

SSHD = shutil.which("sshd", path="/usr/sbin:/usr/bin:/sbin") or "/usr/sbin/sshd"


@pytest.fixture
def another_sshd(sshd, tmp_path):
    """An sshd like the first, with options of its own."""
    processes = []

    def start(*options):
        port = free_port()
        lines = (sshd.folder / "config").read_text().splitlines()
        names = {option.split()[0] for option in options} | {"Port"}
        lines = [line for line in lines if line.split()[0] not in names]
        (tmp_path / "config").write_text("\n".join([f"Port {port}", *lines, *options]) + "\n")
        with (tmp_path / "log").open("wb") as log:
            process = subprocess.Popen([SSHD, "-D", "-e", "-f", tmp_path / "config"], stdout=log, stderr=log)
        processes.append(process)
        while "Server listening" not in (tmp_path / "log").read_text():
            assert process.poll() is None, (tmp_path / "log").read_text()
            time.sleep(0.02)
        return replace(sshd.address, port=port)

    yield start
    for process in processes:
        process.terminate()
        process.wait(60)


@pytest.fixture
def agent(tmp_path, monkeypatch):
    """An SSH agent; the call adds a key."""
    path = tmp_path / "agent"
    process = subprocess.Popen(["ssh-agent", "-D", "-a", path], stdout=subprocess.DEVNULL)
    while not path.exists():
        assert process.poll() is None
        time.sleep(0.02)
    monkeypatch.setenv("SSH_AUTH_SOCK", str(path))
    yield lambda key: subprocess.run(["ssh-add", "-q", key], check=True)
    process.terminate()
    process.wait()


def make_key(path, kind="ed25519"):
    subprocess.run(["ssh-keygen", "-q", "-t", kind, "-N", "", "-f", path], check=True)
    return path


def test_an_agent_with_more_wrong_keys_than_the_server_takes(sshd, agent, tmp_path):
    for number in range(13):
        agent(make_key(tmp_path / f"wrong-{number}"))
    with pytest.raises(TargetError, match="may not log in with the keys of the SSH agent"):
        Connection(replace(sshd.address, key=None))
    agent(sshd.key)
    Connection(replace(sshd.address, key=None)).close()


def test_the_keys_of_the_agent_that_are_listed_come_first(sshd, agent, tmp_path, monkeypatch):
    for name in ("other", "own"):
        agent(make_key(tmp_path / name))
    address = replace(sshd.address, key=None, identities=(tmp_path / "own",))
    public = [(tmp_path / f"{name}.pub").read_text().split()[1] for name in ("own", "other")]
    assert [key.get_base64() for key in login.read_keys(address).usable] == public
    monkeypatch.setattr(login, "AGENT_KEYS_MAX", 1)
    assert len(login.read_keys(replace(address, identities=())).usable) == 1
    with pytest.raises(TargetError, match="no key: name one as 'key'"):
        login.read_keys(replace(address, identities=(), agent="none"))


def test_a_locked_key_file_whose_key_the_agent_holds(sshd, agent, tmp_path):
    agent(make_key(tmp_path / "key"))
    lock = ["ssh-keygen", "-q", "-p", "-P", "", "-N", "secret", "-f", tmp_path / "key"]
    subprocess.run(lock, check=True, capture_output=True)
    keys = login.read_keys(replace(sshd.address, key=tmp_path / "key"))
    assert len(keys.usable) == 1 and not keys.locked, "no passphrase is asked for"


@pytest.mark.parametrize("refused", [0, 1])
def test_a_key_that_may_have_been_cut_off_is_tried_again(sshd, refused):
    """Some servers hang up before they look at the key that is one too many."""

    class Transport:
        active = True

        def auth_publickey(self, user, key):
            self.active = key != "late"
            raise EOFError if key == "late" else paramiko.AuthenticationException

        def is_active(self):
            return self.active

    keys = login.Keys(usable=[*["wrong"] * refused, "late", "last"], locked=[], source="")
    with pytest.raises(login.HungUp):
        login.log_in(Transport(), sshd.address, keys)
    assert keys.usable == (["late", "last"] if refused else ["last"])


def test_a_passphrase_that_nobody_types(sshd, tmp_path, monkeypatch):
    def end_of_input(prompt):
        raise EOFError

    monkeypatch.setattr(login.sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(login.getpass, "getpass", end_of_input)
    with pytest.raises(TargetError, match="that is not its passphrase"):
        login.unlock(sshd.address, tmp_path / "key")


def test_an_agent_that_hangs(sshd, tmp_path, monkeypatch):
    monkeypatch.setattr(login, "AGENT_S", 0.5)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "agent"))
        listener.listen()
        monkeypatch.setenv("SSH_AUTH_SOCK", str(tmp_path / "agent"))
        with pytest.raises(TargetError, match=r"the SSH agent .* has not answered for 0.5 s"):
            Connection(replace(sshd.address, key=None))


@pytest.mark.parametrize("content", [b"", b"\0\0\0\1\5", b"\xff" * 100])
def test_an_agent_that_is_none(sshd, tmp_path, monkeypatch, content):
    monkeypatch.setattr(login, "AGENT_S", 2)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "agent"))
        listener.listen()

        def answer():
            link, _ = listener.accept()
            link.recv(100)
            link.sendall(content)
            link.close()

        threading.Thread(target=answer, daemon=True).start()
        monkeypatch.setenv("SSH_AUTH_SOCK", str(tmp_path / "agent"))
        with pytest.raises(TargetError, match=r"the SSH agent \(.*\) cannot be asked"):
            Connection(replace(sshd.address, key=None))


def test_no_agent_there(sshd, tmp_path, monkeypatch):
    monkeypatch.setenv("SSH_AUTH_SOCK", str(tmp_path / "none"))
    with pytest.raises(TargetError, match="cannot be asked"):
        Connection(replace(sshd.address, key=None))
    monkeypatch.delenv("SSH_AUTH_SOCK")
    with pytest.raises(TargetError, match="no key: name one as 'key'"):
        Connection(replace(sshd.address, key=None))


def test_a_server_that_wants_a_password_besides(another_sshd):
    address = another_sshd("PasswordAuthentication yes", "AuthenticationMethods publickey,password")
    with pytest.raises(TargetError, match=r"accepted the key of user .* and wants password besides"):
        Connection(address)


def test_a_server_that_is_slow_to_answer_has_refused_nothing(another_sshd, sshd):
    # It looks for keys by a command that takes its time, before it answers.
    command = ("AuthorizedKeysCommand /bin/sleep 20", f"AuthorizedKeysCommandUser {sshd.user}")
    address = another_sshd("AuthorizedKeysFile none", *command)
    with pytest.raises(ConnectionLost, match="has not answered to the login in time"):
        Connection(address, timeout_s=2.0)


def test_a_server_that_takes_passwords_only(another_sshd):
    address = another_sshd("PasswordAuthentication yes", "PubkeyAuthentication no", "PermitRootLogin yes")
    with pytest.raises(TargetError, match=r"takes no keys from user .*, only password.*PubkeyAuthentication yes"):
        Connection(address)


def test_a_key_with_an_untrusted_certificate_beside_it(sshd, tmp_path):
    for name in ("key", "key.pub"):
        shutil.copy(Path(f"{sshd.key}.pub") if name.endswith("pub") else sshd.key, tmp_path / name)
    authority = make_key(tmp_path / "authority")
    sign = ["ssh-keygen", "-q", "-s", authority, "-I", "me", "-n", sshd.user, tmp_path / "key.pub"]
    subprocess.run(sign, check=True, capture_output=True)
    assert (tmp_path / "key-cert.pub").exists()
    Connection(replace(sshd.address, key=tmp_path / "key")).close()
    (tmp_path / "key-cert.pub").write_text("junk")
    Connection(replace(sshd.address, key=tmp_path / "key")).close()


def test_a_key_that_only_its_certificate_lets_in(another_sshd, tmp_path, sshd):
    authority = make_key(tmp_path / "authority")
    key = make_key(tmp_path / "key")
    sign = ["ssh-keygen", "-q", "-s", authority, "-I", "me", "-n", sshd.user, f"{key}.pub"]
    subprocess.run(sign, check=True, capture_output=True)
    usable = login.read_keys(replace(sshd.address, key=key)).usable
    assert [key.public_blob is not None for key in usable] == [True, False], "as OpenSSH: the certificate first"
    address = another_sshd(f"TrustedUserCAKeys {authority}.pub")
    Connection(replace(address, key=key)).close()


# ssh-keygen writes ed25519 keys in its own form only.
@pytest.mark.parametrize(
    ("kind", "form"),
    [("ed25519", "RFC4716"), ("ecdsa", "RFC4716"), ("ecdsa", "PEM"), ("rsa", "RFC4716"), ("rsa", "PEM")],
)
def test_key_files_of_every_form(sshd, another_sshd, tmp_path, kind, form):
    make_key(tmp_path / "key", kind)
    if form != "RFC4716":
        argv = ["ssh-keygen", "-q", "-p", "-m", form, "-P", "", "-N", "", "-f", tmp_path / "key"]
        subprocess.run(argv, check=True, capture_output=True)
    address = another_sshd(f"AuthorizedKeysFile {tmp_path}/key.pub")
    Connection(replace(address, key=tmp_path / "key")).close()
