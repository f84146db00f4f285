"""`rtrun new-target` with a real sshd: on a terminal it asks, elsewhere it takes options."""

import os
import pty
import sys
from pathlib import Path

import pytest
import yaml

from conftest import seeing, serve
from rtfiles.errors import InfrastructureError, UsageError
from rtrun.cli import main
from rtrun.targets.config import read_target
from rtrun.targets.ssh.host_keys import _key_blob, fingerprint


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home folder whose ~/.ssh/config knows the port and the key of nobody, and no SSH agent."""
    (tmp_path / "home" / ".ssh").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "home"


@pytest.fixture
def shown(sshd):
    """The fingerprint of the sshd's host key."""
    kind, encoded = sshd.host_key.split()
    return fingerprint(_key_blob(kind.encode(), encoded.encode()))


@pytest.fixture
def options(sshd):
    return ["--host", "127.0.0.1", "--port", str(sshd.port), "--user", sshd.user, "--key", str(sshd.key)]


@pytest.mark.root
@pytest.mark.sshd
def test_by_options(home, options, shown, sshd, capsys, monkeypatch):
    status = main(["new-target", *options, "--host-key", shown, "--name", "board"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"board.yml: target board ({sshd.user}@127.0.0.1:{sshd.port})"
    assert lines[1].startswith(("in the way of real time: ", "nothing grave stands in the way"))
    lacks = [line for line in lines[2:] if line.startswith("the board lacks ")]
    # No suites are installed in the folders of a package here.
    assert status == 0 and lacks == lines[2:]
    assert any("cyclic_timer_tests" in line and "rtgen suites build --on board.yml" in line for line in lacks)
    assert yaml.safe_load(Path("board.yml").read_text()) == {
        "schema": 1,
        "name": "board",
        "kind": "ssh",
        "host": "127.0.0.1",
        "user": sshd.user,
        "port": sshd.port,
        "key": str(sshd.key),
        "host_key": shown,
    }
    assert main(["check-rt", "--target", "board.yml"]) in (0, 1)


@pytest.mark.sshd
def test_the_kernels_of_a_card_are_in_the_target_file(home, capsys):
    """tests/rtgen/test_card_boot.py does so with a real card."""
    programs = home / "sbin"
    programs.mkdir()
    listing = programs / "boot-kernel"
    listing.write_text("#!/bin/sh\n[ $# -eq 0 ] && printf 'rt\\nother\\nstandard\\n'\n")
    listing.chmod(0o755)
    # A folder in the PATH of a login over SSH, and seldom with something in it.
    with serve(home, seeing({"/usr/local/bin": programs})) as server:
        words = ["--port", str(server.port), "--user", server.user, "--key", str(server.key)]
        (home / ".ssh/known_hosts").write_text(f"[127.0.0.1]:{server.port} {server.host_key}\n")
        main(["new-target", "--host", "127.0.0.1", *words, "--name", "card"])
    config = read_target(Path("card.yml"))
    assert config.restart == ["reboot"]
    assert config.boot_kernel == {"standard": ["boot-kernel", "standard"], "rt": ["boot-kernel", "rt"]}


@pytest.mark.sshd
def test_an_unknown_key_is_not_accepted_without_a_terminal(home, options, shown, capsys):
    assert main(["new-target", *options]) == InfrastructureError.exit_status
    (line,) = capsys.readouterr().err.splitlines()
    assert f"unknown host key {shown} (ssh-ed25519): compare it with" in line and f"add --host-key {shown}" in line
    other = "SHA256:" + "A" * 43
    assert main(["new-target", *options, "--host-key", other]) == InfrastructureError.exit_status
    assert "the host key has changed" in capsys.readouterr().err
    assert not list(Path().glob("*.yml"))


@pytest.mark.sshd
def test_a_host_that_is_known(home, sshd, options, capsys):
    """What the configuration of ssh says is left to it."""
    (home / ".ssh/known_hosts").write_text(f"[127.0.0.1]:{sshd.port} {sshd.host_key}\n")
    text = f"Host lab\n  HostName 127.0.0.1\n  Port {sshd.port}\n  User {sshd.user}\n  IdentityFile {sshd.key}\n"
    (home / ".ssh/config").write_text(text)
    main(["new-target", "--host", "lab"])
    assert yaml.safe_load(Path("lab.yml").read_text()) == {"schema": 1, "name": "lab", "kind": "ssh", "host": "lab"}
    before = Path("lab.yml").read_bytes()
    assert main(["new-target", "--host", "lab"]) == UsageError.exit_status
    assert "lab.yml: exists already: name another file with --output" in capsys.readouterr().err
    assert Path("lab.yml").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "new-target: no host: give --host"),
        (["--host", "a b"], "new-target: host: expected the name or the address of a host"),
        (["--host", "board", "--port", "0"], "new-target: port: "),
        (["--host", "board", "--name", "a/b"], "new-target: name: "),
        (
            ["--host", "board", "--key", "nowhere", "--host-key", "SHA256:" + "A" * 43],
            "nowhere: No such file or directory",
        ),
        (
            ["--host", "board", "--host-key", "SHA256:short"],
            "new-target: host_key: 'SHA256:short' is neither a fingerprint",
        ),
        (["--host", "board", "--key", "~nosuchuser/x"], "new-target: key: the user of '~nosuchuser' is unknown"),
    ],
)
def test_options_that_are_wrong(home, capsys, monkeypatch, words, message):
    monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: PTH123, SIM115
    assert main(["new-target", *words]) == UsageError.exit_status
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def on_a_terminal(words, answers):
    """Call rtrun on a terminal, give each answer to its question, and return what the terminal shows."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-m", "rtrun.cli", *words])
    output = b""

    def read():
        nonlocal output
        try:
            data = os.read(terminal, 1000)
        except OSError:
            # The other end of a terminal closes in this way.
            data = b""
        output += data
        return bool(data)

    for question, answer in answers:
        while question not in output:
            assert read(), output.decode()
        os.write(terminal, f"{answer}\n".encode())
    while read():
        pass
    _, status = os.waitpid(pid, 0)
    os.close(terminal)
    return os.waitstatus_to_exitcode(status), output.decode()


@pytest.mark.sshd
@pytest.mark.parametrize("answer", ["yes", "fingerprint"])
def test_on_a_terminal(home, sshd, shown, answer):
    words = ["new-target", "--port", str(sshd.port), "--user", sshd.user, "--name", "board"]
    answers = [
        (b"host (name", "127.0.0.1"),
        (b"private key file", str(sshd.key)),
        (b"is it the board's?", shown if answer == "fingerprint" else answer),
    ]
    _, text = on_a_terminal(words, answers)
    assert f"shows the host key {shown} (ssh-ed25519)" in text and "ssh_host_ed25519_key.pub" in text
    assert "board.yml: target board" in text
    assert read_target(Path("board.yml")).host_key == shown


@pytest.mark.sshd
@pytest.mark.parametrize("answer", ["no", "", "SHA256:" + "A" * 43])
def test_a_key_that_the_user_does_not_accept(home, options, answer):
    status, text = on_a_terminal(["new-target", *options], [(b"is it the board's?", answer)])
    assert status == UsageError.exit_status and "the host key was not accepted: nothing was written" in text
    assert not list(Path().glob("*.yml"))
