"""The user's system is ended with all that it started, and nothing else is."""

import subprocess
import time
from pathlib import Path

import pytest

import rtrun

SCRIPT = Path(rtrun.__file__).parent / "on_target/system.sh"


def call(word, mark):
    done = subprocess.run([SCRIPT, word, mark], capture_output=True, text=True, check=True, timeout=60)
    return [int(line) for line in done.stdout.split()]


def lives(pid):
    """Whether it runs; nobody may have asked yet how it ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.fixture
def start(tmp_path):
    """Start a system under a mark that no other test has, and wait until it has so many processes."""
    started = []

    def start(command, number, mark="a/b/"):
        mark = f"{tmp_path}/{mark}"
        started.append(subprocess.Popen([SCRIPT, "run", mark, command], start_new_session=True))
        deadline = time.monotonic() + 30
        while len(call("pids", mark)) < number:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        return started[-1], mark

    yield start
    for process in started:
        process.kill()
        process.wait(30)


@pytest.mark.parametrize(
    ("command", "number", "statuses"),
    [
        pytest.param("exec sleep 600", 1, {143}, id="one program"),
        pytest.param("setsid sleep 600 & setsid sleep 600", 2, {143, 0}, id="sessions of their own"),
        pytest.param("env -i sleep 600 & sleep 600", 3, {143}, id="no environment"),
        pytest.param("trap '' TERM; sleep 600; sleep 600", 2, {137}, id="deaf"),
    ],
)
def test_all_that_was_started_is_ended(start, command, number, statuses):
    process, mark = start(command, number)
    stranger, other = start("exec sleep 600", 1, mark="a/b-r2/")
    pids = call("pids", mark)
    assert call("end", mark) == []
    assert process.wait(30) in statuses
    assert not [pid for pid in pids if lives(pid)]
    assert stranger.poll() is None and len(call("pids", other)) == 1
    call("end", other)


def test_what_is_ended_like_any_program_ends_all_of_it(start):
    process, mark = start("setsid sleep 600 & sleep 600", 3)
    process.terminate()
    process.wait(30)
    deadline = time.monotonic() + 30
    while call("pids", mark):
        assert time.monotonic() < deadline
        time.sleep(0.05)
