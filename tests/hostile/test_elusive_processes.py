"""Processes that are hard to see, to hold or to look at: those of a program are ended, and others hold nothing up."""

import os
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from hostile.programs import command_lines, start, wait_until
from rtrun.targets import groups, processes

OTHER = 65534
pytestmark = pytest.mark.sshd
NEVER_ANSWERS = Path(__file__).with_name("never_answers.py")
AS_OTHER = ("setpriv", f"--reuid={OTHER}", f"--regid={OTHER}", "--clear-groups")

# Whose first thread has ended: it looks like a process that has.
HEADLESS = """
#include <pthread.h>
#include <unistd.h>
static void* stays(void* none) { sleep(600); return none; }
int main(void) {
  pthread_t thread;
  pthread_create(&thread, 0, stays, 0);
  pthread_exit(0);
}
"""
# A process that is another one before it was listed.
HOPPER = """
#include <signal.h>
#include <unistd.h>
int main(void) {
  signal(SIGTERM, SIG_IGN);
  signal(SIGINT, SIG_IGN);
  for (;;) if (fork() > 0) _exit(0);
}
"""
# What is waited for is read from a file system that never answers, while the memory of the process is locked for that,
# and its first thread waits to change it: so does whoever wants to read its environment or command line (mmap_lock).
HANGING = """
#define _GNU_SOURCE
#include <fcntl.h>
#include <pthread.h>
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>
static char* page;
static void* reads(void* none) {
  char byte;
  pread(open("/proc/self/mem", O_RDONLY), &byte, 1, (off_t)(uintptr_t)page);
  return none;
}
int main(int count, char** words) {
  pthread_t thread;
  page = mmap(0, 4096, PROT_READ, MAP_PRIVATE, open(words[1], O_RDONLY), 0);
  if (page == MAP_FAILED || write(1, "ready\\n", 6) != 6) return 1;
  pthread_create(&thread, 0, reads, 0);
  usleep(300000);
  mmap(0, 4096, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
}
"""


def compiled(folder, name, text):
    source = folder / f"{name}.c"
    source.write_text(text)
    subprocess.run(["cc", "-pthread", "-o", folder / name, source], check=True)
    return folder / name


@pytest.mark.parametrize("command", ["exec {}", "setsid {} & sleep 6001"])
def test_a_process_whose_first_thread_has_ended(place, tmp_path, remarks, command):
    link, folder, _ = place
    program = compiled(tmp_path, "headless", HEADLESS)
    start(link, folder, command.format(program))
    wait_until(lambda: "headless" in headless(link))
    processes.end(link, folder, "p")
    assert headless(link) == "" and not remarks
    assert processes.list_ended(link, folder, ["p"]) == ["p"]


def headless(link):
    """It shows no command line."""
    return link.run(["sh", "-c", 'cat /proc/[0-9]*/comm | grep "^headless$"']).stdout


def test_a_process_that_is_always_another_one(place, tmp_path, remarks):
    """In a control group it stands still to be ended. Elsewhere nothing but its lock tells that it is there."""
    link, folder, has_groups = place
    program = compiled(tmp_path, "hopper", HOPPER)
    start(link, folder, f"exec {program}")
    processes.end(link, folder, "p")
    # Those of the target end with its first one. Who is listed by chance between two forks is ended all the same.
    has_ended = processes.list_ended(link, folder, ["p"]) == ["p"]
    assert has_ended == (not remarks) and (has_ended or not has_groups), remarks


@pytest.mark.parametrize("how", ["stopped", "traced", "frozen"])
def test_a_process_that_stands_still(place, tmp_path, remarks, how):
    """A signal ends it all the same."""
    link, folder, has_groups = place
    if how == "frozen" and not has_groups:
        pytest.skip("there is nothing that freezes")
    traced = f"{sys.executable} -c 'import ctypes, os; ctypes.CDLL(None).ptrace(0, 0, 0, 0); os.kill(os.getpid(), 19)'"
    commands = {
        "stopped": "sleep 6001 & sleep 1; kill -STOP $!; wait",
        "traced": f"{traced} & exec sleep 6001",
        "frozen": "sleep 6001 & exec sleep 6001",
    }
    start(link, folder, commands[how])
    wait_until(lambda: "sleep 6001" in command_lines(link).values())
    if how == "frozen":
        group = Path(Path(folder / "p.known_by").read_text().strip())
        freezer = group / "freezer.state"
        freezer.write_text("FROZEN") if freezer.exists() else (group / "cgroup.freeze").write_text("1")
    processes.end(link, folder, "p")
    assert "sleep 6001" not in command_lines(link).values() and not remarks
    assert processes.list_ended(link, folder, ["p"]) == ["p"]


def test_a_control_group_of_the_same_name(place):
    """Others may have a folder of groups to themselves, and read in /proc what ours is called."""
    link, folder, has_groups = place
    if not has_groups or os.geteuid() != 0:
        pytest.skip("there are no groups, or no other users")
    start(link, folder, "exec sleep 6001")
    ours = Path(Path(folder / "p.known_by").read_text().strip())
    his = ours.parent / "his"
    with ExitStack() as stack:
        his.mkdir()
        stack.callback(his.rmdir)
        forged = his / ours.name
        forged.mkdir()
        stack.callback(forged.rmdir)
        for path in (his, his / "cgroup.procs", forged, forged / "cgroup.procs"):
            os.chown(path, OTHER, OTHER)
        liar = subprocess.Popen([*AS_OTHER, "sleep", "6002"], start_new_session=True)
        stack.callback(liar.wait)
        stack.callback(liar.kill)
        (forged / "cgroup.procs").write_text(str(liar.pid))
        # Its number is that of the session that the file names, as after the end of another one.
        script = f'{groups.FUNCTIONS}\ncd "$1"; know p; is_in_group {liar.pid}'
        assert subprocess.run(["sh", "-c", script, "sh", str(folder)], check=False).returncode == 1
        processes.end(link, folder, "p")
        assert liar.poll() is None
        assert "sleep 6001" not in command_lines(link).values()


@pytest.mark.timeout(200)
def test_memory_of_others_is_not_waited_for(place, open_folder, remarks):
    """Any user may mount a file system of his own (fusermount), and read from it as slowly as he likes."""
    link, folder, _ = place
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    program = compiled(open_folder, "hanging", HANGING)
    mount = open_folder / "mount"
    mount.mkdir()
    # The target has processes of its own: what hangs has to be one of them.
    server = f"{sys.executable} {NEVER_ANSWERS} 5"
    options = f"fd=5,rootmode=40000,user_id={OTHER},group_id={OTHER}"
    attack = f"""
        exec 5<>/dev/fuse && mount -i -t fuse -o {options} page {mount} || exit 1
        {server} &
        {" ".join(AS_OTHER)} {program} {mount}/page 5<&- &
        wait
    """
    begin = f"setsid sh -c '{attack}' >{folder}/said 2>&1 </dev/null &"
    if not os.access("/dev/fuse", os.W_OK):
        pytest.skip("this kernel has no FUSE")
    try:
        link.check(["sh", "-c", begin])
        begun = time.monotonic()
        wait_until(lambda: "\n" in Path(folder / "said").read_text() or time.monotonic() > begun + 20)
        assert Path(folder / "said").read_text() == "ready\n"
        (liar,) = link.check(["sh", "-c", "grep -l '^hanging$' /proc/[0-9]*/comm | cut -d/ -f3"]).split()
        hangs = f"sleep 1; cat /proc/{liar}/cmdline & sleep 2; kill -KILL $! && echo hangs"
        assert link.check(["sh", "-c", hangs]) == "hangs\n", "the attack does not work here"
        begun = time.monotonic()
        start(link, folder, "sleep 601 & sleep 602")
        assert link.check(["sh", "-c", f"{groups.FUNCTIONS} living {folder}"]) == f"{folder}/p.lock\n"
        processes.end(link, folder, "p")
        assert processes.list_ended(link, folder, ["p"]) == ["p"] and not remarks
        assert time.monotonic() - begun < 60
    finally:
        # Its processes end with the target's, and the file system with them.
        link.run(["sh", "-c", f"umount -l {mount}"])
