"""Who owns an observed program gives it an environment, and then the rights of another user."""

import os
import shutil
import subprocess
import sys

import pytest

from rtrun.targets import deploy

OTHER = 65534
PYTHON = shutil.which("python3", path="/usr/bin:/usr/local/bin") or sys.executable
pytestmark = pytest.mark.root("becomes another user")
# As su, which waits for a password, and sudo, which takes all rights at once.
GAINS = """
#define _GNU_SOURCE
#include <stdio.h>
#include <unistd.h>
int main(int count, char** words) {
  if (count > 1 && setresuid(geteuid(), geteuid(), geteuid()) + setresgid(getegid(), getegid(), getegid())) return 1;
  puts("ready");
  fflush(stdout);
  pause();
}
"""
# What root would import: it tells whose rights it got.
EVIL = "import os\nopen(os.environ['SAID'], 'a').write(f'{os.geteuid()} {os.getegid()}')\n"


@pytest.fixture
def his_place(open_folder):
    (open_folder / "his/rclpy").mkdir(parents=True)
    (open_folder / "his/rclpy/__init__.py").write_text(EVIL)
    (open_folder / "said").touch()
    (open_folder / "said").chmod(0o666)
    (open_folder / "gains.c").write_text(GAINS)
    subprocess.run(["cc", "-o", open_folder / "gains", open_folder / "gains.c"], check=True)
    return open_folder


def started(his_place, argv, user):
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(his_place / "his"), "SAID": str(his_place / "said")}
    become = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups"]
    process = subprocess.Popen([*become, *argv], env=environment, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


def graph_of(pid):
    argv = [PYTHON, "-I", deploy.ON_TARGET / "ros2_graph.py", str(pid), "0"]
    return subprocess.run(argv, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("takes", [[], ["all"]], ids=["as su", "as sudo"])
@pytest.mark.parametrize(
    ("owner", "mode"), [((0, 0), 0o4755), ((0, 0), 0o6755), ((OTHER, 0), 0o2755), ((2, 2), 0o4755)]
)
def test_nobody_gets_more_rights_than_who_made_the_environment(his_place, owner, mode, takes):
    os.chown(his_place / "gains", *owner)
    (his_place / "gains").chmod(mode)
    process = started(his_place, [his_place / "gains", *takes], OTHER)
    try:
        done = graph_of(process.pid)
        assert (his_place / "said").read_text() == "", "what he wrote ran with rights that he does not have"
        assert done.returncode == 3
        assert done.stderr.splitlines()[-1].endswith(
            "it was given other rights than its caller has (setuid, setgid, setcap)"
        )
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("user", [0, OTHER])
def test_a_program_is_asked_about_with_its_own_rights(his_place, user):
    process = started(his_place, [his_place / "gains"], user)
    try:
        graph_of(process.pid)
        assert (his_place / "said").read_text() == f"{user} {user}"
    finally:
        process.kill()
        process.communicate()


def test_a_program_that_becomes_another_while_it_is_looked_at(his_place):
    """What was read of it before is of the one, and what is read then is of the other."""
    os.chown(his_place / "gains", 0, 0)
    (his_place / "gains").chmod(0o4755)
    # As much environment as the kernel takes: reading it takes the time in which the rights change.
    text = (
        "import os, time\nprint('ready', flush=True)\n"
        "time.sleep(float(os.environ['WAIT']))\nos.execve(os.environ['NEXT'], ['gains', 'all'], {})\n"
    )
    for wait_ms in range(0, 120, 6):
        filler = {f"F{number}": "x" * 100_000 for number in range(12)}
        environment = {
            "PYTHONPATH": str(his_place / "his"),
            "SAID": str(his_place / "said"),
            "WAIT": str(wait_ms / 1000),
        }
        process = subprocess.Popen(
            ["setpriv", f"--reuid={OTHER}", f"--regid={OTHER}", "--clear-groups", PYTHON, "-c", text],
            env=environment | filler | {"NEXT": str(his_place / "gains")},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout.readline() == "ready\n"
        try:
            graph_of(process.pid)
            assert (his_place / "said").read_text().replace(f"{OTHER} {OTHER}", "") == ""
        finally:
            process.kill()
            process.communicate()
