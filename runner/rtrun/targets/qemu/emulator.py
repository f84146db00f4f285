"""A board in QEMU: booted from the folder that ``rtgen board build`` makes, and never outliving the runner."""

import contextlib
import platform
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import Field

from rtfiles.config import Config, load
from rtfiles.errors import UsageError
from rtfiles.invocation import as_called
from rtrun.plan.run import KernelName
from rtrun.targets.address import Address
from rtrun.targets.errors import TargetError, TargetGone
from rtrun.targets.inspection.platform import KnownPlatform, Platform
from rtrun.targets.qemu import kvm, qmp

STOP_S = 5.0  # of QEMU on this machine


class Kvm(Config):
    """The host's processor (as `uname -m` names it) on which KVM can run a board, and QEMU's arguments for it."""

    processor: str
    arguments: list[str]


class Emulator(Config):
    """How QEMU is called for this board. Arguments for KVM come after the others and override them."""

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


class BootEntry(Config):
    """A kernel that a board can boot, with the RAM disk and the device tree that belong to it."""

    kernel: str
    initrd: str
    dtb: str | None
    kernel_release: str


class BoardFile(Config):
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
    kernels: dict[KernelName, BootEntry] = Field(default_factory=dict)
    """Both kernels, if the board has two. It starts with the one that is named above."""
    packages: dict[str, str]

    def entry(self, kernel: KernelName | None) -> BootEntry:
        """The entry to boot for a kernel; None: the one that the board starts with."""
        if kernel is not None:
            return self.kernels[kernel]
        return BootEntry(kernel=self.kernel, initrd=self.initrd, dtb=self.dtb, kernel_release=self.kernel_release)


@dataclass(slots=True, kw_only=True)
class BootedBoard:
    """A booted board. A running QEMU cannot change its kernel: another kernel is booted by another QEMU."""

    board: BoardFile
    folder: Path
    overlay: Path
    work: Path
    console: Path
    process: subprocess.Popen[bytes] | None = field(init=False, default=None)
    port: int = field(init=False, default=0)
    """The port of this machine that leads to the board's SSH server; chosen at the first start."""
    _running: KernelName | None = field(init=False, default=None)
    _chosen: KernelName | None = field(init=False, default=None)

    @property
    def platform(self) -> KnownPlatform:
        """The platform that runs the board."""
        return platform_of(self.board, self.folder)

    @property
    def address(self) -> Address:
        """Where the board answers, also after a restart."""
        login = self.board.ssh
        return Address(
            host="127.0.0.1", port=self.port, user=login.user, key=self.folder / login.key, host_key=login.host_key
        )

    @property
    def monitor(self) -> Path:
        """The socket of QEMU's monitor."""
        return self.work / "monitor"

    def start(self) -> None:
        """Start QEMU with the chosen kernel; it ends with the runner, or with `end`."""
        self.monitor.unlink(missing_ok=True)
        with (self.work / "stderr").open("wb") as log:
            self.process = subprocess.Popen(
                command(self, self._chosen),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                # Ctrl-C is for the runner: it ends the run on the board first.
                process_group=0,
            )
        self._running = self._chosen
        self.port = _forwarded_port(self.process, self.monitor, self.work / "stderr")

    def choose(self, kernel: KernelName, _: object = None) -> None:
        """Choose the kernel that the next `reset` starts."""
        self._chosen = kernel

    def reset(self, _: object = None) -> None:
        """Restart the board as its reset button does."""
        if self._chosen == self._running:
            qmp.execute(self.monitor, "system_reset")
        else:
            self.end()
            self.start()

    def end(self) -> None:
        """End QEMU, as switching the board off does."""
        if self.process is None:
            return
        self.process.terminate()
        try:
            self.process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def failure(self) -> TargetGone | None:
        """Return why the emulator ended, or None while it runs."""
        status = self.process.poll() if self.process else None
        if status is None:
            return None
        how = f"killed by signal {-status}" if status < 0 else f"exit status {status}"
        return TargetGone(f"the board in QEMU was switched off: QEMU ended ({how}); console: {self.console}")


def read_board(folder: Path) -> BoardFile:
    """Read `board.json`. Raises UsageError that says how to make one."""
    path = folder / "board.json"
    if not path.is_file():
        raise UsageError(f"{folder}: no board there, make one: {as_called('rtgen')} board build")
    try:
        return load(path, BoardFile)
    except UsageError as error:
        raise UsageError(
            f"{error}\n{path}: if another version made it, make it anew: {as_called('rtgen')} board build"
        ) from error


def emulator(board: BoardFile, folder: Path) -> tuple[str, ...]:
    """QEMU's program and the arguments that make it the board: by KVM where that works, emulated where it does not."""
    by_kvm = _by_kvm(board)
    return by_kvm if by_kvm and kvm.works(by_kvm, folder / board.kernel) else _by_tcg(board)


def platform_of(board: BoardFile, folder: Path) -> KnownPlatform:
    """Virtual where KVM runs the board, else emulated."""
    if emulator(board, folder) == _by_tcg(board):
        return KnownPlatform(platform=Platform.EMULATED, evidence="QEMU emulates the processor (TCG)")
    return KnownPlatform(platform=Platform.VIRTUAL, evidence="QEMU runs it by KVM")


def _by_tcg(board: BoardFile) -> tuple[str, ...]:
    return (board.qemu.binary, *board.qemu.arguments)


def _by_kvm(board: BoardFile) -> tuple[str, ...] | None:
    kvm = board.qemu.kvm
    return None if kvm is None or kvm.processor != platform.machine() else (*_by_tcg(board), *kvm.arguments)


def command(machine: BootedBoard, kernel: KernelName | None) -> list[str]:
    """Return the QEMU command line. The disk is the overlay; port 0 lets this machine's kernel choose the SSH port."""
    board, folder = machine.board, machine.folder
    entry = board.entry(kernel)
    argv = [
        # QEMU ends with the runner, however the runner ends.
        *("setpriv", "--pdeathsig", "KILL", "--"),
        *emulator(board, folder),
        *("-nodefaults", "-no-user-config", "-display", "none"),
        *("-kernel", str(folder / entry.kernel), "-initrd", str(folder / entry.initrd), "-append", board.cmdline),
        *("-drive", f"file={machine.overlay},format=qcow2,if=none,id=disk"),
        *("-device", f"{board.qemu.disk_device},drive=disk"),
        *("-netdev", f"user,id=net,restrict=on,hostfwd=tcp:127.0.0.1:{machine.port}-:22"),
        *("-device", f"{board.qemu.network_device},netdev=net"),
        *("-serial", f"file:{machine.console}"),
        *("-qmp", f"unix:{machine.monitor},server=on,wait=off"),
    ]
    return argv + (["-dtb", str(folder / entry.dtb)] if entry.dtb else [])


@contextlib.contextmanager
def boot(folder: Path, console: Path, overlay: Path | None = None) -> Iterator[BootedBoard]:
    """Start the board and yield it at once; it may take seconds until SSH answers.

    Changes to the disk go to `overlay`; without it they are thrown away. An existing overlay is booted again, as after
    a power cut. Leaving the context ends QEMU.
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
        machine = BootedBoard(board=board, folder=folder, overlay=overlay, work=work, console=console)
        stack.callback(machine.end)
        machine.start()
        yield machine


def _quiet(*argv: str) -> None:
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise TargetError(f"{argv[0]} failed: {done.stderr.strip()}")


def _ask_for_network(process: subprocess.Popen[bytes], monitor: Path) -> object:
    """Ask QEMU for its forwarded ports as soon as its monitor listens. Raises TargetGone when it ends before."""
    while True:
        try:
            return qmp.execute(monitor, "human-monitor-command", {"command-line": "info usernet"})
        except TargetGone as error:
            # The file of a socket exists a moment before QEMU listens.
            opens = isinstance(error.__cause__, FileNotFoundError | ConnectionRefusedError)
            if not opens or process.poll() is not None:
                raise
        time.sleep(0.02)


def _forwarded_port(process: subprocess.Popen[bytes], monitor: Path, log: Path) -> int:
    try:
        answer = _ask_for_network(process, monitor)
    except TargetGone:
        # QEMU opens its monitor before it has checked all of its arguments.
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(STOP_S)
        if process.returncode is None:
            raise
        # The last line may be a hint at what would be right.
        words = "; ".join(log.read_text(errors="replace").strip().splitlines()[-2:])
        reason = words or f"exit status {process.returncode}"
        raise TargetError(f"QEMU did not start: {reason}") from None
    port = re.search(r"HOST_FORWARD\]\s+\d+\s+127\.0\.0\.1\s+(\d+)", str(answer))
    if port is None:
        raise TargetError("QEMU did not forward a port to the board's SSH server")
    return int(port.group(1))
