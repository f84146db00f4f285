"""What a connection does the same over SSH, against a real sshd, and on this machine."""

import pytest

from rtrun.targets.address import ThisMachine
from rtrun.targets.connection import Connection


@pytest.fixture(params=[pytest.param("sshd", marks=pytest.mark.sshd), "this machine"])
def connection(request):
    address = request.getfixturevalue("sshd").address if request.param == "sshd" else ThisMachine()
    connection = Connection(address)
    yield connection
    connection.close()


def test_arguments_arrive_as_they_are(connection):
    words = ["a b", "$HOME", "'", '"', "*", "\\", "", "ä", "x\ny"]
    assert connection.check(["printf", "%s\\0", *words]).split("\0")[:-1] == words


def test_status_and_both_streams(connection):
    done = connection.run(["sh", "-c", "echo out; echo err >&2; exit 7"])
    assert (done.status, done.stdout, done.stderr) == (7, "out\n", "err\n")
