"""Programs that make a thread late, each run as: plants.py NAME CPU LENGTH_MS [PORT].

Each needs Python alone, as it is copied to a board. CPU is that of the measured thread; LENGTH_MS is how long one event
is to last, where the program can choose it.
"""

import contextlib
import ctypes
import mmap
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

EVERY_MS = 700
# Within these is a whole period of sched_rt_period_us.
THROTTLED_MS = 2000
SCHED_SETATTR = {"x86_64": 314, "armv7l": 380, "aarch64": 274}
# Of each period, the runtime that a control group has.
GROUP = Path("/sys/fs/cgroup/cpu/planted_group")
LIMIT_PERIOD_US, LIMIT_RUNTIME_US = 100_000, 30_000
SHARES_MAX = 1 << 18
MEASURED = "cyclic_timer_te\n"
SOCKETS = 4000
RECEIVERS_MAX = 50
# A burst takes somewhat longer than a thread is to be late.
FLOOD_PACKETS = 10
# For experiments (RFC 3692): nobody else speaks it.
PROTOCOL = 253
TRACING = Path("/sys/kernel/tracing")
# Functions of drivers that no emulated board has: none of them is called, so that nothing but their change takes time.
PATCHED = (
    "omap", "tegra", "imx", "exynos", "sun", "rockchip", "rk", "qcom", "stm32", "rcar", "bcm", "mvebu", "armada", "ti_",
    "am33", "meson", "usb", "xhci", "ehci", "musb", "dwc", "mmc", "sdhci", "i2c", "spi_", "mtd", "nand", "pci", "drm",
    "hid", "regulator", "pinctrl", "gpio", "scsi", "ata_", "acpi", "iio",
)  # fmt: skip


def named(name: str, cpu: int | None) -> None:
    """Give this thread its CPU and the name that `rtrun why` must say. A plant has its name once it is ready."""
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})
    ctypes.CDLL(None).prctl(15, name.encode(), 0, 0, 0)  # PR_SET_NAME


def pause(length_ms: int) -> None:
    """Wait until the next event. On a slow machine events are longer, and so is the time from one to the next.

    On the emulated board the copy of a trace takes 6 s, during which another outlier may get lost.
    """
    period_s = period_ms(length_ms) / 1000
    time.sleep(period_s - time.monotonic() % period_s)


def period_ms(length_ms: int) -> int:
    """The time from one event to the next, which begin at multiples of it on CLOCK_MONOTONIC."""
    return EVERY_MS + 30 * length_ms


@contextlib.contextmanager
def setting(path: Path, value: str) -> Iterator[None]:
    """A setting of the kernel, which is as it was when the plant ends: the next one must not meet it."""
    before = path.read_text()
    path.write_text(value)
    try:
        yield
    finally:
        path.write_text(before)


def spin(length_ms: int) -> None:
    """Use a CPU."""
    end_ns = time.monotonic_ns() + length_ms * 1_000_000
    while time.monotonic_ns() < end_ns:
        pass


def awake(cpu: int) -> None:
    """A thread that has the CPU whenever nobody else wants it."""
    named("planted_awake", cpu)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    while True:
        spin(1000)


def busy(name: str, priority: int, cpu: int, length_ms: int) -> None:
    """A thread that has the CPU for some milliseconds, again and again."""
    named(name, cpu)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    while True:
        pause(length_ms)
        spin(length_ms)


def multiply(cpu: int, length_ms: int) -> None:
    """Packets that the network's softirq copies to so many sockets that one packet takes long."""
    # Twice as long: what else runs now makes it seem longer.
    sender = sender_to_many(PROTOCOL, 2 * length_ms)
    named("planted_net", cpu)
    while True:
        pause(length_ms)
        sender.sendto(b"x", ("127.0.0.1", 0))


def sender_to_many(protocol: int, length_ms: float) -> socket.socket:
    """Open so many sockets that a packet of a protocol takes a time to get to all of them; return one that sends."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_RAW, protocol)
    for _ in range(RECEIVERS_MAX):
        if sent_ns(sender) > length_ms * 1_000_000:
            break
        ready, done = os.pipe()
        if os.fork() == 0:
            receive(protocol, done)
        os.read(ready, 1)
    return sender


def receive(protocol: int, done: int) -> None:
    """Have many sockets that nobody reads: their queues are full at once, and each packet takes as long as the last."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (SOCKETS + 50, SOCKETS + 50))
    receivers = []
    for _ in range(SOCKETS):
        receiver = socket.socket(socket.AF_INET, socket.SOCK_RAW, protocol)
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        receivers.append(receiver)
    os.write(done, b"x")
    while True:
        signal.pause()


def sent_ns(sender: socket.socket) -> int:
    """The shortest time of a CPU that a packet took of five, with the softirq that delivers it."""
    times = []
    for _ in range(5):
        begin_ns = time.thread_time_ns()
        sender.sendto(b"x", ("127.0.0.1", 0))
        times.append(time.thread_time_ns() - begin_ns)
    return min(times)


def throttle(cpu: int, length_ms: int) -> None:
    """A real-time thread below the measured one leaves nothing to a third one, until the kernel helps that one."""
    if os.fork() == 0:
        named("planted_fair", cpu)
        while True:
            spin(length_ms)
    runtime_us = Path("/proc/sys/kernel/sched_rt_runtime_us")
    # Longer than the 50 ms of each second that Linux leaves to other threads.
    with setting(runtime_us, str(1_000_000 - 2000 * length_ms)) if length_ms > 20 else contextlib.nullcontext():
        named("planted_hog", cpu)
        while True:
            # With PREEMPT_RT the hog keeps RCU waiting, and with it whoever sets up or copies the kernel's trace.
            while measured() is None:
                time.sleep(0.2)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
            spin(THROTTLED_MS)
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            pause(length_ms)


def measured() -> int | None:
    """The process of a suite whose thread runs with a real-time priority."""
    for file in Path("/proc").glob("[0-9]*/comm"):
        with contextlib.suppress(OSError):
            pid = int(file.parent.name)
            if file.read_text() == MEASURED and os.sched_getscheduler(pid) == os.SCHED_RR:
                return pid
    return None


def long(lengths: int, cpu: int, length_ms: int) -> None:
    """Two threads wake each other up, so often that the trace has lost their begin when they end."""
    ours, theirs = socket.socketpair()
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(98))
    named("planted_long", cpu)
    if os.fork() == 0:
        while True:
            theirs.send(theirs.recv(1))
    while True:
        pause(length_ms)
        end_ns = time.monotonic_ns() + lengths * length_ms * 1_000_000
        while time.monotonic_ns() < end_ns:
            ours.send(b"x")
            ours.recv(1)


def deadline(cpu: int, length_ms: int) -> None:
    """A thread at SCHED_DEADLINE for each CPU: the kernel lets none of them be bound to one."""
    for _ in range(1, os.cpu_count() or 1):
        if os.fork() == 0:
            break
    named("planted_dl", None)
    runtime_ns, period_ns = 2 * length_ms * 1_000_000, 20 * length_ms * 1_000_000
    # struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period (sched_setattr(2)).
    attributes = struct.pack("=IIQiIQQQ", 48, 6, 0, 0, 0, runtime_ns, period_ns, period_ns)
    if ctypes.CDLL(None, use_errno=True).syscall(SCHED_SETATTR[os.uname().machine], 0, attributes, 0):
        raise OSError(ctypes.get_errno(), "sched_setattr")
    while True:
        pause(length_ms)
        spin(length_ms)


def processes(priority: int, cpu: int, length_ms: int) -> None:
    """A process with a number and a name of its own for each event, as jobs are started by a script."""
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    named("planted_shop", 1 - cpu)
    number = 0
    while True:
        pause(length_ms)
        number += 1
        if os.fork() == 0:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            named(f"planted_job{number}", cpu)
            spin(length_ms)
            os._exit(0)
        os.wait()


def several(cpu: int, length_ms: int) -> None:
    """Two at once that have nothing to do with each other."""
    if os.fork() == 0:
        stop(cpu, length_ms)
    time.sleep(EVERY_MS / 2000)
    busy("planted_hog", 98, cpu, length_ms)


def stop_by_others(length_ms: int) -> None:
    """As somebody does it by hand: one process stops the program, and another one lets it go on."""
    named("planted_shell", None)
    while True:
        pause(length_ms)
        for name, number in (("planted_stop", signal.SIGSTOP), ("planted_go", signal.SIGCONT)):
            if os.fork() == 0:
                named(name, None)
                if (pid := measured()) is not None:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, number)
                os._exit(0)
            os.wait()
            time.sleep(length_ms / 1000)


def io_mix(cpu: int, length_ms: int) -> None:
    """Writers, readers and those who give memory back, on every CPU."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        folder = Path(name)
        works = (write_much, write_small, read_direct, make_files, fill_memory)
        for work in works:
            if os.fork() == 0:
                named("planted_io", None)
                while True:
                    work(folder)
        named("planted_mix", None)
        signal.pause()


def write_much(folder: Path) -> None:
    with (folder / "much").open("wb", buffering=0) as file:
        for _ in range(4):
            file.write(bytes(16 << 20))
        os.fdatasync(file.fileno())


def write_small(folder: Path) -> None:
    with (folder / "small").open("ab", buffering=0) as file:
        file.write(b"line\n")
        os.fsync(file.fileno())


def read_direct(folder: Path) -> None:
    memory = mmap.mmap(-1, 1 << 20)
    much = folder / "much"
    if much.exists():
        file = os.open(much, os.O_RDONLY | os.O_DIRECT)
        while os.readv(file, [memory]):
            pass
        os.close(file)


def make_files(folder: Path) -> None:
    for number in range(200):
        (folder / f"file{number}").write_bytes(b"x")
    for number in range(200):
        (folder / f"file{number}").unlink()


def fill_memory(folder: Path) -> None:
    memory = mmap.mmap(-1, 128 << 20)
    memory.write(bytes(128 << 20))
    memory.close()


def fsync_loop(cpu: int, length_ms: int) -> None:
    """A shell's loop of short processes, each of which writes a file and waits for the disk."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        named("planted_sync", cpu)
        copy = ["dd", "if=/dev/zero", f"of={name}/file", "bs=64k", "count=16", "conv=fsync"]
        while True:
            subprocess.run(copy, stderr=subprocess.DEVNULL, check=True)


def limited(file: str, runtime_us: int, cpu: int) -> None:
    """A control group with a limit, which a thread of the group uses up; the measured program is started in it.

    The threads of the machine that are not in the group go on.
    """
    is_rt = file == "cpu.rt_runtime_us"
    GROUP.mkdir(exist_ok=True)
    try:
        (GROUP / ("cpu.rt_period_us" if is_rt else "cpu.cfs_period_us")).write_text(str(LIMIT_PERIOD_US))
        (GROUP / file).write_text(str(runtime_us))
        # Other programs of the machine are to take nothing of what the limit leaves.
        (GROUP / "cpu.shares").write_text(str(SHARES_MAX))
        (GROUP / "cgroup.procs").write_text(str(os.getpid()))
        if is_rt:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
        named("planted_mate", cpu)
        while True:
            pause(2 * runtime_us // 1000)
            spin(2 * runtime_us // 1000)
    finally:
        for pid in (GROUP / "cgroup.procs").read_text().split():
            with contextlib.suppress(OSError):
                (GROUP.parent / "cgroup.procs").write_text(pid)
        GROUP.rmdir()


def stop(cpu: int, length_ms: int) -> None:
    """The measured program is stopped by a signal, and goes on."""
    named("planted_stopper", 1 - cpu)
    while True:
        pause(length_ms)
        with contextlib.suppress(ProcessLookupError):
            if (pid := measured()) is not None:
                os.kill(pid, signal.SIGSTOP)
                time.sleep(length_ms / 1000)
                os.kill(pid, signal.SIGCONT)


def freeze(cpu: int, length_ms: int, *, is_v1: bool = True) -> None:
    """The measured program is in a control group that is frozen, and goes on. Version 1, where it is mounted, or 2."""
    mounts = [line.split()[1:4] for line in Path("/proc/mounts").read_text().splitlines()]
    freezers = (path for path, kind, options in mounts if kind == "cgroup" and "freezer" in options.split(","))
    old = next(freezers, None) if is_v1 else None
    root = Path(old or next(path for path, kind, _ in mounts if kind == "cgroup2"))
    file, frozen, thawed = ("freezer.state", "FROZEN", "THAWED") if old else ("cgroup.freeze", "1", "0")
    group = root / "planted_frozen"
    group.mkdir(exist_ok=True)
    try:
        named("planted_freezer", 1 - cpu)
        while True:
            pause(length_ms)
            if (pid := measured()) is None:
                continue
            with contextlib.suppress(OSError):
                (group / "cgroup.procs").write_text(str(pid))
                (group / file).write_text(frozen)
                time.sleep(length_ms / 1000)
            (group / file).write_text(thawed)
    finally:
        (group / file).write_text(thawed)
        for pid in (group / "cgroup.procs").read_text().split():
            with contextlib.suppress(OSError):
                (root / "cgroup.procs").write_text(pid)
        group.rmdir()


def stop_machine(cpu: int, length_ms: int) -> None:
    """The kernel changes its own code while every CPU is stopped: the function tracer is switched on and off."""
    for prefix in PATCHED:
        with contextlib.suppress(OSError), (TRACING / "set_ftrace_filter").open("a") as functions:
            functions.write(f"{prefix}*")
    named("planted_stop", 1 - cpu)
    while True:
        for tracer in ("function", "nop"):
            pause(length_ms)
            (TRACING / "current_tracer").write_text(tracer)


def printk(cpu: int, length_ms: int) -> None:
    """The kernel prints what each thread does on the console, as it does when one hangs."""
    # The board boots with `quiet`.
    with setting(Path("/proc/sys/kernel/printk"), "8"):
        named("planted_printk", cpu)
        while True:
            pause(length_ms)
            Path("/proc/sysrq-trigger").write_text("t")


def flood(port: int, length_ms: int) -> None:
    """Bursts of packets, which a port of this machine forwards to the emulated network device of a board."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    while True:
        pause(length_ms)
        for _ in range(FLOOD_PACKETS):
            sender.sendto(b"x", ("127.0.0.1", port))


def accept_flood(cpu: int, length_ms: int) -> None:
    """The board handles each packet for long, and a burst of them without giving way to threads."""
    sender_to_many(socket.IPPROTO_UDP, 1.2 * length_ms / FLOOD_PACKETS)
    budget = Path("/proc/sys/net/core/netdev_budget")
    with setting(budget, "100000"), setting(budget.with_name("netdev_budget_usecs"), str(4000 * length_ms)):
        named("planted_net", cpu)
        while True:
            time.sleep(1)


PLANTS = {
    "awake": lambda cpu, length_ms: awake(cpu),
    "higher": lambda cpu, length_ms: busy("planted_hog", 98, cpu, length_ms),
    "equal": lambda cpu, length_ms: busy("planted_equal", 95, cpu, length_ms),
    "long": partial(long, 4),
    "longer": partial(long, 60),
    "deadline": deadline,
    "processes": partial(processes, 99),
    "several": several,
    "io": io_mix,
    "fsync": fsync_loop,
    "rt_group": lambda cpu, length_ms: limited("cpu.rt_runtime_us", LIMIT_RUNTIME_US, cpu),
    "quota": lambda cpu, length_ms: limited("cpu.cfs_quota_us", LIMIT_RUNTIME_US, cpu),
    "stopped_by_others": lambda cpu, length_ms: stop_by_others(length_ms),
    "frozen_v2": partial(freeze, is_v1=False),
    "softirq": multiply,
    "throttling": throttle,
    "stopped": stop,
    "frozen": freeze,
    "stop_machine": stop_machine,
    "printk": printk,
    "storm": accept_flood,
    "flood": flood,
}

if __name__ == "__main__":
    # Settings are put back before the end.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    PLANTS[sys.argv[1]](int(sys.argv[2]), int(sys.argv[3]))
