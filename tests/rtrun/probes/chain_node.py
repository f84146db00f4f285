"""A node on rclpy, `chain_node.py NAME INPUT OUTPUT [STALL_S EVERY_S]`: it passes on what it takes; INPUT -: publishes.

It prints a line when it takes its first message. With STALL_S its timer keeps the thread busy for that long, once in
EVERY_S: a planted stall. It prints of each when it began and ended, and for how long it had a CPU, in nanoseconds. Such
a node is at a real-time policy, so that the timer is what takes the time, however busy the machine.
"""

import os
import sys
import time

import rclpy
from rclpy.node import Node
from std_msgs.msg import String

name, source, sink, *stall = sys.argv[1:]
if stall:
    # Before the threads of the middleware begin, which have it, too.
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
rclpy.init()
node = Node(name)
publisher = node.create_publisher(String, sink, 100)
taken = []


def pass_on(message: String) -> None:
    """Publish what came, and say so the first time."""
    publisher.publish(message)
    if not taken:
        taken.append(message)
        print("takes", flush=True)


def housekeeping() -> None:
    """Have the thread for long, and say when."""
    begin_ns, cpu_ns = time.monotonic_ns(), time.thread_time_ns()
    while time.monotonic_ns() < begin_ns + float(stall[0]) * 1e9:
        pass
    print(begin_ns, time.monotonic_ns(), time.thread_time_ns() - cpu_ns, flush=True)


if source == "-":
    node.create_timer(0.02, lambda: publisher.publish(String(data=str(time.monotonic_ns()))))
else:
    node.create_subscription(String, source, pass_on, 100)
if stall:
    node.create_timer(float(stall[1]), housekeeping)
rclpy.spin(node)
