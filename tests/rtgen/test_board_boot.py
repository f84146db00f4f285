"""The real board in QEMU, each machine booted once: everything the runner and the suites rely on."""

import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pytest
from probes import standin

from ports import free_port
from rtgen import debian, suites
from rtgen.board import sysroot
from rtgen.board.build import build
from rtgen.board.machine import architectures, find, machines
from rtrun import cli
from rtrun.kinds.timer import UNKNOWN_NS
from rtrun.probes.placement import place as place_probes
from rtrun.probes.session import Batch, observe
from rtrun.targets import deploy
from rtrun.targets.config import connect, read_target
from rtrun.targets.inspection import facts, platform_signs
from rtrun.targets.inspection.platform import Platform
from rtrun.targets.link import Link

# A cold board and its sysroot take some minutes beside other work.
pytestmark = [pytest.mark.qemu, pytest.mark.timeout(1800)]

# Generous: the emulated board shares the CPUs with whatever else runs here.
BOOT_S = 120
COMMAND_S = 240

ASK_MASTER = """
import time, xmlrpc.client
for attempt in range(300):
    try:
        print(xmlrpc.client.ServerProxy('http://localhost:11311').getSystemState('/test')[0])
        break
    except OSError:
        time.sleep(0.1)
"""


HELLO = """
#include <iostream>
#include <ros/ros.h>
#include <std_msgs/Header.h>
int main(int argc, char** argv) {
    ros::init(argc, argv, "hello");
    ros::NodeHandle node;
    ros::Publisher publisher = node.advertise<std_msgs::Header>("greeting", 1);
    std::cout << publisher.getTopic() << " " << ros::master::check() << std::endl;
    if (argc > 1) ros::spin();
}
"""


def compile_hello(machine: str, place: Path) -> Path:
    """A ROS program for the board, compiled and linked against the sysroot."""
    name = find(machine).architecture
    compiler = f"{architectures()[name].triplet}-g++"
    source, program = place / "hello.cpp", place / "hello"
    source.write_text(HELLO)
    libraries = ["-lroscpp", "-lrosconsole", "-lroscpp_serialization", "-lrostime"]
    command = [
        compiler,
        f"--sysroot={sysroot.build(name, debian.source())}",
        "-std=c++17",
        str(source),
        "-o",
        str(program),
    ]
    subprocess.run([*command, *libraries], check=True)
    return program


@dataclass(frozen=True)
class Board:
    """A booted board."""

    record: dict[str, Any]
    qemu: subprocess.Popen[bytes]
    options: list[str]
    login: list[str]
    port: int
    console: Path

    def ssh(self, command: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
        arguments = ["ssh", *self.options, *self.login, "-p", str(self.port), "root@127.0.0.1", command]
        return subprocess.run(arguments, input=stdin, capture_output=True, text=True, timeout=COMMAND_S)

    def output_of(self, command: str, stdin: str = "") -> str:
        done = self.ssh(command, stdin)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return done.stdout.strip()

    def hang_up(self) -> None:
        """End the connection, if there is one."""
        command = ["ssh", *self.options, *self.login, "-O", "exit", "root@127.0.0.1", "-p", str(self.port)]
        subprocess.run(command, capture_output=True, timeout=COMMAND_S)

    def wait(self) -> None:
        """Until SSH answers."""
        deadline = time.monotonic() + BOOT_S
        while self.ssh("true").returncode != 0:
            assert self.qemu.poll() is None, self.console.read_text(errors="replace")
            assert time.monotonic() < deadline, self.console.read_text(errors="replace")
            time.sleep(0.5)


@contextmanager
def booted(machine: str, place: Path) -> Iterator[Board]:
    folder = build(machine, place)
    record = json.loads((folder / "board.json").read_text())
    port = free_port()
    known = place / "known_hosts"
    known.write_text(f"[127.0.0.1]:{port} {record['ssh']['host_key']}\n")
    console = place / "console.log"
    qemu = record["qemu"]
    # The death of pytest ends QEMU, however it came about.
    command = ["setpriv", "--pdeathsig", "KILL", qemu["binary"], *qemu["arguments"]]
    command += ["-kernel", str(folder / record["kernel"]), "-initrd", str(folder / record["initrd"])]
    command += ["-dtb", str(folder / record["dtb"])] if record["dtb"] else []
    command += ["-append", record["cmdline"], "-display", "none", "-monitor", "none", "-serial", f"file:{console}"]
    command += ["-snapshot", "-drive", f"file={folder / record['disk']},format={record['disk_format']},if=none,id=disk"]
    command += ["-device", f"{qemu['disk_device']},drive=disk", "-device", f"{qemu['network_device']},netdev=net"]
    command += ["-netdev", f"user,id=net,hostfwd=tcp:127.0.0.1:{port}-:22"]
    options = ["-F", "none", "-o", f"UserKnownHostsFile={known}", "-o", "StrictHostKeyChecking=yes"]
    options += ["-o", "BatchMode=yes", "-o", "IdentitiesOnly=yes", "-o", "ConnectTimeout=10", "-o", "LogLevel=ERROR"]
    login = ["-i", str(folder / record["ssh"]["key"])]
    # One connection for all commands: a handshake takes the emulated CPU a second.
    login += ["-o", "ControlMaster=auto", "-o", f"ControlPath={place / 'ssh'}", "-o", "ControlPersist=60"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    board = Board(record, process, options, login, port, console)
    try:
        board.wait()
        yield board
    finally:
        process.kill()
        process.wait()
        board.hang_up()


# `make test` boots the one that most tests rely on, `make test-boards` all of them.
MACHINES = [
    pytest.param(name, marks=[] if name == "qemu-armv7" else pytest.mark.boards)
    for name, machine in machines().items()
    if machine.qemu is not None
]


@pytest.mark.parametrize("machine", MACHINES)
def test_board_serves_runner_and_suites(machine: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hello = compile_hello(machine, tmp_path)
    with booted(machine, tmp_path) as board:
        check_system(board)
        check_platform(board)
        check_ssh(board, hello, tmp_path)
        check_ros(board)
        check_measuring(board)
        check_observing(board, machine, tmp_path, capsys)
        check_reboot_keeps_the_disk(board)
        board.ssh("poweroff")
        assert board.qemu.wait(timeout=BOOT_S) == 0
        errors = board.qemu.stderr.read().decode() if board.qemu.stderr else ""
        assert errors == ""


def check_system(board: Board) -> None:
    assert "PREEMPT_RT" in board.output_of("uname -v")
    assert board.output_of("uname -r") == board.record["kernel_release"]
    assert "CONFIG_PREEMPT_RT=y" in board.output_of("grep PREEMPT_RT /boot/config-$(uname -r)")
    assert board.output_of("nproc") == "2"
    mounts = {line.split()[1]: line.split()[2] for line in board.output_of("cat /proc/mounts").splitlines()}
    wanted = {"/": "ext4", "/dev": "devtmpfs", "/dev/pts": "devpts", "/dev/shm": "tmpfs", "/proc": "proc"}
    wanted |= {"/sys": "sysfs", "/sys/kernel/debug": "debugfs", "/sys/kernel/tracing": "tracefs"}
    assert mounts.items() >= wanted.items()
    assert board.output_of("cat /proc/sys/kernel/sched_rt_runtime_us") == "950000"
    free_kib = int(board.output_of("df -k / | tail -1").split()[3])
    assert 256 * 1024 < free_kib < 512 * 1024
    board.output_of("touch /var/lib/rt-tests/x /tmp/x && rm /var/lib/rt-tests/x /tmp/x")
    assert "(127.0.0.1)" in board.output_of("ping -c 1 $(hostname)")
    # The clock comes from QEMU's real-time clock, so the board knows the day.
    assert abs(int(board.output_of("date +%s")) - time.time()) < 3600
    # init takes over orphans and buries them.
    board.output_of("sh -c '(sleep 0.1 &) ; exit 0'; sleep 1")
    # One that has just ended may be seen once.
    assert not zombies(board) & zombies(board)


def zombies(board: Board) -> set[str]:
    """The processes that have ended, and that nobody has buried."""
    lines = board.output_of("sleep 1; ps -eo pid,stat | tail -n +2").splitlines()
    return {pid for pid, state in map(str.split, lines) if state.startswith("Z")}


def check_platform(board: Board) -> None:
    """The board is run by TCG, and shows it to somebody who was not told."""
    lines = board.output_of("sh -s", platform_signs.SCRIPT.read_text()).splitlines()
    known = platform_signs.judge(lines, platform_signs.read_signs())
    assert known.platform is Platform.EMULATED, lines


def check_ssh(board: Board, hello: Path, place: Path) -> None:
    back = place / "back"
    batch = f"put -p {hello} /var/lib/rt-tests/hello\nget /var/lib/rt-tests/hello {back}\n"
    command = [
        "sftp",
        *board.options,
        *board.login[:2],
        "-o",
        "Ciphers=aes128-gcm@openssh.com",
        "-P",
        str(board.port),
        "-b",
        "-",
    ]
    done = subprocess.run([*command, "root@127.0.0.1"], input=batch, capture_output=True, text=True, timeout=COMMAND_S)
    assert done.returncode == 0, done.stderr
    assert back.read_bytes() == hello.read_bytes()
    # Nobody gets in without the key, not even for a password.
    nobody = ["ssh", *board.options, "-o", "IdentityFile=none", "-p", str(board.port), "root@127.0.0.1", "true"]
    refused = subprocess.run(nobody, capture_output=True, text=True, timeout=COMMAND_S)
    assert refused.stderr.strip() == "root@127.0.0.1: Permission denied (publickey)."


def check_ros(board: Board) -> None:
    board.output_of("setsid rosmaster --core -p 11311 > /tmp/master.log 2>&1 < /dev/null &")
    assert board.output_of("python3 -", ASK_MASTER) == "1"
    # A roscpp program finds its libraries and the master. It came over SSH.
    assert board.output_of("ROS_MASTER_URI=http://localhost:11311 /var/lib/rt-tests/hello") == "/greeting 1"


def check_measuring(board: Board) -> None:
    measured = board.output_of("cyclictest --quiet --mlockall --priority=80 --policy=fifo --loops=100 --threads=1")
    assert "P:80" in measured
    assert "C:    100" in measured
    assert board.output_of("chrt -f 50 chrt -p 0 | head -1").endswith("SCHED_FIFO")
    assert "successful run" in board.ssh("stress-ng --cpu 1 --timeout 1 2>&1").stdout


def check_observing(board: Board, machine: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Arguments are where the descriptions of libraries say; Thumb code is refused, which Debian's ROS for armhf is."""
    is_arm = find(machine).architecture == "armhf"
    login, target = board.record["ssh"], place / "target.yml"
    target.write_text(
        f"schema: 1\nname: board\nkind: ssh\nhost: 127.0.0.1\nport: {board.port}\nuser: {login['user']}\n"
        f"work_dir: /var/lib/observing\nkey: {place / machine / login['key']}\n"
        f"host_key: {login['host_key']}\nemulated: true\n"
    )
    triplet = architectures()[find(machine).architecture].triplet
    program = standin.build(place / "standin", f"{triplet}-gcc", *(["-marm"] if is_arm else []))
    with connect(read_target(target), place, place / "unused.log") as connected, Link(connected, print) as link:
        facts.inspect(link)
        scripts = deploy.deploy(link, deploy.ON_TARGET, "scripts")
        folder = deploy.deploy(link, program.parent, "suites")
        check_arguments(board, link, scripts, f"{folder}/{program.name}")
        if is_arm:
            pid = start(board, "/var/lib/rt-tests/hello wait")
            standin.find(link, pid, scripts=scripts, within_s=COMMAND_S)
            observing = ["observe", "--target", str(target), "--for", "5s", "--results", str(place / "refused")]
            assert cli.main(observing) == 3
            (line,) = capsys.readouterr().err.strip().splitlines()
            assert (
                "no probe publish, take, subscription_init, callback_begin, timer_call in "
                "/usr/lib/arm-linux-gnueabihf/libroscpp" in line
            )
            assert line.count("its address is odd, as that of Thumb code") == 1
            board.output_of(f"kill {pid}")
        else:
            check_messages_and_timers(board, link, scripts, machine, target)


def start(board: Board, command: str) -> int:
    """Start a program that goes on after the call; its process."""
    environment = "ROS_MASTER_URI=http://localhost:11311"
    return int(board.output_of(f"{environment} setsid {command} > /dev/null 2>&1 < /dev/null & echo $!"))


def check_arguments(board: Board, link: Link, scripts: PurePosixPath, program: str) -> None:
    """Of a stand-in for ROS 2, with times of which both halves count where a register has 32 bits."""
    first = 3 << 40
    pid = start(board, f"{program} 50 1000000 {first}")
    found = standin.find(link, pid, scripts=scripts, within_s=COMMAND_S)
    placement = place_probes(link, found, events=standin.EVENTS)
    batches = [batch for batch in observe(link, scripts, placement, found, for_s=8) if isinstance(batch, Batch)]
    board.output_of(f"kill {pid}")
    hits = [hit for batch in batches for hit in batch.hits]
    assert {hit.pid for hit in hits} == {pid}
    published, taken, calls = (
        [hit for hit in hits if hit.event == event] for event in ("publish", "take", "timer_call")
    )
    numbers = [hit.values["source_ns"] for hit in published]
    assert numbers[0] >= first and len(numbers) > 10
    # An emulator that is starved loses events, and says so; what is seen is in order all the same.
    if any(batch.gaps for batch in batches):
        assert numbers == sorted(set(numbers))
    else:
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert {hit.values["source_ns"] for hit in taken} ^ set(numbers) <= {numbers[0] - 1, numbers[-1]}
    assert {hit.values["topic"] for hit in (*published, *taken)} == {"/a"}
    assert {hit.values["taken"] for hit in taken} == {1}
    assert {(hit.values["period_ns"], hit.values["clock"]) for hit in calls[1:]} == {(20_000_000, "steady")}
    assert min(hit.at_ns - hit.values["expected_ns"] for hit in calls[1:]) > 0  # type: ignore[operator]


def check_messages_and_timers(board: Board, link: Link, scripts: PurePosixPath, machine: str, target: Path) -> None:
    """Of roscpp: of each message its own stamp, published, taken, its own stamp, in this order; and a timer's grid."""
    place = target.parent
    folder = deploy.deploy(link, suites.build(machine, place / "suites") / "lib", "suites")
    options = "-r 100000 -f 20 --clock monotonic --out-dir /tmp"
    programs = (
        "communication_tests_subscriber --idle-timeout 600",
        "communication_tests_publisher -d 1",
        "cyclic_timer_tests",
    )
    pids = [start(board, f"{folder}/{name.partition('_tests')[0]}_tests/{name} {options}") for name in programs]
    standin.find(link, *pids, scripts=scripts, within_s=COMMAND_S)
    results = place / "observed"
    assert cli.main(["observe", "--target", str(target), "--for", "20s", "--results", str(results)]) == 0
    # They write what they have measured.
    words = " ".join(map(str, pids))
    board.output_of(f"kill {words}; for pid in {words}; do while [ -d /proc/$pid ]; do sleep 0.2; done; done")
    paths = map(PurePosixPath, board.output_of("ls /tmp/c*.npy").splitlines())
    sizes = {path.name: int(board.output_of(f"stat -c %s {path}")) for path in paths}
    link.do(lambda connection: connection.download(PurePosixPath("/tmp"), sizes, place))
    (own, of_timer), (messages,), (timer,) = (
        (np.load(place / name) for name in sorted(sizes)),
        results.glob("*-messages-communication_tests-*/*.npy"),
        results.glob("*-timer-*/*.npy"),
    )
    seen = np.load(messages)
    counts = json.loads(messages.with_suffix(".json").read_text())["counts"]
    assert counts["measured"] == counts["asked"] == len(seen) > 20 and counts["missing"] == 0
    fits = [
        (rows[:, 0] <= seen[:, 0]).all() and (seen[:, 0] <= seen[:, 1]).all() and (seen[:, 1] <= rows[:, 1]).all()
        for rows in (own[begin : begin + len(seen)] for begin in range(len(own) - len(seen) + 1))
    ]
    assert sum(fits) == 1
    # When roscpp meant to call, as it tells the program.
    expected = np.load(timer)[:, 1]
    known = expected[expected != UNKNOWN_NS]
    assert len(known) > 20 and set(known) <= set(of_timer[:, 1])


def check_reboot_keeps_the_disk(board: Board) -> None:
    boot = board.output_of("cat /proc/sys/kernel/random/boot_id")
    board.output_of("echo kept > /var/lib/rt-tests/kept; echo lost > /tmp/lost")
    board.ssh("reboot")
    board.hang_up()
    deadline = time.monotonic() + BOOT_S
    while board.ssh("cat /proc/sys/kernel/random/boot_id").stdout.strip() in (boot, ""):
        assert time.monotonic() < deadline, board.console.read_text(errors="replace")
        time.sleep(0.5)
    assert board.output_of("cat /var/lib/rt-tests/kept") == "kept"
    assert board.output_of("ls /tmp") == ""
    # It was put down properly: nothing to recover.
    assert "recovery" not in board.output_of("dmesg | grep EXT4")
