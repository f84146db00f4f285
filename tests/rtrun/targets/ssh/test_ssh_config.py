"""~/.ssh/config: what a target file leaves open is as `ssh` would have it."""

import os
import pty
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from conftest import serve
from rtfiles.errors import UsageError
from rtrun.targets.connection import Connection
from rtrun.targets.errors import ConnectionLost, TargetError
from rtrun.targets.ssh import login
from rtrun.targets.ssh.ssh_config import JUMPS_MAX, address_of


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home folder without an SSH agent, and without passphrases that another test has given."""
    (tmp_path / "home" / ".ssh").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USER", "me")
    monkeypatch.setenv("LOGNAME", "me")
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    monkeypatch.setattr(login, "_unlocked", {})
    return tmp_path / "home"


@pytest.fixture
def write(home):
    def write_config(text: str, name: str = "config") -> None:
        (home / ".ssh" / name).write_text(text)

    return write_config


def test_without_a_file(home):
    address = address_of("board")
    assert str(address) == "root@board:22" and address.jump is None and not address.identities_only
    assert [path.name for path in address.identities] == ["id_rsa", "id_ecdsa", "id_ed25519"]
    assert address.known_hosts == (home / ".ssh/known_hosts",)


ALIAS = """
# a comment
Host myboard other*
    HostName=%h.lab
    Port = 2222
    User "pi"
    IdentityFile ~/keys/%r@%h   # of the lab
    IdentityFile /keys/%%
    IdentityAgent ~/agent
    IdentitiesOnly yes
    UserKnownHostsFile ~/known1 "~/known 2"
Host *
    User late
    Port 23
    IdentityFile ~/last
"""


def test_an_alias(home, write):
    write(ALIAS)
    address = address_of("myboard")
    assert str(address) == "pi@myboard.lab:2222"
    assert address.identities == (home / "keys/pi@myboard.lab", Path("/keys/%"), home / "last")
    assert address.identities_only and address.agent == "~/agent"
    assert address.known_hosts == (home / "known1", home / "known 2")
    assert str(address_of("elsewhere")) == "late@elsewhere:23"


def test_the_target_file_comes_first(write):
    write(ALIAS)
    given = {"user": "root", "port": 22, "key": Path("/key"), "host_key": "SHA256:x", "known_hosts": Path("/known")}
    address = address_of("myboard", **given)
    assert str(address) == "root@myboard.lab:22"
    assert (address.key, address.host_key, address.known_hosts) == (Path("/key"), "SHA256:x", (Path("/known"),))


@pytest.mark.parametrize(
    ("line", "matched"),
    [
        ("Host board", True),
        ("HOST BOARD", True),
        ("Host b?a* x", True),
        ("Host * !board", False),
        ("Host !board", False),
        ("Host oard", False),
        ("Match all", True),
        ("Match host board", True),
        ("Match host=other,board", True),
        ("Match !host board", False),
        ("Match !host other", True),
        ("Match originalhost board user pi", True),
        ("Match user root", False),
        ("Match localuser me", True),
        ("Match localuser you", False),
    ],
)
def test_lines_that_choose(write, line, matched):
    write(f"{line}\n  Port 99\n")
    assert address_of("board", user="pi").port == (99 if matched else 22)


def test_include_of_what_cannot_be(write):
    write(f"Include {'9' * 5000} none*\nPort 2222\n")
    assert address_of("board").port == 2222


def test_include_keeps_to_its_section(home, write):
    write("Host other\n  Include no.conf\nHost board\n  Include [ab].conf\n  User last\n")
    write("Port 1\n", "no.conf")
    write("Port 2222\nHost other\n  User wrong\n", "a.conf")
    write("Port 3333\nHostName there\n", "b.conf")
    assert str(address_of("board")) == "last@there:2222"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Include config\n", "line 1: more than 16 files include each other"),
        ("Port 70000\n", "port '70000': expected a number from 1 to 65535"),
        ("Port\n", "line 1: expected a keyword and its value"),
        ('User "me\n', "line 1: No closing quotation"),
        ("HostName a/b\n", "HostName of board: expected the name or the address of a host"),
        ("Include ~nosuchuser/x\n", "line 1: Could not determine home directory"),
        ("IdentityFile %Z\n", "the token %Z is not known here"),
        ("HostName %\n", "the token % is not known here"),
        ("IdentityFile ~nosuchuser/x\n", "Could not determine home directory"),
        ("ProxyCommand touch /x\n", "ProxyCommand for board: rtrun runs no command to connect; write ProxyJump"),
        ("ProxyJump a:b:c\n", r"ProxyJump for board: 'a:b:c' is not \[user@\]host\[:port\]"),
        ("ProxyJump gate\n", "ProxyJump leads in a circle: board -> gate -> gate$"),
        ("Host a*\n ProxyJump %h\nHost board\n ProxyJump board\n", "in a circle: board -> board"),
    ],
)
def test_what_cannot_be_followed(home, write, text, message):
    write(text)
    with pytest.raises(UsageError, match=message) as error:
        address_of("board")
    assert str(error.value).startswith(f"{home}/.ssh/config: ") and "\n" not in str(error.value)


def test_a_long_row_of_jump_hosts(write):
    write("".join(f"Host h{number}\n  ProxyJump h{number + 1}\n" for number in range(JUMPS_MAX + 2)))
    with pytest.raises(UsageError, match="leads in a circle"):
        address_of("h0")
    assert address_of("h5").jump is not None


def test_nothing_is_executed(home, write, capsys):
    write(f'Match user pi exec "touch {home}/ran"\n  Port 99\nHost board\n  ProxyCommand none\n')
    assert address_of("board").port == 22
    assert capsys.readouterr().err == ""
    assert address_of("board", user="pi").port == 22
    note = capsys.readouterr().err
    assert note == f"rtrun: {home}/.ssh/config: line 1: Match exec is not evaluated: the lines under it are left out\n"
    assert not (home / "ran").exists()


def test_jump_hosts(write):
    write(
        "Host board\n  ProxyJump pi@first:24,second\n"
        "Host first\n  HostName first.lab\n  ProxyJump [::1]:2200\n"
        "Host second\n  User root\n  ProxyJump nowhere\n"
    )
    address = address_of("board")
    hops = []
    while address is not None:
        hops.append(str(address))
        address = address.jump
    assert hops == ["root@board:22", "root@second:22", "pi@first.lab:24", "me@[::1]:2200"]


def test_no_jump_host(write):
    write("Host board\n  ProxyJump none\nHost *\n  ProxyJump gate\n")
    assert address_of("board").jump is None


# With the real sshd.


@pytest.fixture
def myboard(sshd, home, write):
    """`ssh myboard` leads to the sshd: alias, port, user, key and known hosts are in the configuration alone."""
    (home / "known").write_text(f"[127.0.0.1]:{sshd.port} {sshd.host_key}\n")
    text = (
        f"Host myboard\n  HostName 127.0.0.1\n  Port {sshd.port}\n  User {sshd.user}\n"
        f"  IdentityFile {sshd.key}\n  UserKnownHostsFile ~/known\n"
    )
    write(text)
    return text


@pytest.mark.sshd
def test_an_alias_leads_there(myboard):
    connection = Connection(address_of("myboard"))
    assert connection.check(["echo", "there"]) == "there\n"
    connection.close()


@pytest.mark.sshd
def test_host_keys_stay_checked(myboard, write):
    write("StrictHostKeyChecking no\n" + myboard.replace("~/known", "/dev/null"))
    with pytest.raises(TargetError, match="unknown host key SHA256:"):
        Connection(address_of("myboard"))


@pytest.mark.sshd
def test_a_key_of_the_home_folder(sshd, myboard, write, home):
    write(myboard.replace("IdentityFile", "# IdentityFile"))
    with pytest.raises(TargetError, match="no key"):
        Connection(address_of("myboard"))
    shutil.copy(sshd.key, home / ".ssh/id_ed25519")
    (home / ".ssh/id_rsa").write_text("junk")
    Connection(address_of("myboard")).close()


@pytest.mark.sshd
def test_an_agent_that_is_gone_hinders_no_file(myboard, home, monkeypatch):
    monkeypatch.setenv("SSH_AUTH_SOCK", str(home / "gone"))
    Connection(address_of("myboard")).close()


def make_locked(path):
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "secret", "-f", path], check=True)
    return path


@pytest.mark.sshd
def test_only_the_agent_has_the_key_of_a_public_file(sshd, myboard, write, home, tmp_path):
    public = Path(f"{sshd.key}.pub")
    agent = subprocess.Popen(["ssh-agent", "-D", "-a", tmp_path / "agent"], stdout=subprocess.DEVNULL)
    try:
        while not (tmp_path / "agent").exists():
            assert agent.poll() is None
        environment = os.environ | {"SSH_AUTH_SOCK": str(tmp_path / "agent")}
        subprocess.run(["ssh-add", "-q", sshd.key], check=True, env=environment)
        shutil.copy(public, home / "id.pub")
        only = myboard.replace(str(sshd.key), "~/id.pub") + "  IdentitiesOnly yes\n"
        write(only + f"  IdentityAgent {tmp_path}/agent\n")
        Connection(address_of("myboard")).close()
        write(only.replace("id.pub", "none.pub") + f"  IdentityAgent {tmp_path}/agent\n")
        with pytest.raises(TargetError, match="no key"):
            Connection(address_of("myboard"))
        write(only)
        with pytest.raises(TargetError, match="no key"):
            Connection(address_of("myboard"))
    finally:
        agent.terminate()
        agent.wait()


LOGIN = """
import sys
from rtrun.targets.connection import Connection
from rtrun.targets.ssh.ssh_config import address_of
from rtfiles.errors import InfrastructureError
try:
    for _ in range(2):
        connection = Connection(address_of("myboard"))
        print(connection.check(["echo", "there"]).strip())
        connection.close()
except InfrastructureError as error:
    print(error)
"""


@pytest.fixture
def locked(sshd, myboard, write, tmp_path):
    """A key with a passphrase that the sshd accepts, in the configuration."""
    key = make_locked(tmp_path / "locked")
    accepted = sshd.folder / "authorized_keys"
    before = accepted.read_text()
    accepted.write_text(before + Path(f"{key}.pub").read_text())
    write(myboard.replace(str(sshd.key), str(key)))
    yield key
    accepted.write_text(before)


@pytest.mark.sshd
def test_a_passphrase_without_a_terminal(locked):
    done = subprocess.run([sys.executable, "-c", LOGIN], stdin=subprocess.DEVNULL, capture_output=True, text=True)
    (line,) = done.stdout.splitlines()
    assert f"key {locked} has a passphrase: load it into ssh-agent (ssh-add {locked})" in line


@pytest.mark.sshd
@pytest.mark.parametrize(
    ("typed", "answer"), [(["wrong", "secret"], "there\r\nthere"), (["x", "y", "z"], "that is not its passphrase")]
)
def test_a_passphrase_on_a_terminal(locked, typed, answer):
    """Asked for once, though two connections are made."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", LOGIN])
    output = b""
    for number, passphrase in enumerate(typed, 1):
        while output.count(b"Passphrase of ") < number:
            output += os.read(terminal, 1000)
        os.write(terminal, f"{passphrase}\n".encode())
    try:
        while data := os.read(terminal, 1000):
            output += data
    except OSError:
        pass  # The other end of a terminal closes in this way.
    os.waitpid(pid, 0)
    os.close(terminal)
    text = output.decode()
    assert answer in text and text.count(f"Passphrase of {locked}: ") == len(typed) and "secret" not in text


@pytest.fixture
def gate(tmp_path, home):
    """A jump host; it is known to the user."""
    (tmp_path / "gate").mkdir()
    with serve(tmp_path / "gate") as server:
        (home / ".ssh/known_hosts").write_text(f"[127.0.0.1]:{server.port} {server.host_key}\n")
        yield server


@pytest.fixture
def behind(gate, myboard, write):
    text = (
        myboard + f"  ProxyJump gate\nHost gate\n  HostName 127.0.0.1\n  Port {gate.port}\n  IdentityFile {gate.key}\n"
    )
    text += f"  User {gate.user}\n"
    write(text)
    return text


@pytest.mark.sshd
def test_through_a_jump_host(behind, gate, tmp_path):
    connection = Connection(address_of("myboard"))
    assert connection.check(["echo", "there"]) == "there\n"
    assert "Accepted publickey" in (gate.folder / "log").read_text()
    # More than may wait unread, both ways: what was read is not counted.
    assert len(connection.check(["sh", "-c", "head -c 1800000 /dev/zero | tr '\\0' a"])) == 1_800_000
    assert connection.check(["wc", "-c"], stdin="x" * 7_000_000).split() == ["7000000"]
    for _ in range(300):
        connection.check(["true"])
    with pytest.raises(TargetError, match="printed more than 2 MiB and was ended"):
        connection.check(["cat", "/dev/zero"])
    connection.close()


@pytest.mark.sshd
def test_a_jump_host_is_ended_with_its_connection(behind):
    connection = Connection(address_of("myboard"))
    below = connection.shell.stream.carrier.get_transport()
    assert below.is_active()
    connection.close()
    assert not below.is_active()


@pytest.mark.sshd
def test_closing_after_the_jump_host_is_gone(behind):
    connection = Connection(address_of("myboard"))
    connection.shell.stream._jump.carrier.close()
    connection.close()
    connection.shell.stream.close()


@pytest.mark.sshd
def test_a_jump_host_that_ends(behind, gate):
    connection = Connection(address_of("myboard"))
    connection.shell.stream._jump.shut_down()
    with pytest.raises(ConnectionLost, match="the connection broke"):
        connection.check(["true"])
    connection.close()


@pytest.mark.sshd
def test_the_key_of_a_jump_host_is_checked(behind, gate, home, sshd):
    (home / ".ssh/known_hosts").write_text("")
    with pytest.raises(TargetError, match=rf"{gate.user}@127.0.0.1:{gate.port}: unknown host key SHA256:") as raised:
        Connection(address_of("myboard"))
    # A host_key in the target file would be taken for the target's, and the jump host stay unknown.
    message = str(raised.value)
    assert "put 'host_key" not in message and "a host_key in the target file is not for it" in message
    # What it says to call makes the key known; there it is answered as by a user who has compared it.
    (command,) = re.findall(r"call (ssh .*) once, compare", message)
    call = shlex.split(command)
    subprocess.run([call[0], "-o", "StrictHostKeyChecking=accept-new", "-o", "BatchMode=yes", *call[1:], "true"],
                   capture_output=True, check=False)  # fmt: skip
    Connection(address_of("myboard")).close()
    (home / ".ssh/known_hosts").write_text(f"[127.0.0.1]:{gate.port} {sshd.host_key}\n")
    with pytest.raises(TargetError, match="the host key has changed"):
        Connection(address_of("myboard"))


@pytest.mark.sshd
def test_behind_a_jump_host_keys_are_checked_too(behind, home):
    (home / "known").write_text("")
    with pytest.raises(TargetError, match="unknown host key SHA256:"):
        Connection(address_of("myboard"))


@pytest.mark.sshd
def test_nobody_listens_behind_the_jump_host(behind, gate):
    with pytest.raises(ConnectionLost, match=r"127.0.0.1:1: cannot connect from the jump host .*: .*Connect"):
        Connection(replace(address_of("myboard"), port=1))


@pytest.mark.sshd
def test_ipv6(sshd, home, tmp_path):
    (tmp_path / "six").mkdir()
    with serve(tmp_path / "six", host="::1") as server:
        (home / ".ssh/known_hosts").write_text(f"[::1]:{server.port} {server.host_key}\n")
        connection = Connection(address_of("::1", port=server.port, user=server.user, key=server.key))
        assert connection.check(["echo", "there"]) == "there\n"
        connection.close()
        (home / ".ssh/known_hosts").write_text("")
        with pytest.raises(TargetError, match=rf"@\[::1\]:{server.port}: unknown host key"):
            Connection(address_of("::1", port=server.port, user=server.user, key=server.key))
