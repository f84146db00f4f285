"""Where culprits are planted: this machine, and the rehearsal board with either of its kernels."""

import contextlib
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ports import free_port
from rtgen import suites
from rtgen.board.build import build as build_board
from rtgen.board.machine import architectures, machines
from rtrun.plan.run import KernelName
from rtrun.targets.address import Address, ThisMachine
from rtrun.targets.connection import Connection
from rtrun.targets.errors import TargetError
from rtrun.targets.qemu import emulator as qemu
from rtrun.targets.qemu import qmp

HERE = Path(__file__).parent
BOARD = "qemu-armv7"
PROGRAM = Path("lib/cyclic_timer_tests/cyclic_timer_tests")
BOOT_S = 600
# Prints process group and process. When a command ends, the connection ends the rest of its session, so the plant gets
# its own one before that.
START = """setsid sh -c 'python3 "$@" </dev/null >/dev/null 2>&1 & echo $$ $!' sh "$@"; :"""
# Until a plant has its name.
NAMED = "while ! grep -q planted /proc/$1/comm && [ -e /proc/$1 ]; do sleep 0.2; done; [ -e /proc/$1 ]"
READY_S = 120
# A plant puts back what it set, unless it does not end by itself.
END = """kill -s TERM -- -$1
for _ in 1 2 3 4 5 6 7 8 9 10; do sleep 0.5; kill -s 0 -- -$1 || exit 0; done
kill -s KILL -- -$1"""
WRAPPER = """\
#!/bin/sh
here=${0%%/*}
PLANT=%s PLANT_CPU=%d LENGTH_MS=%d LD_PRELOAD=$here/planted.so exec $here/cyclic_timer_tests.real "$@"
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A machine that answers. One event of a plant lasts `length_ms` there, longer than values are late without.

    A run is cut into `slices` of `repetitions` values each, which are trials: where a run takes a minute to begin and
    to end, ten runs of a trial each would take too long.
    """

    about: str
    address: Address | ThisMachine
    target: str
    """Lines of its target file, without the suites."""
    built: Path
    """The suites."""
    compiler: str
    length_ms: int
    threshold_us: int
    frequency_hz: int
    repetitions: int
    slices: int = 1
    flooded_port: Callable[[], int] | None = None
    """Opens a UDP port of this machine that is forwarded to the board's network device."""


@contextlib.contextmanager
def this_machine(folder: Path) -> Iterator[Place]:
    """This machine itself, with no idle CPU.

    The host of a virtual machine takes the CPU of a processor that idles, and gives it back milliseconds late: a true
    cause, which would come before every other one.
    """
    with contextlib.ExitStack() as stack:
        for cpu in sorted(os.sched_getaffinity(0)):
            awake = subprocess.Popen([sys.executable, HERE / "plants.py", "awake", str(cpu), "0"])
            stack.callback(awake.wait)
            stack.callback(awake.kill)
        yield Place(
            about=f"this machine (virtual, Linux {platform.release()})",
            address=ThisMachine(),
            target=f"kind: local\nwork_dir: {folder / 'work'}\nros_master_port: {free_port()}\n",
            built=suites.build(suites.HOST, folder),
            compiler="gcc",
            length_ms=6,
            threshold_us=3000,
            frequency_hz=500,
            repetitions=1500,
        )


@contextlib.contextmanager
def board(kernel: KernelName, folder: Path) -> Iterator[Place]:
    """The rehearsal board, emulated and booted once: what takes a millisecond elsewhere may take ten there."""
    built = suites.build(BOARD, folder)
    image = build_board(BOARD, folder / "boards", "both").resolve()
    with qemu.boot(image, folder / "console.log") as machine:
        if kernel != "rt":
            machine.choose(kernel)
            machine.reset()
        address = machine.address
        release = machine.board.entry(kernel).kernel_release

        def flooded_port() -> int:
            monitor(machine.monitor, "hostfwd_add udp:127.0.0.1:0-:9")
            listed = monitor(machine.monitor, "info usernet")
            return int(re.findall(r"UDP\[HOST_FORWARD\].*?127\.0\.0\.1\s+(\d+)", listed)[-1])

        wait_for(address)
        yield Place(
            about=f"{BOARD} (emulated, {release})",
            address=address,
            target=(
                f"kind: ssh\nhost: {address.host}\nport: {address.port}\nuser: {address.user}\nkey: {address.key}\n"
                f"host_key: {address.host_key}\nemulated: true\n"
            ),
            built=built,
            compiler=f"{architectures()[machines()[BOARD].architecture].triplet}-gcc",
            length_ms=300,
            threshold_us=200_000,
            frequency_hz=50,
            repetitions=500,
            slices=5,
            flooded_port=flooded_port,
        )


def monitor(path: Path, line: str) -> str:
    """What QEMU's monitor for people answers."""
    return str(qmp.execute(path, "human-monitor-command", {"command-line": line}))


def wait_for(address: Address) -> None:
    """Wait until the board answers over SSH."""
    end_s = time.monotonic() + BOOT_S
    while True:
        try:
            Connection(address, timeout_s=60).close()
            return
        except TargetError:
            if time.monotonic() > end_s:
                raise
            time.sleep(1)


def preloaded(place: Place, plant: str, cpu: int, folder: Path) -> Path:
    """A copy of the suites whose program is started with planted.c."""
    wrapped = folder / f"with-{plant}"
    shutil.copytree(place.built, wrapped)
    program = wrapped / PROGRAM
    program.rename(program.with_name("cyclic_timer_tests.real"))
    program.write_text(WRAPPER % (plant, cpu, place.length_ms))
    program.chmod(0o755)
    library = program.with_name("planted.so")
    options = ["-O2", "-shared", "-fPIC", "-o", library, HERE / "planted.c", "-ldl", "-lpthread"]
    subprocess.run([place.compiler, *options], check=True)
    return wrapped


@contextlib.contextmanager
def beside(place: Place, plant: str, cpu: int) -> Iterator[None]:
    """A program of plants.py runs on the machine, and what it needs on this one."""
    with contextlib.ExitStack() as stack:
        connection = Connection(place.address, timeout_s=60)
        stack.callback(connection.close)
        script = PurePosixPath(f"/tmp/planted-{free_port()}.py")
        connection.upload(HERE / "plants.py", script)
        stack.callback(connection.run, ["rm", "-f", str(script)])
        words = [str(script), plant, str(cpu), str(place.length_ms)]
        group, pid = connection.check(["sh", "-c", START, "sh", *words]).split()
        stack.callback(connection.run, ["sh", "-c", END, "sh", group])
        connection.check(["sh", "-c", NAMED, "sh", pid], deadline_s=READY_S)
        if plant == "storm" and place.flooded_port is not None:
            argv = [sys.executable, HERE / "plants.py", "flood", str(place.flooded_port()), str(place.length_ms)]
            flood = subprocess.Popen(argv)
            stack.callback(flood.wait)
            stack.callback(flood.kill)
        yield
        # A process that ended has no command line, even if nobody has asked for its exit status.
        connection.check(["grep", "-q", plant, f"/proc/{pid}/cmdline"])
