"""What a connection does, whatever it is to: a target behind a real sshd, or this machine."""

from pathlib import PurePosixPath

import pytest

from rtrun.targets.address import ThisMachine
from rtrun.targets.connection import Connection, Listing, listing, parse_listing
from rtrun.targets.errors import DeadlineExpired, TargetError
from watching import wait_for_end


@pytest.fixture(params=[pytest.param("ssh", marks=pytest.mark.sshd), "local"])
def connection(request):
    is_ssh = request.param == "ssh"
    connection = Connection(request.getfixturevalue("sshd").address if is_ssh else ThisMachine())
    yield connection
    connection.close()


def test_failure_names_the_command_and_what_it_said(connection):
    assert connection.run(["no-such-program"]).status == 127
    with pytest.raises(TargetError, match=r": no-such-program failed with exit status 127: .*not found"):
        connection.check(["no-such-program"])
    with pytest.raises(TargetError, match=r": ls failed with exit status 2: .*no-such-file"):
        connection.check(["ls", "/no-such-file"])


def test_much_on_all_three_streams(connection):
    text = "x" * 900_000
    done = connection.run(["sh", "-c", "tee /dev/stderr"], stdin=text)
    assert (done.stdout, done.stderr) == (text, text)
    assert connection.run(["sh", "-c", "exec <&-; echo there"], stdin=text).stdout == "there\n", "it reads nothing"


@pytest.mark.parametrize("end", ["", "; wait"], ids=["the command has ended", "it waits"])
def test_the_deadline_ends_everything_that_was_started(connection, tmp_path, end):
    pids = tmp_path / "pids"
    with pytest.raises(DeadlineExpired, match=r": sh took longer than 5 s and was ended"):
        connection.run(["sh", "-c", f"echo $$ >{pids}; sleep 300 & echo $! >>{pids}{end}"], deadline_s=5)
    wait_for_end(pids.read_text().split())


def test_too_much_output_ends_the_command(connection):
    with pytest.raises(TargetError, match="cat printed more than 2 MiB and was ended"):
        connection.check(["cat", "/dev/zero"])


def test_files_both_ways(connection, tmp_path):
    (tmp_path / "up").write_bytes(bytes(range(256)) * 8192)
    connection.upload(tmp_path / "up", PurePosixPath(tmp_path / "there"))
    (tmp_path / "back").mkdir()
    connection.download(PurePosixPath(tmp_path), {"there": 256 * 8192}, tmp_path / "back")
    assert (tmp_path / "back" / "there").read_bytes() == (tmp_path / "up").read_bytes()
    with pytest.raises(TargetError, match="more than the 1000 bytes that were expected"):
        connection.download(PurePosixPath(tmp_path), {"there": 1000}, tmp_path / "back")
    with pytest.raises(TargetError, match="cannot read"):
        connection.download(PurePosixPath(tmp_path), {"nothing": 10}, tmp_path / "back")
    with pytest.raises(TargetError, match="cannot write"):
        connection.upload(tmp_path / "up", PurePosixPath(tmp_path / "no" / "folder"))


def test_a_listing_has_the_regular_files_that_were_asked_for(connection, tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "a folder").mkdir()
    (tmp_path / "link").symlink_to("/etc/passwd")
    for number in range(3):
        (tmp_path / f"trace-{number}").touch()
        (tmp_path / "a folder" / f"trace-{number}").touch()

    def listed(*names, matches_max=16):
        command = listing(PurePosixPath(tmp_path), names, matches_max=matches_max)
        return parse_listing(connection.check(command))

    assert listed("file", "a folder", "link", "none") == Listing(sizes={"file": 5}, total=6)
    assert listed("trace-*", "none*").sizes == dict.fromkeys((f"trace-{number}" for number in range(3)), 0)
    assert len(listed("trace-*", matches_max=2).sizes) == 2
    assert listed() == Listing(sizes={}, total=6)
