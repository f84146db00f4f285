"""Programs that make a thread on CPU 1 late, each run as: plants.py NAME."""

import ctypes
import os
import resource
import socket
import sys
import time

EVERY_S = 0.9
BUSY_NS = 3_000_000


def named(name: str) -> None:
    """Give this thread the name that `rtrun why` must say, on CPU 1."""
    ctypes.CDLL(None).prctl(15, name.encode(), 0, 0, 0)  # PR_SET_NAME
    os.sched_setaffinity(0, {1})


def spin(length_ns: int) -> None:
    """Use a CPU."""
    end_ns = time.monotonic_ns() + length_ns
    while time.monotonic_ns() < end_ns:
        pass


def busy(name: str, priority: int) -> None:
    """A thread that has the CPU for some milliseconds, again and again."""
    named(name)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    while True:
        time.sleep(EVERY_S)
        spin(BUSY_NS)


def broadcast() -> None:
    """Packets that the network's softirq copies to some thousand sockets each."""
    named("planted_net")
    resource.setrlimit(resource.RLIMIT_NOFILE, (8192, 8192))
    receivers = []
    for _ in range(3000):
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        receiver.bind(("127.255.255.255", 29876))
        receivers.append(receiver)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    while True:
        time.sleep(EVERY_S)
        for _ in range(6):
            sender.sendto(b"x", ("127.255.255.255", 29876))


def throttle() -> None:
    """A real-time thread below the measured one leaves nothing to a third one, until the kernel helps that one."""
    if os.fork() == 0:
        named("planted_fair")
        while True:
            spin(BUSY_NS)
    named("planted_hog")
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    while True:
        spin(BUSY_NS)


PLANTS = {
    "higher": lambda: busy("planted_hog", 98),
    "equal": lambda: busy("planted_equal", 95),
    "softirq": broadcast,
    "throttling": throttle,
}

if __name__ == "__main__":
    PLANTS[sys.argv[1]]()
