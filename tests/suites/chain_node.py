"""A node on rclpy, `chain_node.py NAME INPUT OUTPUT [STALL_S]`: it passes on what it takes, or publishes (INPUT -).

With STALL_S its timer `housekeeping` keeps the thread busy for that long, once in five seconds: a planted stall.
"""

import sys
import time

import rclpy
from rclpy.node import Node
from std_msgs.msg import String

name, source, sink, *stall = sys.argv[1:]
rclpy.init()
node = Node(name)
publisher = node.create_publisher(String, sink, 10)


def housekeeping() -> None:
    """Have the thread for long."""
    end = time.monotonic() + float(stall[0])
    while time.monotonic() < end:
        pass


if source == "-":
    node.create_timer(0.05, lambda: publisher.publish(String(data=str(time.monotonic_ns()))))
else:
    node.create_subscription(String, source, publisher.publish, 10)
if stall:
    node.create_timer(5.0, housekeeping)
rclpy.spin(node)
