"""Receivers of rtrun notify that answer anything, or never: each is one that was not told, and the next one is told."""

import contextlib
import itertools
import os
import socket
import sys
import threading
import time
from pathlib import Path

import pytest
import yaml

from rtfiles.errors import InfrastructureError
from rtrun.archive import receivers
from rtrun.archive.alarms import Alarm
from rtrun.archive.receivers import CommandReceiver, HookReceiver, MailReceiver, tell
from rtrun.cli import main

ALARM = Alarm(kind="worse", about="a", size="s", since="d", suspected="x", page=None, key="0" * 64)
OK = b"HTTP/1.1 200 OK\r\n"
# What a server sends, piece by piece; None: nothing more, for as long as the other side is there.
HTTP = {
    "drips a header": [OK, *itertools.repeat(b"X", 10_000)],
    "drips header lines": [OK, *itertools.repeat(b"X: y\r\n", 10_000)],
    "continues without end": itertools.repeat(b"HTTP/1.1 100 Continue\r\n\r\n"),
    "says nothing": [None],
    "stops in the status line": [b"HTTP/1.1 2", None],
    "is no HTTP": [b"220 mail.example.org ESMTP\r\n"],
    "has no status": [b"HTTP/1.1 \r\n\r\n"],
    "has a status of many digits": [b"HTTP/1.1 " + b"9" * 5000 + b"\r\n\r\n"],
    "is a flood of one line": [OK, b"X: ", *itertools.repeat(b"y" * 65536, 16)],
    "is 10 000 header lines": [OK, b"X: y\r\n" * 10_000, b"\r\n"],
    "is bytes of no text": [bytes(range(256)) * 100],
    "leads elsewhere": [b"HTTP/1.1 302 Found\r\nLocation: file:///etc/passwd\r\n\r\n"],
    "leads to itself": [b"HTTP/1.1 307 Found\r\nLocation: /\r\n\r\n"],
    "closes at once": [],
    "has terminal commands": [b"HTTP/1.1 500 \x1b]0;owned\x07\x1b[2J\r\n\r\n"],
}
SMTP = {
    "drips its greeting": [b"2", *itertools.repeat(b"2", 10_000)],
    "greets without end": itertools.repeat(b"220-welcome\r\n" * 1000),
    "says nothing ever": [None],
    "is no mail server": [b"HTTP/1.1 200 OK\r\n\r\n", None],
    "greets in one long line": [b"220 " + b"x" * 1_000_000 + b"\r\n", None],
    "refuses": [b"554 no\r\n"],
}
SLOWLY = {"drips a header", "drips header lines", "drips its greeting"}


@contextlib.contextmanager
def serving(name, pieces):
    """A server of loopback that sends these pieces to everybody, whatever it is asked."""
    ended = threading.Event()

    def answer(connection):
        with contextlib.suppress(OSError), connection:
            for piece in pieces:
                if piece is None:
                    ended.wait()
                    return
                connection.sendall(piece)
                if ended.is_set() or (name in SLOWLY and ended.wait(0.05)):
                    return
            connection.shutdown(socket.SHUT_WR)
            while connection.recv(65536):  # a reset would take back what was sent
                pass

    def accept(listening):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listening.accept()
                threading.Thread(target=answer, args=(connection,), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=accept, args=(listening,), daemon=True).start()
        try:
            yield listening.getsockname()[1]
        finally:
            ended.set()
            listening.shutdown(socket.SHUT_RDWR)


def hook(port):
    return HookReceiver(name="x", kind="hook", url=f"http://127.0.0.1:{port}/")


def mail(port):
    data = {"name": "x", "kind": "mail", "server": f"127.0.0.1:{port}", "from": "a@b.org", "to": ["c@d.org"]}
    return MailReceiver.model_validate(data)


CASES = [*[(hook, name, pieces) for name, pieces in HTTP.items()], *[(mail, *case) for case in SMTP.items()]]


@pytest.mark.parametrize(("receiver", "name", "pieces"), CASES, ids=[name for _, name, _ in CASES])
def test_a_server_that_is_hostile_was_not_told(monkeypatch, receiver, name, pieces):
    """It ends within the time of one receiver, with one line of text."""
    monkeypatch.setattr(receivers, "RECEIVE_S", 3.0)
    with serving(name, pieces) as port, pytest.raises(InfrastructureError) as refused:
        tell(receiver(port), [ALARM], None)
    text = str(refused.value)
    assert text.startswith("x: not told: ") and text.isprintable() and len(text) < 400


def test_a_look_up_without_an_answer_takes_no_longer(monkeypatch, tmp_path):
    """Python waits for its resolver without a time-out. A stand-in for delivering is one that never returns."""
    monkeypatch.setattr(receivers, "RECEIVE_S", 1.0)
    (tmp_path / "python").write_text("#!/bin/sh\nexec sleep 300\n")
    (tmp_path / "python").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    with pytest.raises(InfrastructureError, match="not done within 1 s"):
        tell(hook(1), [ALARM], None)


def command(*words):
    return CommandReceiver(name="x", kind="command", command=[*words])


@pytest.mark.parametrize(
    "script",
    [
        "yes 0123456789 | head -c 200000000 >&2",  # more than a pipe holds, and more than is kept
        "exec <&-",  # it does not read
        "sleep 300 & echo $! >pid",  # in the background, with its standard error
        "(while sleep 0.01; do echo still here >&2; done) & echo $! >pid",
    ],
)
def test_a_command_was_told_whatever_it_leaves(tmp_path, monkeypatch, script):
    monkeypatch.chdir(tmp_path)
    alarms = [ALARM] * 20_000  # more than a pipe holds
    tell(command("sh", "-c", script), alarms, None)
    if (tmp_path / "pid").exists():
        os.kill(int((tmp_path / "pid").read_text()), 9)  # it was left alone


def test_a_command_that_does_not_end_is_ended_with_what_it_started(tmp_path, monkeypatch):
    monkeypatch.setattr(receivers, "RECEIVE_S", 2.0)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InfrastructureError, match="not done within 2 s"):
        tell(command("sh", "-c", "sleep 301 & echo $! >pid; trap '' TERM INT; wait"), [ALARM], None)
    status = Path(f"/proc/{int((tmp_path / 'pid').read_text())}/status")
    until = time.monotonic() + 60
    while status.exists() and "State:\tZ" not in status.read_text():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        (
            "yes no >&2 & sleep 0.1; kill $!; wait $!; echo '\033[2Jthe last line' >&2; exit 5",
            "sh ended with 5: ?[2Jthe last line",
        ),
        ("kill -9 $$", "sh ended with -9: "),
        ("printf '%01000d' 0 >&2; exit 1", "sh ended with 1: 0000"),
        ("exit 1", "sh ended with 1"),
    ],
)
def test_a_command_that_fails_says_why_in_one_line(script, reason):
    with pytest.raises(InfrastructureError) as refused:
        tell(command("sh", "-c", script), [ALARM], None)
    assert reason in str(refused.value) and str(refused.value).isprintable() and len(str(refused.value)) < 400


def test_all_others_are_told_whatever_stands_before_them(capsys, tmp_path, monkeypatch):
    """One call, all hostile servers first; the one at the end is told once, and by the next call not again."""
    from archive.archived import write_course

    monkeypatch.setattr(receivers, "RECEIVE_S", 10.0)
    write_course(tmp_path / "archive", [100.0] * 8 + [120.0] * 8)
    with contextlib.ExitStack() as stack:
        listed = []
        for name in ("is no HTTP", "is 10 000 header lines", "continues without end", "refuses"):
            port = stack.enter_context(serving(name, HTTP.get(name) or SMTP[name]))
            receiver = hook(port) if name in HTTP else mail(port)
            listed.append({**receiver.model_dump(by_alias=True), "name": name})
        listed.append({"name": "no program", "kind": "command", "command": ["/nowhere/at all"]})
        listed.append({"name": "last", "kind": "command", "command": ["sh", "-c", f"cat >>{tmp_path}/heard"]})
        (tmp_path / "lab.yml").write_text(yaml.safe_dump({"schema": 1, "receivers": listed}))
        for _ in range(2):
            assert main(["notify", str(tmp_path / "lab.yml"), str(tmp_path / "archive")]) == 3
            err = capsys.readouterr().err
            assert all(f"{receiver['name']}: not told: " in err for receiver in listed[:-1]) and "last: not" not in err
    assert (tmp_path / "heard").read_text().count("WORSE") == 1


HOSTS = [
    "a..b",
    "[::1",
    "::1]",
    "[::1]]",
    "[a.b]",
    "",
    "a" * 64,
    "a b",
    "a:b:c",
    "a@b",
    "\u2024a",
    "a\x00b",
    "-:x",
    "a:0",
    "a:65536",
]


@pytest.mark.parametrize("host", HOSTS)
@pytest.mark.parametrize("kind", ["hook", "site", "mail", "coordinator"])
def test_a_host_that_is_none_is_refused_when_the_file_is_read(capsys, tmp_path, kind, host):
    """Whatever is asked for is refused before anybody is told."""
    place = host if ":" in host.rpartition("]")[2] or kind == "coordinator" else f"{host}:1"
    receiver = {
        "hook": {"kind": "hook", "url": f"http://{place}/"},
        "mail": {"kind": "mail", "server": place, "from": "a@b.org", "to": ["a@b.org"]},
    }.get(kind, {"kind": "command", "command": ["false"]})
    config = {"schema": 1, "receivers": [{"name": "x", **receiver}]}
    config |= {"site": {"site": f"https://{place}/x"}, "coordinator": {"coordinator": place}}.get(kind, {})
    (tmp_path / "lab.yml").write_text(yaml.safe_dump(config))
    assert main(["notify", str(tmp_path / "lab.yml"), "archive"]) == 2
    err = capsys.readouterr().err
    key = {"hook": "url", "mail": "server"}.get(kind, kind)
    assert f"{key}: " in err and "Traceback" not in err and "no archive" not in err


@pytest.mark.parametrize(
    "place", ["a.b:25", "localhost:1", "127.0.0.1:65535", "[::1]:25", "a_b:2", "xn--bcher-kva.example:9"]
)
def test_a_host_that_is_one(place):
    assert HookReceiver(name="x", kind="hook", url=f"https://{place}/a?b#c").url
    data = {"name": "x", "kind": "mail", "server": place, "from": "a@b.org", "to": ["c@d.org"]}
    assert MailReceiver.model_validate(data).server == place


def test_a_nul_in_a_command_is_refused_when_the_file_is_read(capsys, tmp_path):
    receiver = {"name": "x", "kind": "command", "command": ["echo", "a\0b"]}
    (tmp_path / "lab.yml").write_text(yaml.safe_dump({"schema": 1, "receivers": [receiver]}))
    assert main(["notify", str(tmp_path / "lab.yml"), "archive"]) == 2
    assert "command.1: " in capsys.readouterr().err
