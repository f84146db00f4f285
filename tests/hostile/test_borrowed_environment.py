"""Who owns an observed program gives it an environment, and then the rights of another user."""

import os
import shutil
import subprocess
import sys

import pytest

from rtrun.targets import deploy

OTHER = 65534
PYTHON = shutil.which("python3", path="/usr/bin:/usr/local/bin") or sys.executable
pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="becomes another user")
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
def place(tmp_path):
    for each in (tmp_path, *tmp_path.parents[:2]):
        each.chmod(0o755)
    (tmp_path / "his/rclpy").mkdir(parents=True)
    (tmp_path / "his/rclpy/__init__.py").write_text(EVIL)
    (tmp_path / "said").touch()
    (tmp_path / "said").chmod(0o666)
    (tmp_path / "gains.c").write_text(GAINS)
    subprocess.run(["cc", "-o", tmp_path / "gains", tmp_path / "gains.c"], check=True)
    return tmp_path


def started(place, argv, user):
    environment = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(place / "his"), "SAID": str(place / "said")}
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
def test_nobody_gets_more_rights_than_who_made_the_environment(place, owner, mode, takes):
    os.chown(place / "gains", *owner)
    (place / "gains").chmod(mode)
    process = started(place, [place / "gains", *takes], OTHER)
    try:
        done = graph_of(process.pid)
        assert (place / "said").read_text() == "", "what he wrote ran with rights that he does not have"
        assert done.returncode == 3
        assert done.stderr.splitlines()[-1].endswith(
            "it was given other rights than its caller has (setuid, setgid, setcap)"
        )
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("user", [0, OTHER])
def test_a_program_is_asked_about_with_its_own_rights(place, user):
    process = started(place, [place / "gains"], user)
    try:
        graph_of(process.pid)
        assert (place / "said").read_text() == f"{user} {user}"
    finally:
        process.kill()
        process.communicate()


def test_a_program_that_becomes_another_while_it_is_looked_at(place):
    """What was read of it before is of the one, and what is read then is of the other."""
    os.chown(place / "gains", 0, 0)
    (place / "gains").chmod(0o4755)
    # As much environment as the kernel takes: reading it takes the time in which the rights change.
    text = (
        "import os, time\nprint('ready', flush=True)\n"
        "time.sleep(float(os.environ['WAIT']))\nos.execve(os.environ['NEXT'], ['gains', 'all'], {})\n"
    )
    for wait_ms in range(0, 120, 6):
        filler = {f"F{number}": "x" * 100_000 for number in range(12)}
        environment = {"PYTHONPATH": str(place / "his"), "SAID": str(place / "said"), "WAIT": str(wait_ms / 1000)}
        process = subprocess.Popen(
            ["setpriv", f"--reuid={OTHER}", f"--regid={OTHER}", "--clear-groups", PYTHON, "-c", text],
            env=environment | filler | {"NEXT": str(place / "gains")},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout.readline() == "ready\n"
        try:
            graph_of(process.pid)
            assert (place / "said").read_text().replace(f"{OTHER} {OTHER}", "") == ""
        finally:
            process.kill()
            process.communicate()
