"""A reply on the port of the ROS master that no master gives; whether ours runs."""

import fcntl
import socket
from pathlib import PurePosixPath

import pytest

from rtrun.execution.middleware import roscpp
from rtrun.targets.errors import TargetError
from rtrun.targets.link import Link

REPLY = (
    "<methodResponse><params><param><value><array><data><value><int>1</int></value><value>{}</value>"
    "<value><int>12</int></value></data></array></value></param></params></methodResponse>"
)


def test_a_reply_that_defines_entities_is_refused():
    assert roscpp._parse_reply(REPLY.format("x").encode()) == (1, "x", 12)
    harmless = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "x">]>' + REPLY.format("&b;")
    with pytest.raises(ValueError, match="not an XML-RPC reply"):
        roscpp._parse_reply(harmless.encode())


def test_no_more_is_read_of_a_reply_than_a_master_sends(monkeypatch):
    monkeypatch.setattr(roscpp, "REPLY_BYTES_MAX", 10)
    here, there = socket.socketpair()
    with here, there:
        there.sendall(b"HTTP/1.0 200 OK\r\n\r\n" + b"x" * 1000)
        there.shutdown(socket.SHUT_WR)
        with pytest.raises(ValueError, match="HTTP status 200, 11 bytes"):
            roscpp._post(here, b"")


@pytest.mark.sshd
def test_a_master_runs_as_long_as_its_lock_is_taken(link, tmp_path):
    folder = PurePosixPath(tmp_path)
    assert not roscpp._is_running(link, folder)
    with (tmp_path / "rosmaster.lock").open("w") as lock:
        assert not roscpp._is_running(link, folder)
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert roscpp._is_running(link, folder)


@pytest.mark.sshd
@pytest.mark.root
def test_a_lock_that_fails_is_no_running_master(without_locks, tmp_path):
    """It was taken for one, and an answer of it was awaited for a minute."""
    (tmp_path / "rosmaster.lock").touch()
    with (
        Link(without_locks, print) as link,
        pytest.raises(TargetError, match="whether the ROS master runs is not known: flock: Function not implemented"),
    ):
        roscpp._is_running(link, PurePosixPath(tmp_path))
