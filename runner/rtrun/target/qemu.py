"""A board in QEMU: booted from the folder that ``rtgen board build`` makes, and never outliving the runner."""

import contextlib
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from rtfiles.config import Config, load
from rtfiles.errors import UsageError
from rtfiles.invocation import as_called
from rtrun.target import kvm, qmp
from rtrun.target.address import Address
from rtrun.target.errors import TargetError, TargetGone
from rtrun.target.platform import KnownPlatform, Platform

STOP_S = 5.0


class Kvm(Config):
    """The host's processor (as `uname -m` names it) on which KVM can run a board, and QEMU's arguments for it."""

    processor: str
    arguments: list[str]


class Emulator(Config):
    """How QEMU is called for this board. Arguments for KVM come after the others and win over them."""

    binary: str
    arguments: list[str]
    kvm: Kvm | None = None
    disk_device: str
    network_device: str


class Login(Config):
    """How to log in: the key made for this image, and the host key it shows."""

    user: str
    key: str
    host_key: str


class Board(Config):
    """`board.json`; file names are relative to its folder (see docs/formats.md)."""

    schema_: Literal[2] = Field(alias="schema")
    machine: str
    qemu: Emulator
    kernel: str
    initrd: str
    dtb: str | None
    cmdline: str
    disk: str
    disk_format: str
    ssh: Login
    kernel_release: str
    packages: dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A booted board."""

    platform: KnownPlatform
    address: Address
    process: subprocess.Popen[bytes]
    monitor: Path
    console: Path

    def reset(self, _: object = None) -> None:
        """Restart the board as its reset button does."""
        qmp.execute(self.monitor, "system_reset")

    def failure(self) -> TargetGone | None:
        """Return why the emulator ended, or None while it runs."""
        status = self.process.poll()
        if status is None:
            return None
        how = f"killed by signal {-status}" if status < 0 else f"exit status {status}"
        return TargetGone(f"the board in QEMU was switched off: QEMU ended ({how}); console: {self.console}")


def read_board(folder: Path) -> Board:
    """Read `board.json`. Raises UsageError that says how to make one."""
    path = folder / "board.json"
    if not path.is_file():
        raise UsageError(f"{folder}: no board there, make one: {as_called('rtgen')} board build")
    try:
        return load(path, Board)
    except UsageError as error:
        raise UsageError(
            f"{error}\n{path}: if another version made it, make it anew: {as_called('rtgen')} board build"
        ) from error


def emulator(board: Board, folder: Path) -> tuple[str, ...]:
    """QEMU's program and the arguments that make it the board: by KVM where that works, emulated where it does not."""
    by_kvm = _by_kvm(board)
    return by_kvm if by_kvm and kvm.works(by_kvm, folder / board.kernel) else _by_tcg(board)


def platform_of(board: Board, folder: Path) -> KnownPlatform:
    """Virtual where KVM runs the board, else emulated."""
    if emulator(board, folder) == _by_tcg(board):
        return KnownPlatform(platform=Platform.EMULATED, evidence="QEMU emulates the processor (TCG)")
    return KnownPlatform(platform=Platform.VIRTUAL, evidence="QEMU runs it by KVM")


def _by_tcg(board: Board) -> tuple[str, ...]:
    return (board.qemu.binary, *board.qemu.arguments)


def _by_kvm(board: Board) -> tuple[str, ...] | None:
    kvm = board.qemu.kvm
    return None if kvm is None or kvm.processor != platform.machine() else (*_by_tcg(board), *kvm.arguments)


def command(board: Board, folder: Path, overlay: Path, monitor: Path, console: Path) -> list[str]:
    """Return the QEMU command line. The disk is the overlay; the SSH port is chosen by the kernel (port 0)."""
    argv = [
        # QEMU ends with the runner, however that ends.
        *("setpriv", "--pdeathsig", "KILL", "--"),
        *emulator(board, folder),
        *("-nodefaults", "-no-user-config", "-display", "none"),
        *("-kernel", str(folder / board.kernel), "-initrd", str(folder / board.initrd), "-append", board.cmdline),
        *("-drive", f"file={overlay},format=qcow2,if=none,id=disk"),
        *("-device", f"{board.qemu.disk_device},drive=disk"),
        *("-netdev", "user,id=net,restrict=on,hostfwd=tcp:127.0.0.1:0-:22"),
        *("-device", f"{board.qemu.network_device},netdev=net"),
        *("-serial", f"file:{console}"),
        *("-qmp", f"unix:{monitor},server=on,wait=off"),
    ]
    return argv + (["-dtb", str(folder / board.dtb)] if board.dtb else [])


@contextlib.contextmanager
def boot(folder: Path, console: Path, overlay: Path | None = None) -> Iterator[Machine]:
    """Start the board and yield it at once; it may take seconds until SSH answers.

    `overlay` is where the changes to the disk go: one that exists is booted again (as after a power cut), by default
    they are thrown away. Leaving the context ends QEMU.
    """
    board = read_board(folder)
    for tool in (board.qemu.binary, "qemu-img", "setpriv"):
        if shutil.which(tool) is None:
            raise UsageError(
                f"{tool} is not installed: apt-get install qemu-system-arm qemu-system-x86 qemu-utils util-linux"
            )
    with contextlib.ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rtrun-qemu-")))
        overlay = overlay or work / "overlay.qcow2"
        if not overlay.exists():
            base = (folder / board.disk).resolve()
            _quiet("qemu-img", "create", "-q", "-f", "qcow2", "-b", str(base), "-F", board.disk_format, str(overlay))
        monitor = work / "monitor"
        log = stack.enter_context((work / "stderr").open("w+b"))
        process = subprocess.Popen(
            command(board, folder, overlay, monitor, console),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            # Ctrl-C is for the runner: it ends the run on the board first.
            process_group=0,
        )
        stack.callback(_end, process)
        address = Address(
            host="127.0.0.1",
            port=_forwarded_port(process, monitor, Path(log.name)),
            user=board.ssh.user,
            key=folder / board.ssh.key,
            host_key=board.ssh.host_key,
        )
        yield Machine(
            platform=platform_of(board, folder), address=address, process=process, monitor=monitor, console=console
        )


def _quiet(*argv: str) -> None:
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise TargetError(f"{argv[0]} failed: {done.stderr.strip()}")


def _forwarded_port(process: subprocess.Popen[bytes], monitor: Path, log: Path) -> int:
    while not monitor.exists():
        try:
            process.wait(0.02)
        except subprocess.TimeoutExpired:
            continue
        stderr = log.read_text(errors="replace").strip().splitlines()
        raise TargetError(f"QEMU did not start: {stderr[-1] if stderr else f'exit status {process.returncode}'}")
    answer = qmp.execute(monitor, "human-monitor-command", {"command-line": "info usernet"})
    port = re.search(r"HOST_FORWARD\]\s+\d+\s+127\.0\.0\.1\s+(\d+)", str(answer))
    if port is None:
        raise TargetError("QEMU did not forward a port to the board's SSH server")
    return int(port.group(1))


def _end(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(process.pid, 15)
    try:
        process.wait(STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
