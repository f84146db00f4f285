"""The user's system is ended with all that it started, and nothing else is."""

import os
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

import rtrun

SCRIPT = Path(rtrun.__file__).parent / "on_target/system.sh"


def call(word, folder):
    done = subprocess.run([SCRIPT, word, folder], capture_output=True, text=True, check=True, timeout=60)
    return [int(line) for line in done.stdout.split()]


def lives(pid):
    """Whether it runs; nobody may have asked yet how it ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def children_of(pid):
    """The processes below one, by a look at the parents of all."""
    below = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [*below, *(each for child in below for each in children_of(child))]


@pytest.fixture
def tmp_path_of_all():
    """A folder that every user can write to, as pytest's own are not."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o777)
        yield Path(folder)


@pytest.fixture
def start(tmp_path):
    """Start a system in a folder of its own, and wait until it has so many processes."""
    started = []

    def start(command, number, run="b"):
        folder = tmp_path / "a" / run
        folder.mkdir(parents=True)
        started.append(subprocess.Popen([SCRIPT, "run", folder, command], start_new_session=True))
        deadline = time.monotonic() + 30
        while len(call("pids", folder)) < number:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        return started[-1], folder

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
    process, folder = start(command, number)
    stranger, other = start("exec sleep 600", 1, run="b-r2")
    pids = call("pids", folder)
    assert call("end", folder) == []
    assert process.wait(30) in statuses
    assert not [pid for pid in pids if lives(pid)]
    assert stranger.poll() is None and len(call("pids", other)) == 1
    call("end", other)


def test_what_is_ended_like_any_program_ends_all_of_it(start):
    process, folder = start("setsid sleep 600 & sleep 600", 3)
    process.terminate()
    process.wait(30)
    deadline = time.monotonic() + 30
    while call("pids", folder):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_of_a_folder_without_a_secret_nothing_is_ended(start, tmp_path):
    process, _ = start("exec sleep 600", 1)
    for text in (None, "", "\n", "a\n", "a/b/c\n"):
        if text is not None:
            (tmp_path / "system.secret").write_text(text)
        assert call("pids", tmp_path) == call("end", tmp_path) == []
    assert process.poll() is None


def test_another_user_cannot_make_a_process_look_like_the_systems(start, tmp_path_of_all):
    """He takes all that he can read for the secret, and names a child so that its line of `stat` is one of root's."""
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    process, folder = start("exec sleep 600", 1)
    victim = subprocess.Popen(["sleep", "600"])
    attack = r"""
        for call in /proc/[0-9]*/cmdline "$1/system.secret"; do
            grep -aqs system "$call" && tr '\0' '\n' <"$call" | sed 's/^/RTRUN_SYSTEM=/'
        done 2>/dev/null >"$2"
        RTRUN_ALL=$(head -c 100000 "$2")
        export RTRUN_ALL
        sh -c 'sh -c "printf \"\\n$1 (a\" >/proc/\$\$/comm; echo ready; sleep 600; :" sh "$1"; :' sh "$3"
    """
    notes = tmp_path_of_all / "notes"
    user = ["setpriv", "--reuid=65534", "--clear-groups", "sh", "-c", attack, "sh", folder, notes, str(victim.pid)]
    attacker = subprocess.Popen(user, stdout=subprocess.PIPE, cwd="/", start_new_session=True)
    try:
        assert attacker.stdout.readline() == b"ready\n"
        names = [Path(f"/proc/{pid}/comm").read_text() for pid in children_of(attacker.pid)]
        assert f"\n{victim.pid} (a\n" in names and b"/a/b" in notes.read_bytes()
        assert victim.pid not in call("pids", folder)
        assert call("end", folder) == []
        process.wait(30)
        assert victim.poll() is None and attacker.poll() is None
    finally:
        os.killpg(attacker.pid, 9)
        victim.kill()
        for each in (attacker, victim):
            each.wait(30)
