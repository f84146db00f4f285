"""Whatever others make up on a target, only what was started there is ended; and what stays is named."""

import os
import shutil
import subprocess
import sys
import uuid
from pathlib import Path

import pytest

from hostile.programs import command_lines, start, wait_until
from rtrun.execution import system
from rtrun.targets import groups, processes

pytestmark = pytest.mark.sshd
MAKE_BELIEVE = Path(__file__).with_name("make_believe.py")
# Another user may not execute one in a home folder.
PYTHON = shutil.which("python3", path="/usr/bin:/usr/local/bin") or sys.executable
DAEMON = """
import ctypes, os, sys, time
ctypes.CDLL(None).prctl(15, b"\\xffdrive\\n[r", 0, 0, 0)
if os.fork() or os.setsid() and os.fork():
    os._exit(0)
open(sys.argv[1], "w").write(str(os.getpid()))
time.sleep(600)
"""


def test_what_an_unprivileged_user_makes_up_ends_nothing(place, tmp_path):
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    link, folder, _ = place
    for above in (tmp_path, *tmp_path.parents):
        if above.stat().st_uid == os.getuid() and above != Path("/"):
            above.chmod(above.stat().st_mode | 0o055)
    attack = shutil.copy(MAKE_BELIEVE, tmp_path)
    start(link, folder, "sleep 601 & sleep 602")
    victim = int(link.check(["sh", "-c", "setsid sleep 603 >/dev/null 2>&1 </dev/null & echo $!"]))
    user = "setpriv --reuid=65534 --regid=65534 --clear-groups"
    link.check(["sh", "-c", f"setsid {user} {PYTHON} {attack} {victim} {folder} >{folder}/said 2>&1 </dev/null &"])
    wait_until(lambda: "ready" in Path(folder / "said").read_text() or "rror" in Path(folder / "said").read_text())
    assert Path(folder / "said").read_text() == "ready\n"
    assert victim not in processes.look(link, folder, "p").pids
    liars = {pid for pid, words in command_lines(link).items() if "make_believe" in words}
    assert len(liars) == 6
    processes.end(link, folder, "p")
    lines = command_lines(link)
    assert victim in lines and liars <= lines.keys(), "its own processes are nobody's business either"
    assert not [words for words in lines.values() if words in ("sleep 601", "sleep 602")]
    # Nor can he keep a program from having ended.
    assert processes.list_ended(link, folder, ["p"]) == ["p"]


def test_what_belongs_to_a_program_is_nobodys_to_open(place):
    link, folder, _ = place
    start(link, folder, "sleep 600")
    modes = {path.suffix: path.stat().st_mode & 0o777 for path in Path(folder).iterdir()}
    assert {modes[kind] for kind in (".lock", ".supervised", ".known_by")} == {0o600}
    processes.end(link, folder, "p")


def test_a_daemon_without_an_environment_is_ended_or_named(place, tmp_path, remarks):
    """Where there are no control groups nothing but the lock tells whose it is, which it may have been given."""
    link, folder, has_groups = place
    (tmp_path / "daemon.py").write_text(DAEMON)
    start(link, folder, f"env -i {PYTHON} {tmp_path}/daemon.py {tmp_path}/pid; sleep 600", name="system")
    wait_until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    daemon = int((tmp_path / "pid").read_text())
    system.end(link, folder)
    assert (daemon in command_lines(link)) == (not has_groups)
    named = f"these processes could not be ended: {daemon} (?drive??r) of system: end them on the target"
    assert [remark.partition(": ")[2] for remark in remarks] == ([] if has_groups else [named])
    link.run(["kill", "-KILL", str(daemon)])


@pytest.mark.parametrize("patience", [processes.LIKE_CTRL_C, "TERM:20 KILL:10"])
@pytest.mark.parametrize(
    "command",
    [
        pytest.param("exec sleep 6001", id="one program"),
        pytest.param("setsid sleep 6001 & setsid sleep 6001", id="sessions of their own"),
        pytest.param("env -i sleep 6001 & sleep 6001", id="no environment"),
        pytest.param("trap '' TERM; sleep 6001; sleep 6001", id="deaf"),
        pytest.param("env -i sleep 6001 & exit 5", id="no environment and no parent"),
    ],
)
def test_all_that_was_started_is_ended_and_nothing_else(place, remarks, command, patience):
    link, folder, _ = place
    Path(folder / "other").mkdir()
    start(link, folder, command)
    start(link, folder / "other", "exec sleep 6002")
    wait_until(lambda: "sleep 6001" in command_lines(link).values())
    processes.end(link, folder, "p", stages=patience)
    lines = list(command_lines(link).values())
    assert "sleep 6001" not in lines and "sleep 6002" in lines and not remarks
    processes.give_up(link, folder / "other")


def test_a_killed_supervisor_leaves_nothing(place):
    """Nobody would end the program at its deadline. That it was killed is told, and its watchdog does not stay."""
    link, folder, has_groups = place
    start(link, folder, "setsid sleep 6001 & sleep 6001", deadline_s=6003)
    wait_until(lambda: list(command_lines(link).values()).count("sleep 6001") == 2)
    (supervisor,) = Path(folder / "p.pid").read_text().split()
    link.check(["kill", "-KILL", supervisor])
    assert processes.wait(link, folder, "p", deadline_s=60).status is None
    wait_until(lambda: not [words for words in command_lines(link).values() if words.startswith("sleep 600")])
    wait_until(lambda: not [words for words in command_lines(link).values() if "supervise.sh" in words])
    if has_groups:
        assert not Path(Path(folder / "p.known_by").read_text().strip()).exists()


@pytest.mark.parametrize(
    ("command", "how"),
    [
        ("sleep 600 & exit 5", "with exit status 5: it said nothing"),
        ("sleep 600 & exit 0", None),
        ("exit 0", "with exit status 0: it said nothing"),
        # exec: a shell that outlives its child would print "Terminated".
        ("kill -KILL $(cat {folder}/system.pid); exec sleep 600", "killed from outside: it said nothing"),
    ],
)
def test_how_a_system_has_ended(place, command, how):
    """What it leaves running holds its lock, and says nothing about its exit status."""
    link, folder, _ = place
    start(link, folder, command.format(folder=folder), name="system")
    wait_until(lambda: system.end_of(link, folder) == how and (how or Path(folder / "system.exit").exists()))
    assert system.end_of(link, folder) == how
    if "KILL" in command:
        wait_until(lambda: "sleep 600" not in command_lines(link).values())
    system.end(link, folder)
    assert "sleep 600" not in command_lines(link).values()


@pytest.mark.parametrize("shell", ["dash", "busybox sh", "bash --posix"])
def test_a_secret_is_in_no_command_line(tmp_path, shell):
    """Whoever looks at the right moment sees those of the tools that look for it."""
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in ("tr", "grep", "sed", "awk", "xargs", "find", "cat", "sleep", "rm"):
        (tools / name).write_text(f'#!/bin/sh\necho "{name} $*" >>{tmp_path}/calls\nexec {shutil.which(name)} "$@"\n')
        (tools / name).chmod(0o755)
    secret = str(uuid.uuid4())
    environment = os.environ | {"RTRUN_PROGRAM": secret}
    with subprocess.Popen(["sleep", "6001"], env=environment, start_new_session=True) as ours:
        (tmp_path / "p.known_by").write_text(f"RTRUN_PROGRAM={secret}\n")
        command = f'{groups.FUNCTIONS}\ncd "$1"; know p; end_processes "TERM:20 KILL:20" this'
        words = [*shell.split(), "-c", command, "sh", str(tmp_path)]
        done = subprocess.run(words, env={"PATH": f"{tools}:{os.environ['PATH']}"}, capture_output=True, text=True)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
        assert ours.wait(30) == -15
    if shell == "busybox sh":
        # Its tools are those that it has itself.
        return
    calls = (tmp_path / "calls").read_text()
    assert "grep " in calls and "tr " in calls and secret not in calls
