"""The commands of the pages to begin with that need a board, run as they stand there: on boards behind a real sshd.

The hosts that the pages name stand in ~/.ssh/config. Shorter than on the pages are the times to measure, and
campaigns/smoke.yml; the board's programs are those of this machine.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from conftest import Sshd
from pages import TOP, blocks, file_of
from ports import free_port

pytestmark = [pytest.mark.sshd, pytest.mark.ros]

HOSTS = ("board.local", "robot.local", "panda-1.local", "panda-2.local")
NOT_RUN = {
    "rtgen board build": "minutes; tests/rtgen/test_board_build.py",
    "rtgen doctor": "its answer is that of the host; tests/rtgen/test_doctor.py",
    "rtgen flash": "writes to a card; tests/rtgen/test_flash.py",
    "rtgen kconfig verify --machine arm64 --source": "a kernel tree; tests/rtgen/test_kconfig_verify.py",
    "rtgen suites build": "minutes; tests/suites/test_build_on.py",
    "rtrun quick --deadline 1ms --target robot.yml --middleware rcl": "a ROS 2 at /opt/ros; tests/suites/test_ros2.py",
    "rtrun quick --target root@robot.local --thread": "a ros2_control; tests/rtrun/commands/test_quick_thread.py",
    "rtrun observe --target robot.yml --for 60s --deadline loop:": "a ros2_control; tests/rtrun/probes/test_loops.py",
    "rtrun run campaigns/smoke.yml --targets labgrid:": "a farm; tests/integration/test_labgrid_boards.py",
}
SHORTER = {
    "--for 60s": "--for 8s",
    "rtrun quick": "rtrun quick --for 6s",
    "repetitions: 5000": "repetitions: 1500",
    "at_most: 10min": "at_most: 5s",
    "middleware: rcl, trace": "middleware: roscpp, trace",
}
SMOKE = """schema: 1
name: smoke
common: {policy: FIFO, frequency_hz: 100, repetitions: 100, repeats: 2}
runs: [{suite: cyclic_timer_tests}, {suite: communication_tests}]
"""
ANSWERS = ("check-rt", "gate", "kconfig")  # whose exit status 1 says that the answer is no


def shorter(text: str) -> str:
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    return text


@pytest.fixture
def checkout(tmp_path: Path, sshd: Sshd, suites: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout with the suites, whose user's ~/.ssh/config knows the boards."""
    ssh = tmp_path / "home/.ssh"
    ssh.mkdir(parents=True)
    (ssh / "config").write_text(
        f"Host {' '.join(HOSTS)}\n  HostName 127.0.0.1\n  Port {sshd.port}\n  IdentityFile {sshd.key}\n"
    )
    (ssh / "known_hosts").write_text(f"[127.0.0.1]:{sshd.port} {sshd.host_key}\n")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    folder = tmp_path / "checkout"
    (folder / "build/suites").mkdir(parents=True)
    (folder / "build/suites/host").symlink_to(suites)
    (folder / "campaigns").mkdir()
    (folder / "campaigns/smoke.yml").write_text(SMOKE)
    return folder


@pytest.fixture
def cmd_vel(suites: Path, ros_master: int, tmp_path: Path) -> Iterator[None]:
    """Two nodes that exchange /cmd_vel at 500 Hz."""
    environment = {"ROS_MASTER_URI": f"http://127.0.0.1:{ros_master}", "ROS_IP": "127.0.0.1", "PATH": "/usr/bin:/bin"}
    options = ["-r", "1000000", "-f", "500", "--out-dir", str(tmp_path), "/communication_tests:=/cmd_vel"]
    started = [
        subprocess.Popen(
            [suites / "lib/communication_tests" / f"communication_tests_{part}", *options], env=environment
        )
        for part in ("subscriber", "publisher")
    ]
    yield
    for process in started:
        process.kill()
        process.wait(30)


def follow(page: str, folder: Path, user: str) -> str:
    """Run the commands of a page one after the other; what all of them printed."""
    printed = ""
    for command in dict.fromkeys(blocks(TOP / "docs/start" / page)):
        if command.startswith(tuple(NOT_RUN)):
            continue
        program, *words = shlex.split(shorter(command).replace("--user root", f"--user {user}"))
        for _ in range(3):
            done = subprocess.run(
                [sys.executable, "-m", f"{program}.cli", *words],
                cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
                env=os.environ | {"PYTHONPATH": f"{TOP / 'tools'}:{TOP / 'runner'}"},
            )  # fmt: skip
            # A busy machine may not keep the 1 kHz of `rtrun quick`.
            if not re.search(r"asked for \d+ Hz, achieved", done.stdout):
                break
        assert done.returncode in ((0, 1) if words[0] in ANSWERS else (0,)), f"{command}\n{done.stdout}{done.stderr}"
        printed += f"$ {command}\n{done.stdout}"
        if words[0] == "new-target":
            # What `rtgen suites build --on` would have built there; each board has a ROS master of its own.
            file = folder / f"{words[words.index('--name') + 1]}.yml"
            more = {"suites": "build/suites/host", "work_dir": f"{folder}/{file.stem}", "ros_master_port": free_port()}
            file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | more))
    return printed


@pytest.mark.root
@pytest.mark.trace  # that of this machine's kernel
def test_i_have_a_board(checkout: Path, sshd: Sshd) -> None:
    (checkout / "brakes.yml").write_text(shorter(file_of(TOP / "docs/start/board.md", "brakes.yml")))
    printed = follow("board.md", checkout, sshd.user)
    assert printed.count("How many are late, 95 % sure:") == 1
    assert "at most 1 in 1 000 late, 95 % sure (P(lateness > 1 ms) < 0.001)" in printed
    assert (checkout / "results/brakes/report.html").is_file()


@pytest.mark.trace
def test_i_have_nodes(checkout: Path, sshd: Sshd, cmd_vel: None) -> None:
    printed = follow("nodes.md", checkout, sshd.user)
    first, second = sorted((checkout / "results/robot").glob("*-messages-cmd_vel-*"))
    for run in (first, second):
        record = json.loads((run / "run.json").read_text())
        assert (record["status"], record["deadline_ns"]) == ("ok", 5_000_000), record["reason"]
    assert "messages /cmd_vel " in printed.partition("$ rtrun verdict")[2]


@pytest.mark.root
@pytest.mark.trace
def test_i_have_a_control_loop(checkout: Path, sshd: Sshd) -> None:
    (checkout / "beside.yml").write_text(shorter(file_of(TOP / "docs/start/control.md", "beside.yml")))
    printed = follow("control.md", checkout, sshd.user)
    assert "checks find fault" in printed.partition("$ rtrun check-rt")[2]
    assert "timer" in printed.partition("$ rtrun why")[2] and (checkout / "results/beside/report.html").is_file()


@pytest.mark.root
def test_i_build_images(checkout: Path, sshd: Sshd) -> None:
    printed = follow("images.md", checkout, sshd.user)
    assert "config.gz: " in printed and "options" in printed.partition("config.gz: ")[2]
    assert (checkout.parent / "my-image/kas.yml").is_file() and (checkout / "results/smoke/report.html").is_file()


@pytest.mark.root
def test_i_run_a_lab(checkout: Path, sshd: Sshd) -> None:
    printed = follow("lab.md", checkout, sshd.user)
    assert "panda-1" in printed and "panda-2" in printed
    assert (checkout / "public/index.html").is_file()
    assert printed.partition("--against ARCHIVE")[2].count("NO HISTORY")


def test_every_reason_not_to_run_is_needed() -> None:
    shown = [command for page in (TOP / "docs/start").iterdir() for command in blocks(page)]
    assert all(any(command.startswith(prefix) for command in shown) for prefix in NOT_RUN)
