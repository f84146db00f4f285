"""Tests that run beside one another: what there is once is used by one worker."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from ports import free_port


@pytest.mark.trace
def test_a_group_reaches_the_scheduler(request: pytest.FixtureRequest) -> None:
    """It goes by what stands behind the last @."""
    assert request.node.nodeid.endswith("@trace") or not hasattr(request.config, "workerinput")


def test_a_port_is_given_out_once() -> None:
    """Before anybody listens on it, to whichever process asks."""
    script = "from ports import free_port\nprint(*[free_port() for _ in range(300)])\ninput()"
    command = [sys.executable, "-c", script]
    asking = [
        subprocess.Popen(command, cwd=Path(__file__).parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    given = [int(port) for process in asking if process.stdout for port in process.stdout.readline().split()]
    for process in asking:
        process.communicate("\n", timeout=60)
    assert len(given) == len(set(given)) == 600
    with socket.create_server(("127.0.0.1", free_port())):
        pass
