"""What the layer brings to a target, on the emulated board: the case of testimage and the package of unit tests.

Part of `make test-yocto`. The case is run by openembedded-core's own oeqa, with the suites where an image has them. Of
what `bitbake -c testimage` does only booting the image is left out: none was built.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import rtgen.cli
from bitbake.debian_tools import work_folder
from rtgen import suites as builder
from rtgen.checkout import checkout
from rtrun.targets.qemu import emulator as qemu

pytestmark = [pytest.mark.bitbake, pytest.mark.qemu, pytest.mark.timeout(1200)]

HERE = Path(__file__).parent
PROGRAMS = "/opt/ros/noetic/lib"
# Says afterwards that it was asked for one value more: a run that is not valid.
LIAR = """#!/bin/sh
/root/real "$@"
status=$?
sed -i 's/"asked": *50/"asked": 51/' *.json
exit $status
"""


@pytest.fixture(scope="module")
def target(yocto, tmp_path_factory):
    """A file that names the board to oeqa_driver.py: booted, with the suites, its key in an SSH agent."""
    if yocto.ros.version == 2:
        pytest.skip("there is no ROS 2 for the emulated board")
    folder = tmp_path_factory.mktemp("testimage")
    with contextlib.chdir(folder):
        assert rtgen.cli.main(["board", "build", "--machine", "qemu-armv7"]) == 0
    suites = builder.build("qemu-armv7", folder)
    with contextlib.ExitStack() as stack:
        agent = subprocess.Popen(["ssh-agent", "-D", "-a", folder / "agent"], stdout=subprocess.DEVNULL)
        stack.callback(agent.wait)
        stack.callback(agent.terminate)
        machine = stack.enter_context(qemu.boot(folder / "build" / "board" / "qemu-armv7", folder / "console.log"))
        address = machine.address
        environment = os.environ | {"SSH_AUTH_SOCK": str(folder / "agent")}
        while not (folder / "agent").exists():
            time.sleep(0.02)
        # ssh-add takes no key that others may read.
        key = folder / "key"
        key.write_bytes(address.key.read_bytes())
        key.chmod(0o600)
        subprocess.run(["ssh-add", "-q", key], env=environment, check=True)
        given = {"ip": address.host, "port": str(address.port), "agent": str(folder / "agent"), "log": str(folder)}
        (folder / "target.json").write_text(json.dumps(given))
        ssh = ["ssh", "-p", str(address.port), "-o", "StrictHostKeyChecking=no", "-o", "UserKnownHostsFile=/dev/null"]
        ssh += ["-o", "ConnectTimeout=30", f"root@{address.host}"]
        # QEMU takes connections before the board does.
        while subprocess.run([*ssh, "true"], env=environment, capture_output=True, check=False).returncode != 0:
            assert machine.failure() is None
            time.sleep(1)

        def on_board(script, data=None):
            done = subprocess.run([*ssh, script], input=data, env=environment, stdout=subprocess.PIPE, check=True)
            return done.stdout.decode()

        on_board(f"mkdir -p {PROGRAMS} && tar -x -C {PROGRAMS}", packed(suites / "lib"))
        yield folder / "target.json", on_board


def packed(folder):
    return subprocess.run(["tar", "-c", "-C", folder, "."], stdout=subprocess.PIPE, check=True).stdout


def run_cases(yocto, target, path):
    """Run the cases of TEST_SUITES with rtrun from `path`; return what became of each, and why."""
    answer = target.with_name("answer.json")
    answer.unlink(missing_ok=True)
    core = yocto.top / ("openembedded-core" if (yocto.top / "openembedded-core").is_dir() else "poky")
    libraries = [str(core / "meta/lib"), str(yocto.top / "bitbake/lib")]
    arguments = [str(target), str(core), str(yocto.layer), path, str(answer)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(libraries)}
    done = subprocess.run(
        [sys.executable, str(HERE / "oeqa_driver.py"), *arguments],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert answer.exists(), done.stdout + done.stderr
    return json.loads(answer.read_text())


@pytest.fixture
def path(tmp_path):
    """A PATH with the runner of this checkout."""
    program = tmp_path / "rtrun"
    program.write_text(f'#!/bin/sh\nPYTHONPATH={os.pathsep.join(sys.path)} exec {sys.executable} -m rtrun.cli "$@"\n')
    program.chmod(0o755)
    return f"{tmp_path}:/usr/bin:/bin"


CASE = "rt_tests.RtTests.test_every_run_is_valid"


def test_passes_when_every_run_is_valid(yocto, target, path):
    answer = run_cases(yocto, target[0], path)
    assert answer == {"ping.PingTest.test_ping": "", "ssh.SSHTest.test_ssh": "", CASE: ""}


def test_fails_without_the_runner(yocto, target):
    assert (
        "no rtrun in the PATH of the shell that called BitBake: /usr/bin:/bin"
        in (run_cases(yocto, target[0], "/usr/bin:/bin")[CASE])
    )


def test_fails_when_a_run_is_not_valid(yocto, target, path):
    file, on_board = target
    program = f"{PROGRAMS}/cyclic_timer_tests/cyclic_timer_tests"
    on_board(f"mv {program} /root/real && cat > {program} && chmod 755 {program}", LIAR.encode())
    reason = run_cases(yocto, file, path)[CASE]
    assert "asked for repetitions 50, the suite measured repetitions 51" in reason, reason


def test_unit_tests_run_there(built_suites, target):
    """As ptest-runner would call them; a test that fails is named."""
    _, on_board = target
    folder = work_folder(built_suites, "rt-tests-support") / "image/usr/lib/rt-tests-support/ptest"
    names = sorted(path.stem for path in (checkout() / "recipes-tests/unit_tests").glob("test_*.cpp"))
    assert sorted(path.name for path in folder.iterdir()) == ["run-ptest", *names]
    on_board("mkdir -p /root/ptest && tar -x -C /root/ptest", packed(folder))
    lines = on_board("/root/ptest/run-ptest").splitlines()
    assert [line for line in lines if line.startswith(("PASS: ", "FAIL: "))] == [f"PASS: {name}" for name in names]
    on_board(f"ln -sf /bin/false /root/ptest/{names[0]}")
    lines = on_board("/root/ptest/run-ptest || echo ended with $?").splitlines()
    assert f"FAIL: {names[0]}" in lines and f"PASS: {names[1]}" in lines and lines[-1] == "ended with 1"
