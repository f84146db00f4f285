"""A node on rclpy whose timer takes 30 ms, four times a second, in the thread that takes what a talker publishes.

It prints a line once it takes messages steadily.
"""

import time

import rclpy
from rclpy.node import Node
from std_msgs.msg import String


def compute() -> None:
    """Have the thread for 30 ms."""
    end = time.monotonic() + 0.03
    while time.monotonic() < end:
        pass


def take(message: String) -> None:
    """Say once that a second's messages came."""
    if message.data == "1000":
        print("steady", flush=True)


rclpy.init()
node = Node("slow")
node.create_timer(0.25, compute)
node.create_subscription(String, "chatter", take, 1000)
rclpy.spin(node)
