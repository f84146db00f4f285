"""Programs that make a thread late, each run as: plants.py NAME CPU LENGTH_MS [PORT].

Each needs Python alone, as it is copied to a board. CPU is that of the measured thread; LENGTH_MS is how long one event
is to last, where the program can choose it.
"""

import contextlib
import ctypes
import os
import resource
import signal
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

EVERY_MS = 700
# Within these is a whole period of sched_rt_period_us.
THROTTLED_MS = 2000
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


def named(name: str, cpu: int) -> None:
    """Give this thread its CPU and the name that `rtrun why` must say. A plant has its name once it is ready."""
    os.sched_setaffinity(0, {cpu})
    ctypes.CDLL(None).prctl(15, name.encode(), 0, 0, 0)  # PR_SET_NAME


def pause(length_ms: int) -> None:
    """Wait until the next event. On a slow machine events are longer, and so is the time from one to the next.

    On the emulated board the copy of a trace takes 6 s, during which another outlier may get lost.
    """
    period_s = (EVERY_MS + 30 * length_ms) / 1000
    time.sleep(period_s - time.monotonic() % period_s)


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


def freeze(cpu: int, length_ms: int) -> None:
    """The measured program is in a control group that is frozen, and goes on. Version 1, where it is mounted, or 2."""
    mounts = [line.split()[1:4] for line in Path("/proc/mounts").read_text().splitlines()]
    old = next((path for path, kind, options in mounts if kind == "cgroup" and "freezer" in options.split(",")), None)
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
