"""This machine as a target: commands as sshd would run them, which test_every_connection.py shows for both."""

import json
import os
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import pytest

from ports import free_port
from rtfiles.errors import UsageError
from rtrun.cli import main
from rtrun.targets.address import ThisMachine
from rtrun.targets.config import connect, read_target
from rtrun.targets.connection import Connection
from rtrun.targets.deploy import ON_TARGET
from rtrun.targets.link import Link
from rtrun.targets.restart import restart
from watching import wait_for_end

CONFIG = "schema: 1\nname: here\nkind: local\n"


@pytest.fixture
def connection():
    return Connection(ThisMachine())


def test_ctrl_c_ends_the_command_and_does_not_reach_it(connection, tmp_path):
    pids = tmp_path / "pids"

    def interrupt():
        while not (pids.exists() and pids.read_text()):
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        connection.run(["sh", "-c", f"trap : INT; echo $$ >{pids}; while :; do sleep 1; done"], deadline_s=60)
    wait_for_end(pids.read_text().split())


def test_ctrl_c_while_a_command_is_started_ends_it(connection, tmp_path, monkeypatch):
    started = []
    real = subprocess.Popen

    def interrupted(*words, **more):
        started.append(real(*words, **more))
        signal.raise_signal(signal.SIGINT)
        return started[0]

    monkeypatch.setattr(subprocess, "Popen", interrupted)
    with pytest.raises(KeyboardInterrupt):
        connection.run(["sleep", "300"])
    assert started[0].returncode == -signal.SIGKILL
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_nothing_of_the_callers_environment(connection, monkeypatch):
    monkeypatch.setenv("LD_LIBRARY_PATH", "/x")
    monkeypatch.setenv("ROS_MASTER_URI", "http://elsewhere:1")
    names = {line.partition("=")[0] for line in connection.check(["env"]).splitlines()}
    assert names - {"PWD", "OLDPWD", "SHLVL", "_"} <= {"PATH", "HOME", "USER", "LOGNAME", "SHELL"}


def test_a_port(connection):
    port = free_port()
    with pytest.raises(ConnectionRefusedError), connection.open_port(port, deadline_s=5):
        pass
    with socket.create_server(("127.0.0.1", port)), connection.open_port(port, deadline_s=0.2) as stream:
        # Nobody answers, and the stream is closed when the time is up, whatever its timeout.
        stream.settimeout(60)
        assert stream.recv(1) == b""


def test_target_file(tmp_path, monkeypatch):
    (tmp_path / "target.yml").write_text(CONFIG)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert read_target(tmp_path / "target.yml").work_dir == f"{tmp_path}/state/rt-tests"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", "/home/me")
    assert read_target(tmp_path / "target.yml").work_dir == "/home/me/.local/state/rt-tests"
    (tmp_path / "target.yml").write_text(f"{CONFIG}restart: [reboot]\n")
    with pytest.raises(UsageError, match="unknown key 'restart'"):
        read_target(tmp_path / "target.yml")


def test_the_link_knows_the_boot_and_does_not_restart(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "target.yml").write_text(CONFIG)
    with (
        connect(read_target(tmp_path / "target.yml"), tmp_path, tmp_path / "log") as target,
        Link(target, print) as link,
    ):
        assert link.boot_id == Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        with pytest.raises(UsageError, match="the runner cannot restart the machine that it runs on"):
            restart(link)


def test_probe(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "target.yml").write_text(CONFIG)
    assert main(["probe", "--target", str(tmp_path / "target.yml")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split(None, 1) == ["target", "here (this machine)"]
    assert main(["probe", "--target", str(tmp_path / "target.yml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["target"] == "here (this machine)"


def test_an_option_is_asked_of_the_program_that_is_to_take_it(tmp_path):
    (tmp_path / "newer").write_text("#!/bin/sh\necho '  --deepest-idle-state=n' >&2\nexit 1\n")
    (tmp_path / "newer").chmod(0o755)
    needs = [f"option={name} --deepest-idle-state rt-tests 2.8" for name in (tmp_path / "newer", "ls", "no-such")]
    done = subprocess.run(["sh", ON_TARGET / "missing.sh", *needs], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        f"the option --deepest-idle-state of {name} (rt-tests 2.8 and later)" for name in ("ls", "no-such")
    ]


@pytest.mark.root("takes its rights away from a process of root's")
def test_what_needs_root_is_said_in_a_line_each():
    needs = ["rt_priority=50", "irq_cpu=0", "sed"]
    drop = ["prlimit", "--rtprio=0:0", "setpriv", "--reuid=65534", "--clear-groups"]
    script = (ON_TARGET / "missing.sh").read_text()
    done = subprocess.run(
        [*drop, "sh", "-s", *needs], input=script, capture_output=True, text=True, check=True, cwd="/"
    )
    assert done.stdout.splitlines() == [
        "the right to real-time priority 50 (root, or rtprio in /etc/security/limits.conf)",
        "interrupts that can be moved (/proc/irq/*/smp_affinity_list, by root)",
    ]
