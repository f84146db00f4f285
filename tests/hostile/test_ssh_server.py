"""The runner against a target that sends too much, too slowly, nonsense, or nothing.

Each action runs in a process of its own: it ends with one of our errors, in time, and within MEMORY_MIB.
"""

import re
import socket
import struct
import subprocess
import threading
import time

import paramiko
import pytest

from hostile.server import BLOCK, act, honest, serving

pytestmark = pytest.mark.sshd

MEMORY_MIB = 300
RUN = "with Link(target, print) as link: link.run(['true'], deadline_s={deadline})"
LIST = (
    "from rtrun.targets.connection import listing, parse_listing\n"
    "with Link(target, print) as link: parse_listing(link.check(listing(PurePosixPath('/'), ['a'], matches_max=1)))"
)
COPY = (
    "with Link(target, print) as link:"
    " link.do(lambda c: c.download(PurePosixPath('/etc'), {'passwd': 1000}, Path(folder)))"
)
STATE = (
    "from rtrun.targets.inspection import facts as inspection\n"
    "with Link(target, print) as link: inspection.read_state(link, PurePosixPath('/state.sh'))"
)
ASK = (
    "from rtrun.execution.middleware import roscpp\n"
    "with Link(target, print) as link: assert roscpp.ask_pid(link) is None"
)


@pytest.fixture(scope="session")
def key(tmp_path_factory):
    path = tmp_path_factory.mktemp("key") / "key"
    paramiko.RSAKey.generate(2048).write_private_key_file(str(path))
    return path


def unless_boot_id(behaviour):
    """The target answers which boot it is, as the runner asks first, and then shows what it is."""

    def act(channel, command):
        (honest if b"boot_id" in command and b"state.sh" not in command else behaviour)(channel, command)

    return act


def endless_output(channel, command):
    while True:
        channel.sendall(BLOCK)


def endless_errors(channel, command):
    channel.sendall(b"1\n")
    while True:
        channel.sendall_stderr(BLOCK)


def endless_lines(channel, command):
    channel.sendall(b"1\n")
    while True:
        channel.sendall(b"ab\n" * 10_000)


def endless_listing(channel, command):
    channel.sendall(b"1\n")
    for number in range(1_000_000_000):
        channel.sendall(b"-rw-r--r-- 1 0 0 5 Nov 22 03:20 %d\n" % number)


def a_byte_now_and_then(channel, command):
    channel.sendall(b"1\n")
    while True:
        channel.sendall(b"x")
        time.sleep(1)


def silence(channel, command):
    time.sleep(3600)


def status_before_output(channel, command):
    channel.sendall(b"1\n")
    channel.send_exit_status(0)
    time.sleep(3600)


def hang_up(channel, command):
    channel.transport.close()


def past_the_window(channel, command):
    """Data without end, whatever the other side has room for."""
    message = paramiko.Message()
    message.add_byte(bytes([94]))
    message.add_int(channel.remote_chanid)
    message.add_string(BLOCK)
    while True:
        channel.transport._send_message(message)


@pytest.mark.parametrize(
    ("behaviour", "action", "outcome"),
    [
        (endless_output, RUN.format(deadline=60), "TargetError: .* printed more than"),
        (endless_errors, RUN.format(deadline=60), "TargetError: .*true printed more than 2 MiB"),
        (endless_lines, RUN.format(deadline=60), "TargetError: .*true printed more than 2 MiB"),
        (endless_lines, STATE, "TargetError: .*sh printed more than 2 MiB"),
        (past_the_window, RUN.format(deadline=60), "TargetError: .*(printed more|sends more than it was asked for)"),
        (endless_listing, LIST, "TargetError: .*sh printed more than 2 MiB"),
        (endless_output, COPY, "TargetError: .*(more than the 1000 bytes|first line)"),
        (endless_lines, COPY, "TargetError: .*more than the 1000 bytes that were expected"),
        (a_byte_now_and_then, RUN.format(deadline=3), "DeadlineExpired: .*true took longer than 3 s"),
        (silence, RUN.format(deadline=3), "DeadlineExpired: .*true took longer than 3 s and may go on"),
        (status_before_output, RUN.format(deadline=3), "DeadlineExpired: .*true took longer than 3 s"),
        (hang_up, RUN.format(deadline=3), "ConnectionLost: .*5th connection to break at the same step"),
    ],
    ids=lambda value: getattr(value, "__name__", None) or "",
)
def test_a_command(behaviour, action, outcome, key, tmp_path):
    with serving(unless_boot_id(behaviour)) as server:
        result = act(action, server, key, tmp_path)
    assert re.search(outcome, result["outcome"]), result
    assert result["peak_mib"] < MEMORY_MIB and result["seconds"] < 90


SECRET = "01234567-89ab-cdef-0123-456789abcdef"
WHOLE = f"{{other}} {SECRET}\n"


@pytest.mark.parametrize(
    "answer",
    [
        *("1\n", "0\n", "-1\n", "\n", "none\n", "{other}", "{other}\n", "{other} {other}\n"),
        *(f"1 {SECRET}\n", f"{{other}} {SECRET}", f"{{other}} {SECRET}\r\n", WHOLE),
    ],
)
def test_the_process_that_a_command_was_started_as(answer, key, tmp_path):
    """Only what was started is killed: not every process there is, nor one whose number the target makes up."""
    heard = []
    with subprocess.Popen(["sleep", "600"], start_new_session=True) as other:

        def claims(channel, command):
            if command.endswith(b"exec true"):
                channel.sendall(answer.format(other=other.pid).encode())
                time.sleep(3600)
            heard.append(command)
            if answer == WHOLE:
                honest(channel, command)

        try:
            with serving(unless_boot_id(claims)) as server:
                result = act(RUN.format(deadline=1), server, key, tmp_path)
            assert re.search("DeadlineExpired: .*true took longer than 1 s and may go on", result["outcome"]), result
            assert other.poll() is None
            assert bool(heard) == (answer == WHOLE)
        finally:
            other.kill()


def http(reply: bytes, repeat: bytes = b""):
    def serve(channel):
        channel.recv(10_000)
        channel.sendall(reply)
        while repeat:
            channel.sendall(repeat)
        channel.close()

    return serve


def slow_http(channel):
    while True:
        channel.sendall(b"H")
        time.sleep(1)


XML = b"HTTP/1.0 200 OK\r\n\r\n"
LAUGHS = (
    b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a "'
    + b"ha" * 50_000
    + b'"><!ENTITY b "'
    + b"&a;" * 1000
    + b'">]><methodResponse><params><param><value><string>&b;</string></value></param></params></methodResponse>'
)
HUGE_PID = (
    b"<methodResponse><params><param><value><array><data><value><int>1</int></value><value>x</value>"
    b"<value><bigdecimal>1e999999999</bigdecimal></value></data></array></value></param></params></methodResponse>"
)


@pytest.mark.parametrize(
    "stream",
    [
        http(b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n<html><body>hello</body></html>"),
        http(b"HTTP/1.0 404 Not Found\r\n\r\n"),
        http(b"SSH-2.0-OpenSSH_9.2\r\n"),
        http(XML, BLOCK),
        http(b"HTTP/1.0 200 OK\r\n", b"X-Header: " + b"x" * 60_000 + b"\r\n"),
        http(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", b"8000\r\n" + BLOCK + b"\r\n"),
        http(XML + LAUGHS),
        http(XML + HUGE_PID),
        http(XML + b"<methodResponse>" + b"<params>" * 200_000),
        slow_http,
    ],
)
def test_what_is_no_master(stream, key, tmp_path):
    with serving(honest, stream) as server:
        result = act(ASK, server, key, tmp_path)
    assert result["outcome"] == "done" or "sends more than it was asked for" in result["outcome"]
    assert result["peak_mib"] < MEMORY_MIB and result["seconds"] < 60


def talking(talk):
    """A TCP server on loopback; `talk` gets each connection."""
    listener = socket.create_server(("127.0.0.1", 0))

    def accept():
        while True:
            try:
                link, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=talk, args=(link,), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return listener


def repeating(first, block, pause_s=0.0):
    def talk(link):
        try:
            link.sendall(first)
            while True:
                link.sendall(block)
                time.sleep(pause_s)
        except OSError:
            pass

    return talk


@pytest.mark.parametrize(
    "talk",
    [
        repeating(b"", b"no end of a line "),
        repeating(b"", b"x", 1),
        repeating(b"", b"a line\r\n"),
        repeating(b"SSH-2.0-x\r\n", b"\xff" * 32768),
        repeating(b"SSH-2.0-x\r\n" + struct.pack(">I", 0x7FFFFFFC), BLOCK),
        repeating(b"SSH-2.0-x\r\n", b"\0", 1),
    ],
    ids=["endless banner line", "a byte now and then", "endless banner", "noise", "huge packet", "slow packet"],
)
def test_what_is_no_ssh_server(talk, key, tmp_path):
    with talking(talk) as listener:
        server = (listener.getsockname()[1], "SHA256:" + "A" * 43)
        result = act("Link(target, print).__enter__()", server, key, tmp_path)
        listener.shutdown(socket.SHUT_RDWR)
    assert result["outcome"].startswith("ConnectionLost: ")
    assert result["peak_mib"] < MEMORY_MIB and result["seconds"] < 90
