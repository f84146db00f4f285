"""A reply on the port of the ROS master that no master gives."""

import socket

import pytest

from rtrun.execution.middleware import roscpp

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
