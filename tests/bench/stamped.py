"""A pair on rclpy that stamps its own messages: `stamped.py talker` at 1 kHz, `stamped.py listener FILE`.

Both end by SIGTERM; the listener then writes when each message was published and taken, in ns of CLOCK_MONOTONIC.
"""

import contextlib
import sys
import time

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node(sys.argv[1])
stamps = []
if sys.argv[1] == "talker":
    publisher = node.create_publisher(String, "stamped", 1000)
    node.create_timer(0.001, lambda: publisher.publish(String(data=str(time.monotonic_ns()))))
else:
    node.create_subscription(
        String, "stamped", lambda message: stamps.append((int(message.data), time.monotonic_ns())), 1000
    )
with contextlib.suppress(ExternalShutdownException):
    rclpy.spin(node)
if stamps:
    np.save(sys.argv[2], np.array(stamps, np.int64))
